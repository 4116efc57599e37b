//! What each survey contributes: everywhere, and to a region.

use super::*;

#[test]
fn a_redundant_survey_is_named_and_is_not_missed() {
    let s = Scratch::new(Policy::Accuracy);
    // Wholly inside a survey of higher precedence: no cell of it is left.
    s.ingest(&grid("buried", 20.0, 40, 0, 3));
    s.ingest(&grid("wide", 0.0, 100, 1, 1));
    s.ingest(&grid("beside", 80.0, 60, 0, 2));
    let rows: serde_json::Value =
        serde_json::from_str(&printed(&["redundant", s.path().to_str().unwrap(), "--json"])).unwrap();
    let row = |name: &str| rows.as_array().unwrap().iter().find(|r| r["name"] == name).unwrap();
    assert_eq!((&row("buried")["redundant"], &row("buried")["live"]), (&true.into(), &0.into()));
    assert_eq!(row("buried")["cells_kept"], 0);
    assert_eq!((&row("wide")["redundant"], &row("wide")["cells_share"]), (&false.into(), &1.0.into()));
    let share = row("beside")["cells_share"].as_f64().unwrap();
    assert!(share > 0.5 && share < 0.8, "40 of 60 columns are its own: {share}");
    // 40 x 40 posts have 39 x 39 cells, the outermost ring of which is in no core.
    assert_eq!(row("buried")["cells"], 37 * 37);
    let before = heights(&s.db.snapshot(None).unwrap());
    // Its file goes as a whole; beside it there are the pages of its tops, in files of the set.
    let (file, said) = (segments(&s.path())["00000001.tqs"].len() as u64, &row("buried")["bytes"]);
    s.remove("buried");
    prune_to_one(&s.db);
    assert_eq!(heights(&s.db.snapshot(None).unwrap()), before);
    assert!(!segments(&s.path()).contains_key("00000001.tqs"));
    let tops = said.as_u64().unwrap() - (file - 32);
    assert!((12..1000).contains(&tops), "{tops}");
    let after = terraquilt::db::contributions(&s.db.snapshot(None).unwrap()).unwrap();
    for c in &after {
        assert_eq!(row(&c.name)["live"], c.live, "{}", c.name);
    }
}

#[test]
fn provenance_is_shares_by_area() {
    let s = Scratch::new(Policy::Accuracy);
    s.ingest(&grid("west", 0.0, 100, 1, 1));
    s.ingest(&grid("east", 60.0, 100, 0, 2));
    let db = s.path();
    let ask = |more: &[&str]| -> serde_json::Value {
        let args = [&["provenance", db.to_str().unwrap(), "--json"], more].concat();
        serde_json::from_str(&printed(&args)).unwrap()
    };
    // West shows its core, which ends one cell before its posts: x = 98 of 0 to 120; y from 10 to 90.
    let all = ask(&["--error", "0", "--bbox", "500020,4000010,500120,4000090"]);
    let shares = all["surveys"].as_array().unwrap();
    assert_eq!((&shares[0]["name"], &shares[1]["name"]), (&"west".into(), &"east".into()));
    let of = |k: usize, what: &str| shares[k][what].as_f64().unwrap();
    assert!((of(0, "share") - 0.78).abs() < 0.01, "{all}");
    assert!((of(0, "dominant_share") - 0.78).abs() < 0.01, "{all}");
    assert!((of(0, "share") + of(1, "share") - 1.0).abs() < 1e-9);
    assert_eq!(all["points"], all["points_with_data"]);
    assert!((39_000..41_000).contains(&all["points"].as_u64().unwrap()));
    // At the same points the patch that weighs most is the one that `dominant` names.
    let few = ask(&["--error", "0", "--bbox", "500090,4000010,500110,4000030", "--step", "1"]);
    assert_eq!((&few["points"], &few["step"]), (&400.into(), &serde_json::json!([1.0, 1.0])));
    let points: Vec<[f64; 2]> =
        (0..400).map(|k| [500_090.5 + (k % 20) as f64, 4_000_010.5 + (k / 20) as f64]).collect();
    let snapshot = s.db.snapshot(None).unwrap();
    let named = snapshot.dominant(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
    let west = snapshot.survey("west").unwrap().number;
    let n = named.iter().flatten().filter(|r| r.survey == west).count();
    let told = few["surveys"].as_array().unwrap().iter().find(|r| r["name"] == "west").unwrap();
    assert!((told["dominant_share"].as_f64().unwrap() - n as f64 / 400.0).abs() < 1e-12);
    // Nothing there, and nothing asked.
    let none = ask(&["--error", "0", "--bbox", "600000,4000000,600100,4000100"]);
    assert_eq!((&none["points_with_data"], &none["surveys"]), (&0.into(), &serde_json::json!([])));
    let text = printed(&["provenance", db.to_str().unwrap(), "--error", "5"]);
    assert!(text.contains("west") && text.contains("points"), "{text}");
    assert!(
        refused(&["provenance", db.to_str().unwrap(), "--error", "5", "--step", "0"], 1).contains("--step")
    );
    assert!(
        refused(&["provenance", db.to_str().unwrap(), "--error", "5", "--step", "0.001"], 1)
            .contains("at most")
    );
}

#[test]
fn no_redundant_survey_is_missed_in_random_worlds() {
    let mut found = 0;
    for seed in crate::support::seeds(8) {
        let mut r = Random::new(seed);
        let s = Scratch::new(Policy::Accuracy);
        for k in 0..6 {
            let g = crate::support::random_grid(&mut r, &format!("s{k}"), 60);
            s.ingest(&g);
            // A part of it again, less accurate: as it stands, or where holes let it through.
            if k % 2 == 0 {
                let part = g.cut(3, 3, g.cols - 7, g.rows - 8);
                let accuracy = g.accuracy + 1.0;
                s.ingest(&Grid { name: format!("part of {k}"), accuracy, ..part });
            }
        }
        let surveys = terraquilt::db::surveys(&s.db.snapshot(None).unwrap()).unwrap();
        let points: Vec<[f64; 2]> = (0..480)
            .map(|k| surveys[k % surveys.len()].bounds)
            .map(|b| [b[0] + r.unit() * (b[2] - b[0]), b[1] + r.unit() * (b[3] - b[1])])
            .collect();
        let ask = |tolerance: f64| -> Vec<Option<u64>> {
            let s = s.db.snapshot(None).unwrap();
            let found = s.heights(&points, &Tolerance::Constant(tolerance), Blend::Exact).unwrap();
            found.into_iter().map(|e| e.map(|e| e.z.to_bits())).collect()
        };
        let all = || [0.0, 1.0, 5.0, 40.0].map(ask);
        let before = all();
        assert!(before[0].iter().flatten().count() > 50, "seed {seed}: the points miss the surveys");
        let rows = terraquilt::db::contributions(&s.db.snapshot(None).unwrap()).unwrap();
        for c in rows.iter().filter(|c| c.redundant) {
            found += 1;
            s.remove(&c.name);
            assert!(all() == before, "seed {seed}: without '{}' heights differ", c.name);
        }
    }
    println!("{found} redundant surveys in 8 worlds");
    assert!(found > 4);
}
