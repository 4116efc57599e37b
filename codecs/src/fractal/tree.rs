//! The tree of ranges in the stream: level by level, large to small, the means, then what each range is.
//!
//! A range that is split has a mean, too: that of its children, rounded. Its children are told by what is left when the slope between the
//! ranges around is taken away, the last of them by the sum. So a stream that is cut between levels, or anywhere, shows the means of what it has.

use super::grid::points;
use super::ifs::{Ifs, Leaf, Shape};
use super::number::{Choice, Numbers, length, uniform};
use crate::mixing::{self, Count, Weights};
use crate::range::Coder;

/// What a range is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Node<const D: usize> {
    /// Its children tell.
    Split,
    /// Its mean alone.
    Flat,
    /// A map; the level of s is not 0.
    Map { scale: i8, isometry: u8, domain: [u16; D] },
}

/// What the encoder knows of the ranges, by level and by place in memory among the cells of the level.
pub(super) trait Source<const D: usize> {
    fn mean(&self, level: usize, at: usize) -> i32;
    fn node(&self, level: usize, at: usize) -> Node<D>;
}

/// For decoders: nothing is known.
pub(super) struct Unknown;

impl<const D: usize> Source<D> for Unknown {
    fn mean(&self, _: usize, _: usize) -> i32 {
        0
    }
    fn node(&self, _: usize, _: usize) -> Node<D> {
        Node::Flat
    }
}

/// Numbers of means stay within this either way: sums of eight of them, eightfold, stay within 32 bits.
pub(super) const MEAN_MAX: i32 = 1 << 25;

/// Lengths that contexts tell apart.
const LENGTHS: usize = 20;
/// Levels that contexts tell apart.
const LEVELS: usize = 6;

/// The values of one level.
struct Cells<const D: usize, T> {
    size: [usize; D],
    of: Vec<T>,
}

impl<const D: usize, T: Copy> Cells<D, T> {
    #[inline(always)]
    fn at(&self, p: [usize; D]) -> usize {
        (0..D).rev().fold(0, |at, a| at * self.size[a] + p[a])
    }
    /// The values before and after a cell along an axis; its own at the border.
    #[inline(always)]
    fn sides(&self, p: [usize; D], axis: usize) -> [T; 2] {
        let (mut before, mut after) = (p, p);
        before[axis] = p[axis].saturating_sub(1);
        after[axis] = (p[axis] + 1).min(self.size[axis] - 1);
        [self.of[self.at(before)], self.of[self.at(after)]]
    }
}

/// Slopes along the axes, and how restless the ground is.
struct Lie<const D: usize> {
    slope: [i64; D],
    activity: usize,
}

impl<const D: usize> Lie<D> {
    fn of(means: &Cells<D, i32>, p: [usize; D]) -> Lie<D> {
        let own = i64::from(means.of[means.at(p)]);
        let mut slope = [0; D];
        let mut activity = 0;
        for (a, slope) in slope.iter_mut().enumerate() {
            let [before, after] = means.sides(p, a).map(i64::from);
            *slope = after - before;
            activity += slope.abs() + 2 * (after + before - 2 * own).abs();
        }
        Lie { slope, activity: length(activity).min(LENGTHS - 1) }
    }
}

/// What is learnt of a tree.
struct Models {
    means: Numbers,
    last: Vec<Choice>,
    kinds: Vec<Count>,
    weights: [[Weights<3>; 3]; LEVELS],
    scales: Vec<Choice>,
    signs: Vec<Count>,
}

/// Contexts of a kind's decision: by activity, by the kinds around, by the slope alone and the siblings.
const KIND_CONTEXTS: [usize; 3] = [LENGTHS, 64, LENGTHS * 4];

impl Models {
    fn new(axes: usize, scale_bits: u32) -> Models {
        Models {
            means: Numbers::new([LEVELS * LENGTHS, LENGTHS * 8, LENGTHS * 4]),
            last: vec![Choice::new(axes as u32); LENGTHS * 2],
            kinds: vec![Count::NEW; LEVELS * 3 * KIND_CONTEXTS.iter().sum::<usize>()],
            weights: [[Weights::new(); 3]; LEVELS],
            scales: vec![Choice::new(scale_bits - 1); LEVELS * 2],
            signs: vec![Count::NEW; LEVELS * 2],
        }
    }

    fn kind<C: Coder>(
        &mut self,
        c: &mut C,
        level: usize,
        which: usize,
        contexts: [usize; 3],
        bit: bool,
    ) -> bool {
        let row = (level * 3 + which) * KIND_CONTEXTS.iter().sum::<usize>();
        let at = [
            row + contexts[0],
            row + KIND_CONTEXTS[0] + contexts[1],
            row + KIND_CONTEXTS[0] + 64 + contexts[2],
        ];
        mixing::code(c, &mut self.kinds, at, &mut self.weights[level][which], bit)
    }
}

const UNSEEN: u8 = 0;
const FLAT: u8 = 1;
const MAPPED: u8 = 2;
const SPLIT: u8 = 3;

/// Codes a tree. Of a stream that ends early the ranges that are missing are flat, with the last mean that is known of them.
pub(super) fn code<C: Coder, S: Source<D>, const D: usize>(
    shape: &Shape<D>,
    source: &S,
    c: &mut C,
) -> Ifs<D> {
    let mut out = Ifs {
        shape: shape.clone(),
        leaves: Vec::new(),
        units: Vec::new(),
        unit_means: Vec::new(),
        complete: true,
    };
    let mut models = Models::new(D, shape.scale_bits);
    let mut means = Cells { size: shape.cells(0), of: Vec::new() };
    let mut nodes: Vec<[u16; D]> = points(shape.cells(0)).map(|p| p.map(|v| v as u16)).collect();
    means.of = vec![0; nodes.len()];
    // Ranges of the level before that are split.
    let mut parents = Vec::new();
    for level in 0..shape.levels() {
        if level > 0 && parents.is_empty() {
            break;
        }
        if level == 0 {
            roots(source, &mut models, &mut means, &nodes, c);
        } else {
            let coarse = means;
            means = finer(&coarse, shape.cells(level));
            children(source, &mut models, level, &coarse, &mut means, &parents, c);
            drop(coarse);
            if shape.side(level) == 1 {
                out.unit_means = Vec::with_capacity(parents.len() << D);
                let ours = parents.iter().flat_map(family);
                out.unit_means.extend(ours.map(|n| means.of[means.at(n.map(usize::from))]));
                out.units = parents;
                break;
            }
            nodes = Vec::with_capacity(parents.len() << D);
            nodes.extend(parents.iter().flat_map(family));
        }
        parents = kinds(source, &mut models, level, &means, &nodes, &mut out, c);
    }
    out.complete = !c.ended();
    out
}

/// The means of the largest ranges, row by row: by those before them.
fn roots<C: Coder, S: Source<D>, const D: usize>(
    source: &S,
    models: &mut Models,
    means: &mut Cells<D, i32>,
    nodes: &[[u16; D]],
    c: &mut C,
) {
    for node in nodes {
        let p = node.map(usize::from);
        // The corner of the cube that is known: the sum of the neighbours before, less those counted twice.
        let mut guess = 0;
        let mut greatest: Option<(i64, i64)> = None;
        for k in 1..1 << D {
            if (0..D).any(|a| k >> a & 1 == 1 && p[a] == 0) {
                continue;
            }
            let q = std::array::from_fn(|a| p[a] - (k >> a & 1));
            let v = i64::from(means.of[means.at(q)]);
            guess += if (k as u32).count_ones() % 2 == 1 { v } else { -v };
            greatest = Some(greatest.map_or((v, v), |(lo, hi)| (lo.min(v), hi.max(v))));
        }
        let (lo, hi) = greatest.unwrap_or((0, 0));
        let guess = guess.clamp(lo, hi);
        let at = means.at(p);
        let value = i64::from(source.mean(0, at)) - guess;
        let activity = length(hi - lo).min(LENGTHS - 1);
        let value = models.means.code(c, [activity, 0, 0], value as i32);
        // What is no longer certain is what is around.
        let value = if c.ended() { 0 } else { i64::from(value) };
        means.of[at] = (guess + value).clamp(-i64::from(MEAN_MAX), i64::from(MEAN_MAX)) as i32;
    }
}

/// Each cell's value for the cells that it is made of.
fn finer<const D: usize>(coarse: &Cells<D, i32>, size: [usize; D]) -> Cells<D, i32> {
    let of = points(size).map(|p| coarse.of[coarse.at(p.map(|v| v / 2))]).collect();
    Cells { size, of }
}

/// The ranges that a range is split into.
fn family<const D: usize>(parent: &[u16; D]) -> impl Iterator<Item = [u16; D]> {
    (0..1_u16 << D).map(|k| std::array::from_fn(|a| 2 * parent[a] + (k >> a & 1)))
}

/// The means of the children of each range that is split.
fn children<C: Coder, S: Source<D>, const D: usize>(
    source: &S,
    models: &mut Models,
    level: usize,
    coarse: &Cells<D, i32>,
    means: &mut Cells<D, i32>,
    parents: &[[u16; D]],
    c: &mut C,
) {
    let count = 1 << D;
    let mut before = 0;
    for node in parents {
        let parent = node.map(usize::from);
        let own = i64::from(coarse.of[coarse.at(parent)]);
        let lie = Lie::of(coarse, parent);
        let (mut sum, mut wrong) = (0, 0);
        for (k, node) in family(node).enumerate() {
            let at = means.at(node.map(usize::from));
            let told = i64::from(source.mean(level, at));
            let value = if k + 1 < count {
                let slope: i64 =
                    (0..D).map(|a| if k >> a & 1 == 1 { lie.slope[a] } else { -lie.slope[a] }).sum();
                let guess = (8 * own + slope + 4) >> 3;
                let contexts = [
                    level.min(LEVELS - 1) * LENGTHS + lie.activity,
                    length(wrong).min(LENGTHS - 1) * 8 + k,
                    length(before).min(LENGTHS - 1) * 4 + k.min(3),
                ];
                let rest = models.means.code(c, contexts, (told - guess) as i32);
                wrong += i64::from(rest.unsigned_abs());
                guess + i64::from(rest)
            } else {
                let least = count as i64 * own - count as i64 / 2 - sum;
                let context = length(wrong).min(LENGTHS - 1) * 2 + usize::from(lie.activity > 4);
                least + i64::from(models.last[context].code(c, (told - least).max(0) as u32))
            };
            if c.ended() {
                return;
            }
            let value = value.clamp(-i64::from(MEAN_MAX), i64::from(MEAN_MAX));
            sum += value;
            means.of[at] = value as i32;
        }
        before = wrong;
    }
}

/// What each range of a level is. Returns those that are split.
fn kinds<C: Coder, S: Source<D>, const D: usize>(
    source: &S,
    models: &mut Models,
    level: usize,
    means: &Cells<D, i32>,
    nodes: &[[u16; D]],
    out: &mut Ifs<D>,
    c: &mut C,
) -> Vec<[u16; D]> {
    let shape = &out.shape;
    let domains = shape.domains(level);
    let mut seen = Cells { size: means.size, of: vec![UNSEEN; means.of.len()] };
    out.leaves.reserve_exact(nodes.len());
    let mut siblings = 0;
    let context_level = level.min(LEVELS - 1);
    for (number, node) in nodes.iter().enumerate() {
        let p = node.map(usize::from);
        let at = means.at(p);
        let mut leaf = Leaf {
            mean: means.of[at],
            cell: *node,
            domain: [0; D],
            level: level as u8,
            isometry: 0,
            scale: 0,
        };
        if c.ended() {
            out.leaves.push(leaf);
            continue;
        }
        let told = source.node(level, at);
        let lie = Lie::of(means, p);
        if number % (1 << D) == 0 {
            siblings = 0;
        }
        let around = (0..D).map(|a| seen.sides(p, a)[0]).fold(0, |k, s| k << 2 | usize::from(s)) & 63;
        let steep = length(lie.slope.iter().map(|s| s.abs()).sum()).min(LENGTHS - 1);
        let contexts = [lie.activity, around, steep * 4 + siblings.min(3)];
        let leafs_only = level + 1 == shape.levels();
        let split = !leafs_only && models.kind(c, context_level, 0, contexts, told == Node::Split);
        if split {
            if c.ended() {
                out.leaves.push(leaf);
                continue;
            }
            seen.of[at] = SPLIT;
            siblings += 1;
            continue;
        }
        let mapped = !domains.is_empty()
            && models.kind(c, context_level, 1, contexts, matches!(told, Node::Map { .. }));
        seen.of[at] = if mapped { MAPPED } else { FLAT };
        if mapped {
            let (scale, isometry, domain) = match told {
                Node::Map { scale, isometry, domain } => (scale, isometry, domain.map(usize::from)),
                _ => (1, 0, [0; D]),
            };
            let (first, count) = domains.near(p.map(|v| v * shape.side(level)), shape.near);
            let close = (0..D).all(|a| (first[a]..first[a] + count[a]).contains(&domain[a]));
            let near = shape.near > 0 && models.kind(c, context_level, 2, contexts, close);
            let row = context_level * 2 + usize::from(near);
            let negative = models.signs[row].code(c, scale < 0);
            let greatest = shape.scales().max();
            let told = u32::from(scale.unsigned_abs().wrapping_sub(1)).min(greatest as u32 - 1);
            let size = models.scales[row].code(c, told).min(greatest as u32 - 1) as i8 + 1;
            let isometry = uniform(c, shape.isometries, usize::from(isometry));
            let domain: [usize; D] = std::array::from_fn(|a| {
                if near {
                    first[a] + uniform(c, count[a], domain[a].wrapping_sub(first[a]))
                } else {
                    uniform(c, domains.count[a], domain[a])
                }
            });
            if !c.ended() {
                leaf.scale = if negative { -size } else { size };
                leaf.isometry = isometry as u8;
                leaf.domain = domain.map(|v| v as u16);
            }
        }
        out.leaves.push(leaf);
    }
    out.leaves.shrink_to_fit();
    let split = |node: &&[u16; D]| seen.of[seen.at(node.map(usize::from))] == SPLIT;
    let mut parents = Vec::with_capacity(nodes.iter().filter(split).count());
    parents.extend(nodes.iter().copied().filter(|n| split(&n)));
    if c.ended() && level + 1 < shape.levels() && shape.side(level + 1) > 1 {
        // Ranges that were split show what is known of them.
        out.leaves.reserve_exact(parents.len() << D);
        for parent in std::mem::take(&mut parents) {
            let mean = means.of[means.at(parent.map(usize::from))];
            out.leaves.extend(family(&parent).map(|cell| Leaf {
                mean,
                cell,
                domain: [0; D],
                level: level as u8 + 1,
                isometry: 0,
                scale: 0,
            }));
        }
    }
    parents
}
