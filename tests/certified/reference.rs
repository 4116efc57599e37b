//! The surface once more, from the definitions of the LOD-space specification alone: no index, no caches,
//! exact integer positions, every live patch tried at every point.

use crate::oracle::overlay::{core_prime, faces};
use crate::oracle::spline::{self, cardinal};
use crate::oracle::survey::{Cells, core, error_up};
use crate::oracle::{KERNEL, MARGIN, OracleSurvey};
use crate::support::{Grid, Random};
use std::sync::OnceLock;
use terraquilt::db::{BoxRow, Snapshot, boxes, surveys};
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::Blend;

/// CRS units in a lattice unit, for coordinate systems in metres.
const UNIT: f64 = 1.0 / (1u64 << 35) as f64;
/// Vertices along the side of a patch.
const SIDE: i64 = KERNEL + 2 * MARGIN + 1;
/// Nearer to a cell border than this (in cells), `f64` may take a point for one on the other side.
pub const NEAR: f64 = 1e-6;

/// Where a point lies on the lattice of a survey: a cell, and how far in.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    pub cell: [i64; 2],
    pub part: [f64; 2],
}

/// A survey and what follows from it.
pub struct Survey {
    pub name: String,
    pub number: u32,
    pub posts: OracleSurvey,
    /// e(G).
    pub e: f64,
    smooth: bool,
    /// core'.
    pub kept: Cells,
    /// Cells of core', and those of them with a neighbour that is not.
    pub cells: Vec<[i64; 2]>,
    pub rim: Vec<[i64; 2]>,
}

/// A live patch.
pub struct Patch {
    pub id: String,
    pub survey: usize,
    pub bot: f64,
    pub top: f64,
    floor: bool,
    /// Posts from one vertex to the next.
    pub stride: i64,
    /// Index of the first post of the domain.
    pub first: [i64; 2],
    vertices: OnceLock<Vec<f64>>,
}

/// Surveys and live patches of one version.
pub struct World {
    pub snapshot: Snapshot,
    pub surveys: Vec<Survey>,
    pub patches: Vec<Patch>,
    pub z: [f64; 2],
    /// Bicubic patches, weights of class C2.
    smooth: bool,
    /// The database, kept for as long as its files may be read.
    #[expect(dead_code, reason = "its drop removes the files")]
    home: Option<tempfile::TempDir>,
}

impl Survey {
    /// The exact place of a point, by integers.
    pub fn spot(&self, p: [f64; 2]) -> Spot {
        let d = [0, 1].map(|k| {
            let x = p[k] / UNIT;
            assert!(x.fract() == 0.0, "coordinates are large enough to be lattice points");
            x as i128 - i128::from(self.posts.anchor[k])
        });
        let ([ux, uy], [vx, vy]) = (self.posts.u.map(i128::from), self.posts.v.map(i128::from));
        let det = ux * vy - uy * vx;
        let along = [(d[0] * vy - d[1] * vx) * det.signum(), (ux * d[1] - uy * d[0]) * det.signum()];
        Spot {
            cell: along.map(|a| a.div_euclid(det.abs()) as i64),
            part: along.map(|a| a.rem_euclid(det.abs()) as f64 / det.abs() as f64),
        }
    }

    /// The point at `part` of a cell, rounded to what an `f64` can hold.
    pub fn point(&self, cell: [i64; 2], part: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| {
            let (u, v) = (self.posts.u[k], self.posts.v[k]);
            let post = self.posts.anchor[k] + cell[0] * u + cell[1] * v;
            (post + (part[0] * u as f64 + part[1] * v as f64).round() as i64) as f64 * UNIT
        })
    }

    /// The 3 x 3 cells around a spot that are in core', as offsets.
    fn around(&self, s: &Spot) -> impl Iterator<Item = [i64; 2]> + '_ {
        let cell = s.cell;
        (-1..2)
            .flat_map(|b| (-1..2).map(move |a| [a, b]))
            .filter(move |o| self.kept.contains([cell[0] + o[0], cell[1] + o[1]]))
    }

    /// v of section 9, and 1 - v.
    pub fn v(&self, s: &Spot) -> (f64, f64) {
        let ramp = |offset: i64, part: f64| match offset {
            -1 => 1.0 - part,
            0 => 1.0,
            _ => part,
        };
        let ramp = |offset: i64, part: f64| fade(self.smooth, ramp(offset, part));
        let out: f64 = self.around(s).map(|o| 1.0 - ramp(o[0], s.part[0]) * ramp(o[1], s.part[1])).product();
        (1.0 - out, out)
    }

    /// Whether the point is in the closed core', by more than rounding: (surely, perhaps).
    pub fn surely(&self, s: &Spot) -> (bool, bool) {
        let reach = |o: i64, part: f64| match o {
            -1 => part < NEAR,
            0 => true,
            _ => part > 1.0 - NEAR,
        };
        let close = |o: [i64; 2]| reach(o[0], s.part[0]) && reach(o[1], s.part[1]);
        let within = self.around(s).filter(|o| close(*o)).count();
        let all = (-1..2).flat_map(|b| (-1..2).map(move |a| [a, b])).filter(|o| close(*o)).count();
        (within == all, within > 0)
    }

    /// Height of a post; `None` where there is none.
    pub fn post(&self, at: [i64; 2]) -> Option<f64> {
        let (i, j) = (at[0] - self.posts.first[0], at[1] - self.posts.first[1]);
        let there = (0..self.posts.cols as i64).contains(&i) && (0..self.posts.rows as i64).contains(&j);
        if there { self.posts.heights[j as usize * self.posts.cols + i as usize] } else { None }
    }

    /// A vertex of stride r: its sample, else the mean of the valid ones less than r away, else 0.
    fn vertex(&self, r: i64, at: [i64; 2]) -> f64 {
        if let Some(z) = self.post(at) {
            return z;
        }
        let (mut sum, mut count) = (0.0, 0);
        for j in at[1] - r + 1..at[1] + r {
            for i in at[0] - r + 1..at[0] + r {
                if let Some(z) = self.post([i, j]) {
                    (sum, count) = (sum + z, count + 1);
                }
            }
        }
        if count == 0 { 0.0 } else { f64::from((sum / f64::from(count)) as f32) }
    }

    /// Posts that are a corner of a cell of core'.
    pub fn guaranteed_posts(&self) -> Vec<[i64; 2]> {
        let mut all: Vec<[i64; 2]> =
            self.cells.iter().flat_map(|&[i, j]| [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]]).collect();
        all.sort_unstable();
        all.dedup();
        all
    }
}

impl Patch {
    fn vertices(&self, survey: &Survey) -> &[f64] {
        self.vertices.get_or_init(|| {
            if survey.smooth {
                return spline::vertices(&survey.posts, self.stride, self.first);
            }
            (0..SIDE * SIDE)
                .map(|n| {
                    let at = [n % SIDE, n / SIDE];
                    survey.vertex(self.stride, [0, 1].map(|k| self.first[k] + at[k] * self.stride))
                })
                .collect()
        })
    }
}

impl Patch {
    /// At a place in cells of the patch, from its first vertex.
    pub fn at(&self, survey: &Survey, c: [f64; 2]) -> f64 {
        let f = self.vertices(survey);
        if survey.smooth {
            return spline::at(f, &cardinal(c[0]), &cardinal(c[1]));
        }
        let at = c.map(|c| (c.floor() as i64).min(SIDE - 2));
        let t = [c[0] - at[0] as f64, c[1] - at[1] as f64];
        let corner = |a: i64, b: i64| f[((at[1] + b) * SIDE + at[0] + a) as usize];
        corner(0, 0) * (1.0 - t[0]) * (1.0 - t[1])
            + corner(1, 0) * t[0] * (1.0 - t[1])
            + corner(0, 1) * (1.0 - t[0]) * t[1]
            + corner(1, 1) * t[0] * t[1]
    }
}

/// The ramp g, of class C0 or C2.
fn fade(smooth: bool, t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    if smooth { 10.0 * t.powi(3) - 15.0 * t.powi(4) + 6.0 * t.powi(5) } else { t }
}

impl World {
    /// The world with its database, which stays until the world goes.
    pub fn at_home(self, home: tempfile::TempDir) -> World {
        World { home: Some(home), ..self }
    }

    /// `exact`: core' from the overlay of all lattices; else from cells that are sure, and from the printed
    /// kernels along borders.
    pub fn new(snapshot: Snapshot, grids: &[Grid], exact: bool) -> World {
        let rows = surveys(&snapshot).unwrap();
        let posts: Vec<OracleSurvey> = rows
            .iter()
            .map(|r| {
                let g = grids.iter().find(|g| g.name == r.name).unwrap();
                OracleSurvey {
                    id: r.id.clone(),
                    anchor: r.frame[0],
                    u: r.frame[1],
                    v: r.frame[2],
                    first: r.first_post,
                    cols: g.cols,
                    rows: g.rows,
                    heights: g.z.iter().map(|z| z.is_finite().then_some(f64::from(*z))).collect(),
                    nominal_step: r.step,
                    accuracy: g.accuracy,
                    precedence: r.precedence,
                }
            })
            .collect();
        World::of_posts(snapshot, posts, exact)
    }

    /// The same from posts as the oracle takes them.
    pub fn of_posts(snapshot: Snapshot, posts: Vec<OracleSurvey>, exact: bool) -> World {
        let rows = surveys(&snapshot).unwrap();
        let smooth = snapshot.kind() == Kind::Bicubic;
        let cores: Vec<Cells> = posts.iter().map(core).collect();
        let mut printed: Vec<BoxRow> = Vec::new();
        boxes(&snapshot, |b| {
            printed.push(b);
            Ok(())
        })
        .unwrap();
        let kept = if exact {
            core_prime(&posts, &cores, &faces(&posts, &cores))
        } else {
            sure_core_prime(&posts, &cores, &printed)
        };
        let number: Vec<u32> = snapshot.entries().map(|e| e.number.0).collect();
        let z = posts.iter().flat_map(|s| s.heights.iter().flatten());
        let z = z.fold([f64::INFINITY, f64::NEG_INFINITY], |r, z| [r[0].min(*z), r[1].max(*z)]);
        let of = |id: &str| posts.iter().position(|s| s.id == id).unwrap();
        let patches = printed
            .iter()
            .filter(|b| b.top.is_none_or(|t| t > b.err))
            .map(|b| Patch {
                id: b.id.clone(),
                survey: of(&b.survey),
                bot: f64::from(b.err),
                top: b.top.map_or(f64::INFINITY, f64::from),
                floor: b.floor,
                stride: 1 << b.level,
                first: b.index.map(|k| (KERNEL * i64::from(k) - MARGIN) << b.level),
                vertices: OnceLock::new(),
            })
            .collect();
        let surveys = posts
            .into_iter()
            .zip(kept)
            .enumerate()
            .map(|(k, (posts, kept))| {
                let cells: Vec<[i64; 2]> = kept.iter().collect();
                let inner =
                    |c: &[i64; 2]| (-1..2).all(|b| (-1..2).all(|a| kept.contains([c[0] + a, c[1] + b])));
                let rim = cells.iter().filter(|c| !inner(c)).copied().collect();
                let e = f64::from(error_up(posts.accuracy, 0.0));
                Survey { name: rows[k].name.clone(), number: number[k], posts, e, smooth, kept, cells, rim }
            })
            .collect();
        World { snapshot, surveys, patches, z, smooth, home: None }
    }

    pub fn range(&self) -> f64 {
        self.z[1] - self.z[0]
    }

    /// Least stated accuracy over the surveys whose core' surely holds p; whether some core' surely, perhaps
    /// does.
    pub fn best(&self, p: [f64; 2]) -> (f64, bool, bool) {
        self.surveys.iter().fold((f64::INFINITY, false, false), |(e, sure, maybe), s| {
            let (inside, near) = s.surely(&s.spot(p));
            (if inside { e.min(s.e) } else { e }, sure || inside, maybe || near)
        })
    }

    /// F(p, delta) and normalised weights by patch number, by trying every live patch.
    pub fn brute(&self, p: [f64; 2], z: f64, blend: Blend) -> Option<(f64, Vec<(usize, f64)>)> {
        let spots: Vec<Spot> = self.surveys.iter().map(|s| s.spot(p)).collect();
        let v: Vec<(f64, f64)> = self.surveys.iter().zip(&spots).map(|(s, at)| s.v(at)).collect();
        let kappa = 1.1;
        let ramp = |t: f64| fade(self.smooth, t);
        let mut found = Vec::new();
        for (k, patch) in self.patches.iter().enumerate() {
            let (survey, spot) = (&self.surveys[patch.survey], &spots[patch.survey]);
            let r = patch.stride as f64;
            // In cells of the patch, from the first vertex of its domain.
            let c = [0, 1].map(|a| ((spot.cell[a] - patch.first[a]) as f64 + spot.part[a]) / r);
            let side = (SIDE - 1) as f64;
            if c.iter().any(|c| *c <= 0.0 || *c >= side) || v[patch.survey].0 <= 0.0 {
                continue;
            }
            let bump = |c: f64| {
                let x = (c - side / 2.0).abs() / (side / 2.0);
                if self.smooth { 1.25 * (1.0 - x).powi(3) * (3.0 * x + 1.0) } else { 1.0 - x }
            };
            let half = survey.posts.nominal_step.map(|s| s * r * side / 2.0);
            let peak = bump(c[0]) * bump(c[1]) / (half[0] * half[1]);
            let weight = if blend == Blend::Plain {
                if patch.bot <= z && z < patch.top { peak } else { 0.0 }
            } else {
                let up = if patch.bot == 0.0 || z == f64::INFINITY {
                    1.0
                } else {
                    ramp((z - patch.bot) / ((kappa - 1.0) * patch.bot))
                };
                let down = if patch.top == f64::INFINITY {
                    1.0
                } else {
                    1.0 - ramp((z - patch.top) / ((kappa - 1.0) * patch.top))
                };
                let up = if patch.floor {
                    let better = self.surveys.iter().zip(&v).filter(|(h, _)| h.e < patch.bot);
                    up + (1.0 - up) * better.map(|(_, v)| v.1).product::<f64>()
                } else {
                    up
                };
                peak * v[patch.survey].0 * up * down
            };
            if weight > 0.0 {
                found.push((k, weight, patch.at(survey, c)));
            }
        }
        let sum: f64 = found.iter().map(|(_, w, _)| w).sum();
        let height = found.iter().map(|(_, w, f)| w / sum * f).sum();
        (!found.is_empty()).then(|| (height, found.iter().map(|(k, w, _)| (*k, w / sum)).collect()))
    }

    /// Points inside D_K: anywhere, at posts, on cell and kernel borders, along the rims of core', and one ulp
    /// beside.
    pub fn points(&self, r: &mut Random, survey: usize, count: usize) -> Vec<[f64; 2]> {
        let s = &self.surveys[survey];
        if s.cells.is_empty() {
            return Vec::new();
        }
        let pick = |r: &mut Random, v: &[[i64; 2]]| v[r.below(v.len() as u64) as usize];
        let mut out = Vec::with_capacity(count);
        while out.len() < count {
            let kind = r.below(10);
            let mut cell = pick(r, if kind >= 6 { &s.rim } else { &s.cells });
            let mut part = [r.unit(), r.unit()];
            match kind {
                3 => part = [0.0; 2],
                4 | 7 => part[r.below(2) as usize] = 0.0,
                5 => {
                    // A kernel or domain border of some level, where it is inside core'.
                    let (k, level) = (r.below(2) as usize, r.below(4));
                    let line = KERNEL << level;
                    let shift = [0, -MARGIN, MARGIN][r.below(3) as usize] << level;
                    cell[k] = (cell[k] as f64 / line as f64).round() as i64 * line + shift;
                    part[k] = 0.0;
                    if !s.kept.contains(cell) {
                        continue;
                    }
                }
                8 => part = part.map(|t| if r.chance(0.5) { 0.0 } else { t }),
                _ => {}
            }
            let mut p = s.point(cell, part);
            if kind > 2 && r.chance(0.3) {
                let k = r.below(2) as usize;
                p[k] = if r.chance(0.5) { p[k].next_up() } else { p[k].next_down() };
            }
            out.push(p);
        }
        out
    }
}

/// core' of large worlds: removed where one higher survey alone surely covers the cell, kept where some point
/// of it is outside every higher core; what neither decides (cells along borders) is taken from the printed kernels.
fn sure_core_prime(posts: &[OracleSurvey], cores: &[Cells], printed: &[BoxRow]) -> Vec<Cells> {
    let frame = |s: &OracleSurvey| {
        let ([ux, uy], [vx, vy]) = (s.u.map(|k| k as f64), s.v.map(|k| k as f64));
        let det = ux * vy - uy * vx;
        let a = s.anchor.map(|k| k as f64);
        move |x: f64, y: f64| {
            let d = [x - a[0], y - a[1]];
            [(d[0] * vy - d[1] * vx) / det, (ux * d[1] - uy * d[0]) / det]
        }
    };
    let mut all = cores.to_vec();
    for (g, kept) in all.iter_mut().enumerate() {
        let above: Vec<usize> =
            (0..posts.len()).filter(|h| posts[*h].precedence > posts[g].precedence).collect();
        let own = frame(&posts[g]);
        let mut shown = vec![false; kept.inside.len()];
        for b in printed.iter().filter(|b| b.level == 0 && b.survey == posts[g].id) {
            for piece in &b.kernel {
                let at = piece.iter().map(|c| own(c[0] as f64, c[1] as f64).map(|t| t.round() as i64));
                let at: Vec<[i64; 2]> = at.collect();
                let ends = |k: usize| {
                    (at.iter().map(|c| c[k]).min().unwrap(), at.iter().map(|c| c[k]).max().unwrap())
                };
                let ((i0, i1), (j0, j1)) = (ends(0), ends(1));
                for cell in (j0..j1).flat_map(|j| (i0..i1).map(move |i| [i, j])) {
                    shown[kept.number(cell).expect("a kernel lies in the core")] = true;
                }
            }
        }
        let frames: Vec<_> = above.iter().map(|h| frame(&posts[*h])).collect();
        for n in (0..kept.inside.len()).filter(|n| cores[g].inside[*n]) {
            let [i, j] = kept.index(n);
            let at = |s: f64, t: f64| {
                let (s, t) = (i as f64 + s, j as f64 + t);
                [0, 1]
                    .map(|k| posts[g].anchor[k] as f64 + s * posts[g].u[k] as f64 + t * posts[g].v[k] as f64)
            };
            let corners = [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)];
            let covered = above.iter().zip(&frames).any(|(h, f)| {
                let c = corners.map(|p| f(p[0], p[1]));
                let range = |k: usize| {
                    let (lo, hi) =
                        c.iter().fold((f64::MAX, f64::MIN), |(l, h), c| (l.min(c[k]), h.max(c[k])));
                    (lo - NEAR).floor() as i64..=(hi + NEAR).floor() as i64
                };
                range(0).all(|a| range(1).all(|b| cores[*h].contains([a, b])))
            });
            let seen = || {
                (0..25).any(|m| {
                    let p = at(0.02 + 0.24 * f64::from(m % 5), 0.02 + 0.24 * f64::from(m / 5));
                    above.iter().zip(&frames).all(|(h, f)| {
                        let c = f(p[0], p[1]);
                        let clear = |d: [f64; 2]| {
                            !cores[*h].contains([(c[0] + d[0]).floor() as i64, (c[1] + d[1]).floor() as i64])
                        };
                        [[NEAR, NEAR], [-NEAR, NEAR], [NEAR, -NEAR], [-NEAR, -NEAR]].into_iter().all(clear)
                    })
                })
            };
            kept.inside[n] = if covered {
                assert!(!shown[n], "cell {i}, {j} of {} is replaced, yet in a kernel", posts[g].id);
                false
            } else if above.is_empty() || seen() {
                assert!(shown[n], "cell {i}, {j} of {} is not replaced, yet in no kernel", posts[g].id);
                true
            } else {
                shown[n]
            };
        }
    }
    all
}
