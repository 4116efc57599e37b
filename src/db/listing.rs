//! What is in a database: surveys, boxes, sizes.

use super::database::Snapshot;
use super::head::{Tile, hex};
use super::root::SurveyEntry;
use super::view::{Rules, View};
use crate::base::Result;
use crate::base::lattice::{Point, Quad};
use crate::height::frame::CellRect;
use crate::height::lod::cover::kernel;
use crate::height::lod::{Place, SurveyNumber};
use crate::store::quadtree::Node;
use crate::store::segment::PageRef;
use serde::{Deserialize, Serialize};

/// One survey, as `terraquilt surveys` shows it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SurveyRow {
    pub id: String,
    pub name: String,
    pub tiles: usize,
    pub crs: String,
    /// Extent of the posts of all tiles together.
    pub cols: i64,
    pub rows: i64,
    pub step: [f64; 2],
    /// Counter-clockwise angle of the columns' direction.
    pub rotation_deg: f64,
    pub accuracy_m: f64,
    pub date: Option<String>,
    /// As it ranks: explicit, or by the policy.
    pub precedence: i64,
    /// xmin, ymin, xmax, ymax of its posts.
    pub bounds: [f64; 4],
    /// The version in which it came.
    pub version: u64,
    pub patches: u64,
    pub live: u64,
    pub dormant: u64,
    pub valid_posts: u64,
    /// Anchor and steps of its integer frame, lattice units: post (i, j) = anchor + i u + j v.
    pub frame: [[i64; 2]; 3],
    /// Index of the first post.
    pub first_post: [i64; 2],
    /// What heights count from, if it was said.
    pub vertical_datum: Option<String>,
    /// How the files were delivered, if they were resampled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delivered: Option<DeliveredRow>,
}

/// Files in another system than the database's.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DeliveredRow {
    pub crs: String,
    pub cols: i64,
    pub rows: i64,
    pub step: [f64; 2],
    pub sample_type: String,
    /// What was done about projection and datum.
    pub operation: String,
}

/// The surveys of a version, in order of arrival.
pub fn surveys(s: &Snapshot) -> Result<Vec<SurveyRow>> {
    s.entries().map(|e| survey_row(s, e)).collect()
}

/// One survey of a version.
pub fn survey_row(s: &Snapshot, e: &SurveyEntry) -> Result<SurveyRow> {
    let head = s.view.head(e.number)?;
    let d = &head.declaration;
    let delivered = head.posts();
    let posts = head.own_posts();
    let corners = CellRect::new(posts.i0, posts.j0, posts.i1 - 1, posts.j1 - 1);
    let b = d.frame.bounds(&corners);
    let size = s.unit.size();
    let u = d.lattice.col_step;
    let xy = |p: Point| [p.x, p.y];
    Ok(SurveyRow {
        id: hex(&e.id),
        name: e.name.clone(),
        tiles: head.tiles.len(),
        crs: d.crs.clone(),
        cols: posts.width(),
        rows: posts.height(),
        step: d.lattice.nominal_steps(),
        rotation_deg: u[1].atan2(u[0]).to_degrees(),
        accuracy_m: d.accuracy_m,
        date: e.date.map(|d| d.to_string()),
        precedence: e.geometry.precedence,
        bounds: [b.min.x as f64 * size, b.min.y as f64 * size, b.max.x as f64 * size, b.max.y as f64 * size],
        version: e.since,
        patches: e.live + e.dormant,
        live: e.live,
        dormant: e.dormant,
        valid_posts: head.valid(),
        frame: [xy(d.frame.anchor), xy(d.frame.u), xy(d.frame.v)],
        first_post: [posts.i0, posts.j0],
        vertical_datum: d.vertical_datum.clone(),
        delivered: d.resampled.as_ref().map(|r| DeliveredRow {
            crs: r.crs.clone(),
            cols: delivered.width(),
            rows: delivered.height(),
            step: r.lattice.nominal_steps(),
            sample_type: r.samples.sample_type.name().to_string(),
            operation: r.operation.clone(),
        }),
    })
}

/// One tile of a survey, as `terraquilt tiles` shows it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TileRow {
    pub cols: i64,
    pub file: String,
    /// Index of its first post on the lattice it was delivered on.
    pub first: [i64; 2],
    pub key: String,
    pub rows: i64,
    /// Posts with data.
    pub valid: u64,
    pub z_max: f64,
    pub z_min: f64,
}

/// The tiles of a survey (a name, or the beginning of an id), by file name.
pub fn tiles(s: &Snapshot, survey: &str) -> Result<Vec<TileRow>> {
    let head = s.view.head(s.survey(survey)?.number)?;
    let mut tiles: Vec<_> = head.tiles.iter().collect();
    tiles.sort_by(|a, b| a.file.cmp(&b.file).then(a.key.cmp(&b.key)));
    let row = |t: &Tile| TileRow {
        cols: t.posts.width(),
        file: t.file.clone(),
        first: [t.posts.i0, t.posts.j0],
        key: t.id(),
        rows: t.posts.height(),
        valid: t.valid,
        z_max: t.z[1],
        z_min: t.z[0],
    };
    Ok(tiles.into_iter().map(row).collect())
}

/// What the heights of a version count from: the one datum that its surveys name. None if nobody said, or surveys
/// differ.
pub fn vertical_datum(s: &Snapshot) -> Result<Option<String>> {
    let mut one: Option<String> = None;
    for e in s.entries() {
        let Some(own) = s.view.head(e.number)?.declaration.vertical_datum.clone() else { continue };
        if one.as_ref().is_some_and(|o| *o != own) {
            return Ok(None);
        }
        one = Some(own);
    }
    Ok(one)
}

/// One patch as exact integers, for independent checking.
#[derive(Clone, Debug, Serialize)]
pub struct BoxRow {
    pub id: String,
    pub key: String,
    pub survey: String,
    pub level: u8,
    pub index: [i32; 2],
    /// Convex pieces, lattice units, counter-clockwise.
    pub kernel: Vec<Vec<[i64; 2]>>,
    pub domain: [[i64; 2]; 4],
    pub area: f64,
    pub err: f32,
    /// `null`: never covered.
    pub top: Option<f32>,
    pub state: &'static str,
    pub floor: bool,
}

/// How far a walk over the patches of a version has come: the survey, and the next of its pages.
#[derive(Clone, Copy, Debug, Default)]
pub struct BoxWalk {
    survey: u32,
    page: usize,
}

/// Calls `f` with every patch of a version, survey by survey.
pub fn boxes(s: &Snapshot, mut f: impl FnMut(BoxRow) -> Result<()>) -> Result<()> {
    let mut walk = BoxWalk::default();
    while let Some(rows) = more_boxes(s, &mut walk)? {
        rows.into_iter().try_for_each(&mut f)?;
    }
    Ok(())
}

/// The next patches of a version, a page of them (some hundreds at most); `None` after the last.
pub fn more_boxes(s: &Snapshot, walk: &mut BoxWalk) -> Result<Option<Vec<BoxRow>>> {
    use super::view::Tables;
    let Some((_, e)) = s.view.entries().range(SurveyNumber(walk.survey)..).next() else { return Ok(None) };
    let first = if e.number.0 == walk.survey { walk.page } else { 0 };
    let Some((at, _)) = s.view.head(e.number)?.pages.get(first).copied() else {
        *walk = BoxWalk { survey: e.number.0 + 1, page: 0 };
        return Ok(Some(Vec::new()));
    };
    *walk = BoxWalk { survey: e.number.0, page: first + 1 };
    let rules = Rules(&s.view);
    let corners = |q: Quad| q.0.map(|p| [p.x, p.y]);
    let g = &e.geometry;
    let mut rows = Vec::new();
    s.view.each_patch_of(e.number, at, |place, p, t| {
        let pieces = kernel(&rules, e.number, place)?;
        let key = p.fact.id.to_string();
        rows.push(BoxRow {
            id: key.clone(),
            key,
            survey: hex(&e.id),
            level: place.level,
            index: [place.i, place.j],
            kernel: pieces.iter().map(|r| corners(g.frame.quad(r)).to_vec()).collect(),
            domain: corners(g.frame.quad(&place.domain())),
            area: g.area(place.level),
            err: p.fact.bot,
            top: t.standing.top.is_finite().then_some(t.standing.top),
            state: if t.standing.top > p.fact.bot { "live" } else { "dormant" },
            floor: t.standing.floor,
        });
        Ok(())
    })?;
    Ok(Some(rows))
}

/// Sizes and counts of a version.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Info {
    pub path: String,
    pub format_version: u32,
    pub derivation_version: u32,
    pub crs: String,
    pub policy: String,
    /// CRS units (metres, or degrees) in one lattice unit.
    pub lattice_unit: f64,
    pub version: u64,
    pub surveys: usize,
    pub tiles: usize,
    pub valid_posts: u64,
    pub patches: u64,
    pub live: u64,
    pub dormant: u64,
    pub tree_nodes: u64,
    pub tree_records: u64,
    pub tree_depth: u8,
    /// Nodes in which a live patch is stored, on average.
    pub nodes_per_patch: f64,
    /// Domains over a point of the finest surface, on average and at most (sampled).
    pub overlap_mean: f64,
    pub overlap_max: u64,
    pub files: usize,
    pub bytes: u64,
    pub bytes_live: u64,
    pub bytes_per_post: f64,
    /// Bytes of the segments of every version that is kept; `prune` gives back what only older ones read.
    pub bytes_all_versions: u64,
}

/// Gathers sizes and counts. Walks the whole tree.
pub fn info(db: &super::Db, s: &Snapshot) -> Result<Info> {
    let mut i = Info {
        path: db.path().display().to_string(),
        format_version: db.format(),
        derivation_version: super::root::DERIVATION_VERSION,
        crs: s.crs.code.clone(),
        policy: s.policy.name().to_string(),
        lattice_unit: s.unit.size(),
        version: s.number(),
        surveys: 0,
        tiles: 0,
        valid_posts: 0,
        patches: 0,
        live: 0,
        dormant: 0,
        tree_nodes: 0,
        tree_records: 0,
        tree_depth: 0,
        nodes_per_patch: 0.0,
        overlap_mean: 0.0,
        overlap_max: 0,
        files: 0,
        bytes: 0,
        bytes_live: 0,
        bytes_per_post: 0.0,
        bytes_all_versions: db.catalog_for_reading()?.all_files()?.iter().map(|(_, len)| len).sum(),
    };
    for e in s.entries() {
        let head = s.view.head(e.number)?;
        i.surveys += 1;
        i.tiles += head.tiles.len();
        i.valid_posts += head.valid();
        i.live += e.live;
        i.dormant += e.dormant;
    }
    i.patches = i.live + i.dormant;
    if let Some(t) = &s.view.tree {
        let mut stack = vec![(t.page, 0u8)];
        while let Some((at, depth)) = stack.pop() {
            let n = Node::read(&s.view.files, &at)?;
            i.tree_nodes += 1;
            i.tree_records += n.records.len() as u64;
            i.tree_depth = i.tree_depth.max(depth);
            stack.extend(n.children.iter().flatten().map(|c| (c.page, depth + 1)));
        }
    }
    i.nodes_per_patch = if i.live > 0 { i.tree_records as f64 / i.live as f64 } else { 0.0 };
    (i.overlap_mean, i.overlap_max) = overlap(s)?;
    if s.number() > 0 {
        for f in db.catalog_for_reading()?.files(s.number())? {
            i.files += 1;
            i.bytes += f.length;
            i.bytes_live += f.live;
        }
    }
    i.bytes_per_post = if i.valid_posts > 0 { i.bytes_live as f64 / i.valid_posts as f64 } else { 0.0 };
    Ok(i)
}

/// Domains of the patches that a query at tolerance 0 needs, over sampled points.
fn overlap(s: &Snapshot) -> Result<(f64, u64)> {
    use super::query::{Area, Query, Tolerance};
    use crate::height::surface::Blend;
    let (mut n, mut sum, mut most) = (0u64, 0u64, 0u64);
    let size = s.unit.size();
    for e in s.entries() {
        let g = &e.geometry;
        let places = crate::height::lod::places_meeting(0, &g.core);
        let step = ((places.width() * places.height()) as f64 / 64.0).sqrt().ceil().max(1.0) as usize;
        for j in (places.j0..places.j1).step_by(step) {
            for i in (places.i0..places.i1).step_by(step) {
                let r = Place::new(0, i, j).rect();
                // Another spot of the kernel each time: centres alone would never meet a neighbour's domain.
                let spot = |by: u64| (n * by % 28) as i64;
                let c = g.frame.post(r.i0 + spot(11), r.j0 + spot(17));
                let p = [c.x as f64 * size, c.y as f64 * size];
                let pad = g.steps[0].min(g.steps[1]) * 1e-3;
                let query = Query {
                    area: Area::Box([p[0] - pad, p[1] - pad, p[0] + pad, p[1] + pad]),
                    tolerance: Tolerance::Constant(0.0),
                    how: Blend::Exact.into(),
                };
                let count = s.select(&query)?.records.len() as u64;
                (n, sum, most) = (n + 1, sum + count, most.max(count));
            }
        }
    }
    Ok((if n > 0 { sum as f64 / n as f64 } else { 0.0 }, most))
}

/// Name of a survey, for messages.
pub fn name_of(view: &View, n: SurveyNumber) -> String {
    view.entry(n).map_or_else(|_| format!("survey {}", n.0), |e| e.name.clone())
}

/// One node of the tree as a version holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct TreeNode {
    /// Ids of the records, in order.
    pub ids: Vec<String>,
    /// South-west, south-east, north-west, north-east.
    pub children: [Option<Box<TreeNode>>; 4],
}

/// The whole tree of a version, for independent checking; `None` before the first commit.
pub fn tree(s: &Snapshot) -> Result<Option<TreeNode>> {
    fn read(view: &View, at: &PageRef) -> Result<TreeNode> {
        let n = Node::read(&view.files, at)?;
        let mut out = TreeNode {
            ids: n.records.iter().map(|r| r.id.to_string()).collect(),
            children: Default::default(),
        };
        for (slot, c) in out.children.iter_mut().zip(&n.children) {
            if let Some(c) = c {
                *slot = Some(Box::new(read(view, &c.page)?));
            }
        }
        Ok(out)
    }
    s.view.tree.as_ref().map(|t| read(&s.view, &t.page)).transpose()
}

/// One node of the tree, for independent checking.
#[derive(Clone, Debug, Serialize)]
pub struct NodeRow {
    /// Quarters on the way from the root: 0 south-west, 1 south-east, 2 north-west, 3 north-east.
    pub path: String,
    /// Ids of the records, in order.
    pub ids: Vec<String>,
    pub children: [bool; 4],
}

/// A walk over the nodes of the tree of a version, parents first.
pub struct TreeWalk(Vec<(String, PageRef)>);

impl TreeWalk {
    pub fn new(s: &Snapshot) -> TreeWalk {
        TreeWalk(s.view.tree.iter().map(|t| (String::new(), t.page)).collect())
    }

    /// The next node of the version that the walk was begun with; `None` after the last.
    pub fn more(&mut self, s: &Snapshot) -> Result<Option<NodeRow>> {
        let Some((path, at)) = self.0.pop() else { return Ok(None) };
        let n = Node::read(&s.view.files, &at)?;
        let below = n.children.iter().enumerate().rev();
        self.0.extend(below.filter_map(|(k, c)| c.as_ref().map(|c| (format!("{path}{k}"), c.page))));
        Ok(Some(NodeRow {
            ids: n.records.iter().map(|r| r.id.to_string()).collect(),
            children: n.children.each_ref().map(Option::is_some),
            path,
        }))
    }
}
