//! The turns that the texture takes between the heights (specification of GTB, sections 6.5 and 6.6).
//!
//! Before the corners: how deep, how much, the two root triangles. After each post the triangles that it makes; after each pass what is left
//! of its triangles, and a share of the bit planes of the patterns that were met and of the plain part. At the end all that is left, and
//! the amplitudes of synthetic details.

use super::labels::{filled, labels};
use super::map::{DEPTH_VOID, Map, Plan};
use super::paint::{self, Amplitudes, Look};
use super::patterns::{PATTERN, Window, cut, means, windows};
use super::planes;
use super::zerotree::{PLANE_MAX, Source, Zerotree};
use super::{Cells, Settings};
use crate::Result;
use crate::gtb::companion::Companion;
use crate::lattice::{Kind, Lattice, Pass, Post};
use crate::range::{Bit, Coder};

/// Levels of wavelets of a pattern, and of the plain part.
const PATTERN_LEVELS: u32 = 4;
const PLAIN_LEVELS: u32 = 6;
/// Bit planes of patterns below this one are not sent: errors of some ten levels of lightness stay. Beside a plain part they lend their
/// details only, and less will do.
const PATTERN_FLOOR: u32 = 8;
const PATTERN_FLOOR_HYBRID: u32 = 10;
/// Beside a plain part triangles are cut no deeper.
const DEPTH_HYBRID: u32 = 9;

/// A class as both sides know it.
struct Class {
    colour: [u8; 3],
    pattern: Option<Zerotree>,
}

/// What both sides hold.
struct State {
    /// n of the cells.
    n: u32,
    map: Option<Map>,
    /// By number, class 0 without a picture.
    classes: Vec<Class>,
    plain: Option<Zerotree>,
    /// Parts of the plain zero-trees that are sent.
    plain_parts: u32,
    /// 2n of the lattice of heights.
    passes: u32,
    amplitudes: Amplitudes,
}

/// What the sender has beside that.
struct Sender {
    plan: Plan,
    plain: Option<Source>,
    plain_parts: u32,
    depth_max: u32,
    /// By the sender's class.
    colours: Vec<[u8; 3]>,
    patterns: Vec<Option<Source>>,
    /// Weighted coefficients of the picture.
    coefficients: [Vec<i32>; 3],
}

/// How large a texture is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Cells of the picture.
    pub cells: usize,
    /// Classes that were sent.
    pub classes: usize,
}

/// The sender's companion.
pub struct Writer {
    state: State,
    sender: Sender,
}

/// The receiver's companion.
pub struct Reader {
    state: State,
}

impl Writer {
    /// Analyses a picture: some hundred operations a cell, and some 60 bytes a cell of memory.
    pub fn new(cells: &Cells, settings: &Settings) -> Result<Writer> {
        cells.check()?;
        let side = 1usize << cells.n;
        let lattice = lattice(cells.n)?;
        let cells = Cells { rgb: filled(cells), ..cells.clone() };
        let mut labels = labels(&cells);
        let windows = windows(&cells, &mut labels);
        let classes = usize::from(labels.iter().copied().max().unwrap_or(0)) + 1;
        let colours = means(&cells, &labels, classes).iter().map(|c| c.map(|v| (v + 0.5) as u8)).collect();
        let pattern = |w: Window| {
            Source::new(planes::forward(&cut(&cells, w), PATTERN, PATTERN_LEVELS), PATTERN, PATTERN_LEVELS)
        };
        let patterns = (0..classes).map(|k| windows.get(k).copied().flatten().map(pattern)).collect();
        let levels = planes::levels(side, PLAIN_LEVELS);
        let coefficients = planes::forward(&cells.rgb, side, levels);
        let budget = (settings.plain * 3.0 * (side * side) as f64) as usize;
        let plain = (budget > 0).then(|| Source::new(coefficients.clone(), side, levels));
        let plain_parts = plain.as_ref().map_or(0, |s| planes::parts_within(s, side, levels, budget));
        let depth_max = settings.depth_max.min(if plain_parts > 0 { DEPTH_HYBRID } else { 31 });
        let plan = Plan::new(lattice, &labels, settings.tolerance, depth_max);
        let depth_max = if labels.contains(&0) { depth_max.max(DEPTH_VOID) } else { depth_max };
        let sender = Sender { plan, plain, plain_parts, depth_max, colours, patterns, coefficients };
        Ok(Writer { state: State::new(cells.n), sender })
    }

    /// What was sent.
    pub fn sizes(&self) -> Sizes {
        Sizes { cells: 1 << (2 * self.state.n), classes: self.state.classes.len() - 1 }
    }

    /// Of each class and band of details that is painted with a seed: its place in words, its energy in the picture, and in what is
    /// painted. After the stream was written.
    pub fn energies(&self, seed: u64) -> Vec<(String, f64, f64)> {
        let (_, painted, labels) = self.state.ingredients(seed);
        let side = 1 << self.state.n;
        let levels = planes::levels(side, PLAIN_LEVELS);
        paint::energies(&self.sender.coefficients, &painted, &labels, side, levels, &self.state.amplitudes)
    }

    /// As [`Reader::sent`].
    pub fn sent(&self) -> Cells {
        self.state.picture(0, false)
    }

    /// The picture that a receiver of all that was sent paints.
    pub fn picture(&self, seed: u64) -> Cells {
        self.state.picture(seed, true)
    }
}

impl Reader {
    /// For a head that says `texture: Some(n)`; there is no head with n beyond [`N_MAX`](crate::lattice::N_MAX), which it is held to.
    /// Reads one stream after the other: each begins anew.
    pub fn new(n: u32) -> Reader {
        Reader { state: State::new(n.min(crate::lattice::N_MAX)) }
    }

    /// The picture as far as it came; the same seed paints the same bytes everywhere.
    pub fn picture(&self, seed: u64) -> Cells {
        self.state.picture(seed, true)
    }

    /// The picture without synthetic details: what was sent plainly. Where that is nothing, the patterns.
    pub fn sent(&self) -> Cells {
        self.state.picture(0, false)
    }
}

/// The corners of the cells.
fn lattice(n: u32) -> Result<Lattice> {
    Lattice::new(n).ok_or(crate::Error::Limit {
        what: "n of the texture",
        limit: u64::from(crate::lattice::N_MAX),
        wanted: u64::from(n),
    })
}

impl<C: Coder> Companion<C> for Writer {
    fn texture(&self) -> Option<u32> {
        Some(self.state.n)
    }
    fn start(&mut self, lattice: Lattice, c: &mut C) {
        self.state.start(lattice, c, Some(&mut self.sender));
    }
    fn after_post(&mut self, pass: Pass, post: Post, c: &mut C) {
        self.state.post(pass, post, c, Some(&mut self.sender));
    }
    fn after_pass(&mut self, pass: Pass, c: &mut C) {
        self.state.pass(pass, c, Some(&mut self.sender));
    }
    fn finish(&mut self, c: &mut C) {
        self.state.finish(c, Some(&mut self.sender));
    }
}

impl<C: Coder> Companion<C> for Reader {
    fn texture(&self) -> Option<u32> {
        Some(self.state.n)
    }
    fn start(&mut self, lattice: Lattice, c: &mut C) {
        self.state.start(lattice, c, None);
    }
    fn after_post(&mut self, pass: Pass, post: Post, c: &mut C) {
        self.state.post(pass, post, c, None);
    }
    fn after_pass(&mut self, pass: Pass, c: &mut C) {
        self.state.pass(pass, c, None);
    }
    fn finish(&mut self, c: &mut C) {
        self.state.finish(c, None);
    }
}

impl State {
    fn new(n: u32) -> State {
        let none = Class { colour: [0; 3], pattern: None };
        State {
            n,
            map: None,
            classes: vec![none],
            plain: None,
            plain_parts: 0,
            passes: 0,
            amplitudes: Amplitudes::default(),
        }
    }

    fn start<C: Coder>(&mut self, heights: Lattice, c: &mut C, mut sender: Option<&mut Sender>) {
        // A stream begins with nothing, also where the companion has gone with another before.
        *self = State::new(self.n);
        if let Some(s) = sender.as_deref_mut() {
            s.plan.begin();
        }
        let Some(lattice) = lattice(self.n).ok().filter(|l| l.n() > 0) else { return };
        self.passes = 2 * heights.n();
        let side = lattice.last();
        let depth_max = c.bits(5, sender.as_ref().map_or(0, |s| s.depth_max));
        self.plain_parts = c.bits(11, sender.as_ref().map_or(0, |s| s.plain_parts));
        let top = sender.as_ref().and_then(|s| s.plain.as_ref()).map_or(0, Source::top);
        let top = if self.plain_parts > 0 { c.bits(5, top) } else { 0 };
        if c.ended() {
            return;
        }
        if self.plain_parts > 0 {
            self.plain = Some(Zerotree::new(side, planes::levels(side, PLAIN_LEVELS), top.min(PLANE_MAX)));
        }
        let mut map = Map::new(lattice, depth_max);
        let (plan, looks) = apart(sender);
        map.roots(c, plan, &mut |own, c| self.classes.extend(Class::new(c, looks.as_ref(), own)));
        self.map = Some(map);
    }

    fn post<C: Coder>(&mut self, pass: Pass, post: Post, c: &mut C, sender: Option<&mut Sender>) {
        let Some(map) = &mut self.map else { return };
        // The same place among the cells: a step of the heights' lattice is a power of two of theirs.
        let number =
            2 * (self.passes / 2 - 1 - pass.step.trailing_zeros()) + u32::from(pass.kind == Kind::Edges);
        if number >= 2 * self.n {
            return;
        }
        let (heights, cells) = (self.passes / 2, self.n);
        let place =
            post.map(|v| if cells >= heights { v << (cells - heights) } else { v >> (heights - cells) });
        let (plan, looks) = apart(sender);
        let classes = &mut self.classes;
        map.post(c, map.tree.lattice.pass(number), place, plan, &mut |own, c| {
            classes.extend(Class::new(c, looks.as_ref(), own));
        });
    }

    fn pass<C: Coder>(&mut self, pass: Pass, c: &mut C, mut sender: Option<&mut Sender>) {
        if self.map.is_none() {
            return;
        }
        let number =
            2 * (self.passes / 2 - 1 - pass.step.trailing_zeros()) + u32::from(pass.kind == Kind::Edges);
        self.rest(number, c, sender.as_deref_mut());
        self.planes(number + 1, self.passes, c, sender.as_deref());
    }

    /// The triangles of a pass of the cells that were not coded yet.
    fn rest<C: Coder>(&mut self, number: u32, c: &mut C, mut sender: Option<&mut Sender>) {
        let Some(map) = &mut self.map else { return };
        if number >= 2 * self.n {
            return;
        }
        let pass = map.tree.lattice.pass(number);
        for place in pass.posts(map.tree.lattice) {
            let (plan, looks) = apart(sender.as_deref_mut());
            let classes = &mut self.classes;
            map.post(c, pass, place, plan, &mut |own, c| classes.extend(Class::new(c, looks.as_ref(), own)));
            if c.ended() {
                return;
            }
        }
    }

    /// Parts of patterns and of the plain part, up to `share` of `whole`.
    fn planes<C: Coder>(&mut self, share: u32, whole: u32, c: &mut C, sender: Option<&Sender>) {
        let due = |parts: u32| parts * share / whole.max(1);
        let hybrid = self.plain_parts > 0;
        for (number, class) in self.classes.iter_mut().enumerate().skip(1) {
            let Some(trees) = &mut class.pattern else { continue };
            let source = sender.and_then(|s| s.patterns[s.plan.met[number]].as_ref());
            while trees.done() < due(pattern_parts(trees, hybrid)) && !c.ended() {
                trees.part(c, source);
            }
        }
        if let Some(trees) = &mut self.plain {
            let source = sender.and_then(|s| s.plain.as_ref());
            while trees.done() < due(self.plain_parts.min(trees.parts())) && !c.ended() {
                trees.part(c, source);
            }
        }
    }

    fn finish<C: Coder>(&mut self, c: &mut C, mut sender: Option<&mut Sender>) {
        for number in 0..2 * self.n {
            self.rest(number, c, sender.as_deref_mut());
            if c.ended() {
                return;
            }
        }
        self.planes(1, 1, c, sender.as_deref());
        if self.plain.is_none() || c.ended() {
            return;
        }
        let amplitudes = sender.map(|s| {
            let (sent, painted, labels) = self.ingredients(0);
            let side = 1 << self.n;
            paint::amplitudes(
                &s.coefficients,
                &sent,
                &painted,
                &labels,
                side,
                planes::levels(side, PLAIN_LEVELS),
            )
        });
        let mut models = vec![Bit::default(); 256 * Amplitudes::OF_CLASS];
        let mut steps = vec![0; Amplitudes::OF_CLASS * self.classes.len()];
        for (k, step) in steps.iter_mut().enumerate().skip(Amplitudes::OF_CLASS) {
            let v = amplitudes.as_ref().map_or(0, |a| a.steps().get(k).copied().unwrap_or(0));
            let mut node = 1usize;
            for b in (0..8).rev() {
                let bit = v >> b & 1 == 1;
                let model = &mut models[k % Amplitudes::OF_CLASS * 256 + node];
                // The three lowest bits are as likely as not.
                let bit = if b < 3 { c.bit(1 << 15, bit) } else { c.learn(model, bit) };
                node = node << 1 | usize::from(bit);
            }
            *step = node as u8;
        }
        if !c.ended() {
            self.amplitudes = Amplitudes::new(steps);
        }
    }

    /// The plain part's coefficients, the painted picture and the labels.
    fn ingredients(&self, seed: u64) -> ([Vec<i32>; 3], Vec<[u8; 3]>, Vec<u8>) {
        let side = 1usize << self.n;
        let labels = self.map.as_ref().map_or_else(|| vec![0; side * side], |m| m.tree.labels());
        let looks: Vec<Look> = self.classes.iter().map(Class::look).collect();
        let painted = paint::fill(&labels, side, &looks, seed);
        let sent = [0, 1, 2].map(|ch| self.plain.as_ref().map_or_else(Vec::new, |t| t.coefficients(ch)));
        (sent, painted, labels)
    }

    fn picture(&self, seed: u64, synthetic: bool) -> Cells {
        let side = 1usize << self.n;
        let (sent, painted, labels) = self.ingredients(seed);
        let levels = planes::levels(side, PLAIN_LEVELS);
        let begun = self.plain.as_ref().is_some_and(|t| t.done() >= t.parts_of_plane());
        let rgb = if begun {
            let none = Amplitudes::default();
            let amplitudes = if synthetic { &self.amplitudes } else { &none };
            paint::complete(sent, &painted, &labels, side, levels, amplitudes)
        } else {
            painted
        };
        let void = if labels.contains(&0) { labels.iter().map(|l| *l == 0).collect() } else { Vec::new() };
        Cells { n: self.n, rgb, void }
    }
}

/// The sender's plan, and what its classes look like.
fn apart(sender: Option<&mut Sender>) -> (Option<&mut Plan>, Option<Looks<'_>>) {
    match sender {
        None => (None, None),
        Some(Sender { plan, colours, patterns, .. }) => (Some(plan), Some(Looks { colours, patterns })),
    }
}

/// What the sender's classes look like.
struct Looks<'a> {
    colours: &'a [[u8; 3]],
    patterns: &'a [Option<Source>],
}

/// Parts of a pattern that are sent: all planes down to a floor.
fn pattern_parts(trees: &Zerotree, hybrid: bool) -> u32 {
    let floor = if hybrid { PATTERN_FLOOR_HYBRID } else { PATTERN_FLOOR };
    trees.parts().saturating_sub(floor * trees.parts_of_plane())
}

impl Class {
    /// A class that is met: its mean colour, whether a pattern follows, and the pattern's highest bit plane. `own`: the sender's class.
    fn new<C: Coder>(c: &mut C, looks: Option<&Looks>, own: usize) -> Option<Class> {
        let colour = looks.map_or([0; 3], |l| l.colours[own]);
        let colour = colour.map(|v| c.bits(8, u32::from(v)) as u8);
        let source = looks.and_then(|l| l.patterns[own].as_ref());
        let has = c.bits(1, u32::from(source.is_some())) == 1;
        let top = if has { c.bits(5, source.map_or(0, Source::top)) } else { 0 };
        let trees = || Zerotree::new(PATTERN, PATTERN_LEVELS, top.min(PLANE_MAX));
        (!c.ended()).then(|| Class { colour, pattern: has.then(trees) })
    }

    /// What it looks like, as far as it is known.
    fn look(&self) -> Look {
        match &self.pattern {
            Some(t) if t.done() >= t.parts_of_plane() => Look::Pattern(planes::inverse(
                [0, 1, 2].map(|ch| t.coefficients(ch)),
                PATTERN,
                PATTERN_LEVELS,
            )),
            _ => Look::Flat(self.colour),
        }
    }
}
