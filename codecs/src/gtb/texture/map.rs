//! Which triangle has which class: the codes `T | R | N` and `STOP | CONTINUE` (specification of GTB, sections 6.4 and 6.5).
//!
//! Classes are numbered as they are met; class 0 is ground without a picture. `N`: as the parent. Else the number of a class;
//! the first number that was not met yet is `T`: the new class is described behind it.

use super::tree::{CLASSES_MAX, Tree, Triangle};
use crate::lattice::{Lattice, Pass, Post};
use crate::range::{Bit, Coder};

/// Deepest triangles that have contexts of their own.
const DEPTHS: usize = 28;

/// How deep triangles are cut where ground with a picture meets ground without.
pub const DEPTH_VOID: u32 = 16;

/// The map while it is coded; the same on both sides.
pub struct Map {
    /// Classes and which triangles are cut, as far as they are coded.
    pub tree: Tree,
    /// Triangles of this depth are not cut.
    depth_max: u32,
    /// Classes that were met, with class 0.
    pub met: usize,
    same: Vec<Bit>,
    class: Vec<Bit>,
    stop: Vec<Bit>,
}

/// What the sender wants of the map.
pub struct Plan {
    tree: Tree,
    /// Number in the stream of each of the sender's classes, once it was met.
    numbers: Vec<Option<usize>>,
    /// The sender's class of each number.
    pub met: Vec<usize>,
}

impl Plan {
    /// The least triangles whose commonest class has `tolerance` of the cells, no deeper than `depth_max`; where the picture ends, no
    /// deeper than [`DEPTH_VOID`]. `labels`: class of each cell, `2^n` a side.
    pub fn new(lattice: Lattice, labels: &[u8], tolerance: f64, depth_max: u32) -> Plan {
        let mut tree = Tree::new(lattice);
        let n = lattice.last();
        let all = (0..n).flat_map(|y| (0..n).map(move |x| [y as u16, x as u16]));
        let mut halves = [Vec::new(), Vec::new()];
        all.for_each(|[y, x]| halves[tree.root_of([y.into(), x.into()])].push([y, x]));
        let mut work: Vec<(Triangle, Vec<[u16; 2]>, usize)> =
            tree.roots().into_iter().zip(halves).map(|(t, cells)| (t, cells, 0)).collect();
        while let Some((t, cells, above)) = work.pop() {
            let mut counts = [0usize; CLASSES_MAX];
            for [y, x] in &cells {
                counts[usize::from(labels[usize::from(*y) * n + usize::from(*x)])] += 1;
            }
            let class = (0..CLASSES_MAX).max_by_key(|k| (counts[*k], CLASSES_MAX - k)).unwrap_or(0);
            // Of no cells: as the triangle above.
            let class = if cells.is_empty() { above } else { class };
            let pure = counts[class] as f64 >= tolerance * cells.len() as f64;
            let deepest = if counts[0] > 0 { depth_max.max(DEPTH_VOID) } else { depth_max };
            let children = tree.children(t).filter(|_| !pure && tree.depth(t) < deepest);
            tree.set(t, class, children.is_some());
            if let Some(children) = children {
                let (first, second): (Vec<_>, Vec<_>) =
                    cells.into_iter().partition(|[y, x]| tree.child_of(t, [(*y).into(), (*x).into()]) == 0);
                work.push((children[0], first, class));
                work.push((children[1], second, class));
            }
        }
        let mut plan = Plan { tree, numbers: Vec::new(), met: Vec::new() };
        plan.begin();
        plan
    }

    /// No class was met but that of cells without a picture.
    pub fn begin(&mut self) {
        self.numbers = vec![None; CLASSES_MAX];
        self.numbers[0] = Some(0);
        self.met = vec![0];
    }

    /// The number of a triangle's class in the stream, whether the triangle is cut, and the sender's class.
    fn of(&mut self, t: Triangle) -> (usize, bool, usize) {
        let (class, open) = self.tree.get(t).unwrap_or((0, false));
        let met = self.met.len();
        let number = *self.numbers[class].get_or_insert(met);
        if number == met {
            self.met.push(class);
        }
        (number, open, class)
    }
}

impl Map {
    /// No triangle yet.
    pub fn new(lattice: Lattice, depth_max: u32) -> Map {
        Map {
            tree: Tree::new(lattice),
            depth_max,
            met: 1,
            same: vec![Bit::new(40_000); DEPTHS * 6],
            class: vec![Bit::default(); CLASSES_MAX * CLASSES_MAX],
            stop: vec![Bit::default(); DEPTHS * 8],
        }
    }

    /// Codes the two halves of the square. `new` is told of each class that is met for the first
    /// time, by the sender's number.
    pub fn roots<C: Coder>(
        &mut self,
        c: &mut C,
        mut plan: Option<&mut Plan>,
        new: &mut dyn FnMut(usize, &mut C),
    ) {
        let mut first = None;
        for t in self.tree.roots() {
            first = self.triangle(c, t, 0, first, plan.as_deref_mut(), new);
        }
    }

    /// Codes the triangles that a post makes.
    pub fn post<C: Coder>(
        &mut self,
        c: &mut C,
        pass: Pass,
        middle: Post,
        mut plan: Option<&mut Plan>,
        new: &mut dyn FnMut(usize, &mut C),
    ) {
        for side in [0, 1] {
            let t = Triangle { middle, side };
            if !self.tree.is_inside(pass, t) {
                continue;
            }
            let Some((class, true)) = self.tree.get(t) else { continue };
            let mut first = None;
            for child in self.tree.children(t).into_iter().flatten() {
                if let Some(known) = self.tree.get(child) {
                    first = Some(known);
                    continue;
                }
                first = self.triangle(c, child, class, first, plan.as_deref_mut(), new);
                if c.ended() {
                    return;
                }
            }
        }
    }

    /// One triangle; `above`: its parent's class, `first`: what its sibling was.
    fn triangle<C: Coder>(
        &mut self,
        c: &mut C,
        t: Triangle,
        above: usize,
        first: Option<(usize, bool)>,
        plan: Option<&mut Plan>,
        new: &mut dyn FnMut(usize, &mut C),
    ) -> Option<(usize, bool)> {
        let depth = self.tree.depth(t) as usize;
        let (number, open, own) = plan.map_or((0, false, 0), |p| p.of(t));
        // The sibling: none yet, as the parent, another class.
        let sibling = first.map_or(0, |(class, _)| 1 + usize::from(class != above));
        let near = self.near(t, above);
        let mut class = above;
        if !c.learn(&mut self.same[(depth.min(DEPTHS - 1) * 3 + sibling) * 2 + near], number == above) {
            class = self.number(c, above, number);
            if class >= self.met {
                class = self.met;
                if class >= CLASSES_MAX || c.ended() {
                    return None;
                }
                self.met += 1;
                new(own, c);
            }
        }
        let cut = first.map_or(0, |(_, open)| 1 + usize::from(open));
        let can = depth < self.depth_max as usize && self.tree.children(t).is_some();
        let context = depth.min(DEPTHS - 1) * 8 + cut.min(2) * 2 + usize::from(class == above);
        let open = can && !c.learn(&mut self.stop[context], !open);
        if c.ended() {
            return None;
        }
        self.tree.set(t, class, open);
        Some((class, open))
    }

    /// Whether the triangle on the other side of the hypotenuse is known to be of another class than `above`.
    fn near(&self, t: Triangle, above: usize) -> usize {
        let other = Triangle { middle: t.middle, side: 1 - t.side };
        let inside = self.tree.lattice.pass_of(t.middle).is_some_and(|p| self.tree.is_inside(p, other));
        let known = if inside { self.tree.get(other) } else { None };
        usize::from(known.is_some_and(|(class, _)| class != above))
    }

    /// The number of a class, up to the first that was not met yet.
    fn number<C: Coder>(&mut self, c: &mut C, above: usize, number: usize) -> usize {
        let bits = usize::BITS - self.met.leading_zeros();
        let mut node = 1usize;
        for k in (0..bits).rev() {
            let model = &mut self.class[above * CLASSES_MAX + node % CLASSES_MAX];
            node = node << 1 | usize::from(c.learn(model, number >> k & 1 == 1));
        }
        node - (1 << bits)
    }
}
