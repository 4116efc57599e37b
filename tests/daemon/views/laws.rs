use super::{Known, MIDDLE, answered, camera, held, hills};
use crate::worlds::{Grid, Random, Scratch, random_grid, seeds};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use terraquilt::base::date::Date;
use terraquilt::client::view::Set;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Change, Policy, Snapshot};
use terraquilt::height::lod::cut::{Camera, Foci, Focus};
use terraquilt::height::lod::{PatchId, Place, SurveyNumber};
use terraquilt::height::surface::{Blend, How};
use terraquilt::server::view::{Difference, Ledger, Manner, Parcel, Target};
use terraquilt::store::quadtree::Record;
use terraquilt::wire::v1;

/// Sets of the client that it may come back with.
const REMEMBERED: usize = 40;

fn ids(of: &[terraquilt::server::view::Member]) -> Vec<PatchId> {
    of.iter().map(|m| m.record.id).collect()
}

/// A random question; most move the camera by a little.
fn question(r: &mut Random, at: &mut ([f64; 2], f64)) -> (Area, Tolerance) {
    at.0[0] = (at.0[0] + r.unit() * 40.0 - 20.0).clamp(MIDDLE[0] - 300.0, MIDDLE[0] + 300.0);
    at.0[1] = (at.0[1] + r.unit() * 40.0 - 20.0).clamp(MIDDLE[1] - 400.0, MIDDLE[1] + 200.0);
    at.1 += r.unit() - 0.5;
    let (x, y) = (at.0[0], at.0[1]);
    let side = 20.0 + r.unit() * 300.0;
    let area = if r.chance(0.5) { Area::Everything } else { Area::Box([x, y, x + side, y + side]) };
    let tolerance = match r.below(10) {
        0..=5 => {
            let c: v1::Camera = camera(at.0, 20.0 + r.unit() * 10.0, at.1);
            let (eye, look) = ([c.eye_x, c.eye_y, c.eye_z], [c.look_at_x, c.look_at_y, c.look_at_z]);
            Tolerance::Camera(Camera::new(eye, look, 50.0, [800, 600], 2.0, None).unwrap())
        }
        6..=7 => Tolerance::Constant([0.0, 0.5, 1.0, 3.0, 20.0][r.below(5) as usize]),
        _ => {
            let focus = Focus { center: [x, y], radius: 20.0, error: 0.5, growth: 0.05 };
            Tolerance::Foci(Foci::new(vec![focus]).unwrap())
        }
    };
    (area, tolerance)
}

/// A commit: something comes, something leaves, or ranks change.
fn commit(r: &mut Random, s: &Scratch, grids: &[Grid], there: &mut BTreeSet<usize>) {
    let k = r.below(grids.len() as u64) as usize;
    let name = grids[k].name.clone();
    if !there.contains(&k) {
        s.ingest(&grids[k]);
        there.insert(k);
    } else if r.chance(0.2) {
        let precedence = Some(r.below(5) as i64);
        s.change(Change::Set { survey: name, date: None::<Date>, precedence }).unwrap();
    } else {
        s.remove(&name);
        there.remove(&k);
        if r.chance(0.3) {
            // The same patches, under a new number.
            s.ingest(&grids[k]);
            there.insert(k);
        }
    }
}

/// Disjoint, ascending, about patches that are there, and about what really differs.
fn minimal(d: &Difference, before: &Known, after: &Known) {
    let changed: Vec<PatchId> = d.changed.iter().map(|(m, _)| m.record.id).collect();
    for list in [&ids(&d.removed), &ids(&d.added), &changed] {
        assert!(list.is_sorted_by(|a, b| a < b), "lists ascend by id");
    }
    for m in &d.removed {
        assert!(before.contains_key(&m.record.id.0) && !after.contains_key(&m.record.id.0));
    }
    for m in &d.added {
        assert!(!before.contains_key(&m.record.id.0) && after.contains_key(&m.record.id.0));
    }
    for id in &changed {
        assert_ne!(before[&id.0], after[&id.0]);
    }
    let differ = before.iter().filter(|(id, k)| after.get(*id).is_some_and(|a| a != *k)).count();
    assert_eq!(differ, changed.len(), "every patch that differs is told");
}

/// What several differences do together: ids that come, ids that leave.
fn composed<'a>(chain: impl Iterator<Item = &'a Difference>) -> (BTreeSet<PatchId>, BTreeSet<PatchId>) {
    let (mut come, mut gone) = (BTreeSet::new(), BTreeSet::new());
    for d in chain {
        for id in ids(&d.removed) {
            if !come.remove(&id) {
                gone.insert(id);
            }
        }
        for id in ids(&d.added) {
            if !gone.remove(&id) {
                come.insert(id);
            }
        }
    }
    (come, gone)
}

/// Sends a difference to a client, message by message.
fn send(d: Difference, snapshot: &Arc<Snapshot>, manner: Manner, client: &mut Set) -> usize {
    let mut parcel = Parcel::new(d, snapshot.clone(), !manner.descriptors_only);
    let mut messages = 0;
    loop {
        messages += 1;
        let applied = client.take(parcel.message().unwrap()).unwrap();
        assert_eq!(applied.is_some(), parcel.done());
        if parcel.done() {
            return messages;
        }
    }
}

/// What was seen in a run, so that it cannot pass by doing nothing.
#[derive(Debug, Default)]
struct Seen {
    added: usize,
    removed: usize,
    changed: usize,
    moved: usize,
    unasked: usize,
    untouched: usize,
    resumed: usize,
    anew: usize,
    composed: usize,
}

fn steps(seed: u64, count: usize, seen: &mut Seen) {
    let mut r = Random::new(seed);
    let s = Scratch::new(Policy::Accuracy);
    let mut grids: Vec<Grid> = (0..5).map(|k| random_grid(&mut r, &format!("s{k}"), 70)).collect();
    // A fine survey and a coarse one of equal rank: when the coarse one comes or leaves, tops of the fine one change.
    grids[0] = Grid { precedence: None, ..hills("s0", [-20.0, 10.0], 70, 2.0, 0) };
    grids[1] = Grid { precedence: None, accuracy: 0.2, ..hills("s1", [-100.0, 100.0], 60, 6.0, 0) };
    let mut there = BTreeSet::new();
    let how = How::from(if r.chance(0.7) { Blend::Exact } else { Blend::Plain });
    let manner = Manner { how, descriptors_only: r.chance(0.5) };
    let mut at = (MIDDLE, r.unit() * 6.0);
    let mut snapshot = Arc::new(s.db.snapshot(None).unwrap());
    let (mut ledger, mut client) = (Ledger::default(), Set::default());
    let mut clients: VecDeque<Set> = VecDeque::from([client.clone()]);
    let mut chain: Vec<Difference> = Vec::new();
    let mut lagging = ledger.clone();
    let mut query = Query { area: Area::Everything, tolerance: Tolerance::Constant(1.0), how };
    for step in 0..count {
        let arrived = step % 50 == 0 || r.chance(0.01);
        if arrived {
            commit(&mut r, &s, &grids, &mut there);
            snapshot = Arc::new(s.db.snapshot(None).unwrap());
        }
        let broken = r.chance(0.05);
        let asked = !arrived || broken || r.chance(0.2);
        if asked {
            (query.area, query.tolerance) = question(&mut r, &mut at);
        }
        // Some commits are seen from above.
        if step % 50 == 49 {
            (query.area, query.tolerance) = (Area::Everything, Tolerance::Constant(r.unit() * 2.0));
        }
        // A broken connection: the client comes back with something that it had.
        if broken {
            let back = clients[r.below(clients.len() as u64) as usize].clone();
            if back.number > 0 && ledger.resume(back.number, &back.hash) {
                seen.resumed += 1;
                client = back;
            } else {
                seen.anew += 1;
                ledger.begin();
                client = Set::default();
            }
            clients.retain(|c| c.number <= client.number);
            (chain, lagging) = (Vec::new(), ledger.clone());
        }
        let before = held(&client);
        let after = answered(&snapshot, &query);
        let target = Target::of(&snapshot, &query, manner, 1_000_000, ledger.last()).unwrap();
        let number = asked.then_some(step as u64 + 1);
        match ledger.step(target.clone(), number) {
            None => {
                seen.untouched += 1;
                assert!(!asked, "every question is answered");
                assert_eq!(before, after, "a commit that touches the view is told");
            }
            Some(d) => {
                seen.unasked += usize::from(!asked);
                minimal(&d, &before, &after);
                assert_eq!((d.from, d.answers), (client.number, number.unwrap_or(0)));
                seen.added += d.added.len();
                seen.removed += d.removed.len();
                seen.changed += d.changed.len();
                seen.moved += d.changed.iter().filter(|(_, moved)| *moved).count();
                chain.push(d.clone());
                send(d, &snapshot, manner, &mut client);
                clients.push_back(client.clone());
                if clients.len() > REMEMBERED {
                    clients.pop_front();
                }
            }
        }
        assert_eq!(held(&client), after, "seed {seed} step {step}: apply");
        let hash = terraquilt::db::query::set_hash(snapshot.select(&query).unwrap().records.iter());
        assert_eq!(client.hash[..], hash);
        if !manner.descriptors_only {
            let region = snapshot.select(&query).unwrap().region;
            let masks = snapshot.masks(&region).unwrap();
            let masks: BTreeMap<_, _> =
                masks.into_iter().map(|m| ((m.survey.0, u32::from(m.level), m.i, m.j), m.cells)).collect();
            assert_eq!(client.masks, masks);
        }
        // Empty: from a set to itself.
        assert!(ledger.clone().step(target.clone(), None).is_none());
        let itself = ledger.clone().step(target.clone(), Some(9)).unwrap();
        assert!(itself.is_empty() && itself.hash == ledger.last().hash, "{itself:?}");
        // Compose: the way in many steps and the way in one.
        if r.chance(0.1) && !chain.is_empty() {
            let one = lagging.step(target, Some(1)).unwrap();
            let (come, gone) = composed(chain.iter());
            assert_eq!(ids(&one.added), come.into_iter().collect::<Vec<_>>());
            assert_eq!(ids(&one.removed), gone.into_iter().collect::<Vec<_>>());
            seen.composed += chain.len();
            (chain, lagging) = (Vec::new(), ledger.clone());
        }
    }
}

fn run(worlds: u64, count: usize) -> Seen {
    let mut seen = Seen::default();
    seeds(worlds).into_iter().for_each(|seed| steps(seed, count, &mut seen));
    println!("{seen:?}");
    seen
}

#[test]
fn laws_of_differences() {
    let seen = run(4, 150);
    assert!(seen.added > 100 && seen.removed > 100 && seen.changed > 0 && seen.composed > 50, "{seen:?}");
    assert!(seen.unasked > 0 && seen.resumed > 5, "{seen:?}");
}

/// `cargo test --test daemon laws -- --ignored --nocapture`
#[test]
#[ignore = "ten thousand steps: a minute; the command is in its comment"]
fn laws_of_differences_over_ten_thousand_steps() {
    let seen = run(10, 1000);
    assert!(seen.changed > seen.moved && seen.moved > 20, "{seen:?}");
    assert!(seen.anew > 0 && seen.untouched > 0, "{seen:?}");
}

#[test]
fn a_survey_that_was_removed_and_came_again_keeps_its_patches() {
    let s = Scratch::new(Policy::Accuracy);
    let g = hills("h", [0.0, 0.0], 80, 2.0, 0);
    s.ingest(&g);
    let how = How::from(Blend::Exact);
    let manner = Manner { how, descriptors_only: false };
    let query = Query { area: Area::Everything, tolerance: Tolerance::Constant(0.5), how };
    let (mut ledger, mut client) = (Ledger::default(), Set::default());
    let look = |ledger: &mut Ledger, client: &mut Set| {
        let snapshot = Arc::new(s.db.snapshot(None).unwrap());
        let target = Target::of(&snapshot, &query, manner, 1000, ledger.last()).unwrap();
        let d = ledger.step(target, None).unwrap();
        send(d.clone(), &snapshot, manner, client);
        assert_eq!(held(client), answered(&snapshot, &query));
        d
    };
    let first = look(&mut ledger, &mut client);
    s.remove("h");
    s.ingest(&g);
    let second = look(&mut ledger, &mut client);
    assert!(first.patches > 4 && second.added.is_empty() && second.removed.is_empty());
    assert!(second.changed.len() as u64 == first.patches && second.changed.iter().all(|(_, moved)| *moved));
    assert!(client.patches.values().all(|p| client.surveys.contains_key(&p.survey)));
}

/// `n` patches of no survey in particular.
fn invented(n: u32, from: u32) -> Target {
    let record = |k: u32| {
        let mut id = [0; 16];
        id[..4].copy_from_slice(&(from + k).to_be_bytes());
        let place = Place { level: 0, i: k as i32, j: 0 };
        Record { top: 1.0, bot: 0.0, floor: false, survey: SurveyNumber(1), place, id: PatchId(id) }
    };
    Target {
        version: 0,
        records: (0..n).map(record).collect(),
        surveys: vec![Arc::new(v1::SurveyFrame { survey: 1, ..Default::default() })],
        masks: Vec::new(),
        corrections: Vec::new(),
        ground: Arc::default(),
        by_height: false,
    }
}

#[test]
fn large_differences_come_in_messages_that_every_client_takes() {
    let s = Scratch::new(Policy::Accuracy);
    let snapshot = Arc::new(s.db.snapshot(None).unwrap());
    let manner = Manner { how: Blend::Exact.into(), descriptors_only: true };
    let (mut ledger, mut client) = (Ledger::default(), Set::default());
    let d = ledger.step(invented(60_000, 0), Some(1)).unwrap();
    let mut parcel = Parcel::new(d.clone(), snapshot.clone(), false);
    while !parcel.done() {
        let m = prost::Message::encoded_len(&parcel.message().unwrap());
        assert!(m < terraquilt::wire::MESSAGE_BYTES + 4096, "{m} bytes");
    }
    assert!(send(d, &snapshot, manner, &mut client) > 2);
    let d = ledger.step(invented(60_000, 30_000), Some(2)).unwrap();
    assert_eq!((d.added.len(), d.removed.len()), (30_000, 30_000));
    assert!(send(d, &snapshot, manner, &mut client) > 1);
    // Large sets are forgotten sooner; the one before the last is kept.
    let d = ledger.step(invented(60_000, 60_000), Some(3)).unwrap();
    let before = client.clone();
    send(d, &snapshot, manner, &mut client);
    assert!(ledger.weight() <= 120_000, "{}", ledger.weight());
    assert!(!ledger.clone().resume(1, &before.hash));
    assert!(!ledger.clone().resume(2, &client.hash), "a wrong hash");
    assert!(ledger.resume(2, &before.hash));
}
