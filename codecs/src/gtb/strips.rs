//! Triangles as one strip: a greedy walk from neighbour to neighbour.
//!
//! The curve of Sierpinski, which a walk of the tree follows, turns the same way twice at two of three triangles of even ground, and
//! each such turn costs a post: 1.6 posts a triangle. The walk here goes to the neighbour that would be left with the fewest
//! ways out, which costs about 1.43 on selections of terrain; where it ends, the strip jumps, for four posts.

/// Triangles, and which of them each post is in: eight at most.
struct Mesh<'a> {
    triangles: &'a [[u32; 3]],
    /// Where the triangles of a post begin in `around`.
    begin: Vec<u32>,
    around: Vec<u32>,
    drawn: Vec<bool>,
}

/// How far along the triangles a jump looks for one that few others can lead to.
const LOOK: usize = 64;

/// Draws all `triangles`, counter-clockwise ones over posts `0..posts`, neighbours near each other in the list, as one strip with
/// their orientation. Linear; 12 bytes a triangle and 4 a post beside the strip.
pub(super) fn strip(posts: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut mesh = Mesh::new(posts, triangles);
    let mut out: Vec<u32> = Vec::with_capacity(triangles.len() + triangles.len() / 2);
    let mut first = 0;
    while let Some(free) = (first..triangles.len()).find(|t| !mesh.drawn[*t]) {
        first = free;
        mesh.jump(first, &mut out);
        while mesh.step(&mut out) {}
    }
    out
}

impl<'a> Mesh<'a> {
    fn new(posts: usize, triangles: &'a [[u32; 3]]) -> Mesh<'a> {
        let mut begin = vec![0u32; posts + 1];
        triangles.iter().flatten().for_each(|p| begin[*p as usize + 1] += 1);
        for k in 0..posts {
            begin[k + 1] += begin[k];
        }
        let mut next = begin.clone();
        let mut around = vec![0; 3 * triangles.len()];
        for (k, t) in triangles.iter().enumerate() {
            for p in t {
                around[next[*p as usize] as usize] = k as u32;
                next[*p as usize] += 1;
            }
        }
        Mesh { triangles, begin, around, drawn: vec![false; triangles.len()] }
    }

    /// The triangles of a post that are not drawn yet.
    fn of(&self, post: u32) -> impl Iterator<Item = usize> {
        let [from, to] = [0, 1].map(|k| self.begin[post as usize + k] as usize);
        self.around[from..to].iter().map(|t| *t as usize).filter(|t| !self.drawn[*t])
    }

    /// The triangle beyond the edge that another runs along from p to q, if it is not drawn yet.
    fn beyond(&self, p: u32, q: u32) -> Option<usize> {
        self.of(p).find(|t| edges(self.triangles[*t]).contains(&[q, p]))
    }

    /// How many neighbours of a triangle are not drawn yet.
    fn ways(&self, t: usize) -> usize {
        edges(self.triangles[t]).into_iter().filter(|[p, q]| self.beyond(*p, *q).is_some()).count()
    }

    /// Goes on to a neighbour of the last triangle: beyond the last edge, or with a turn, which costs a post, beyond the one
    /// before. `false` where there is none.
    fn step(&mut self, out: &mut Vec<u32>) -> bool {
        let n = out.len();
        let [u, v, w] = [out[n - 3], out[n - 2], out[n - 1]];
        let (straight, turned) = match n % 2 {
            1 => (self.beyond(v, w), self.beyond(w, u)),
            _ => (self.beyond(w, v), self.beyond(u, w)),
        };
        let (next, turn) = match (straight, turned) {
            (None, None) => return false,
            (Some(s), None) => (s, false),
            (None, Some(t)) => (t, true),
            (Some(s), Some(t)) => {
                // Before it is cut off; one that is cut off already can wait.
                let turn = (1..self.ways(s)).contains(&self.ways(t));
                (if turn { t } else { s }, turn)
            }
        };
        if turn {
            out.insert(n - 1, u);
        }
        let kept = if turn { u } else { v };
        out.extend(self.triangles[next].into_iter().find(|p| *p != kept && *p != w));
        self.drawn[next] = true;
        true
    }

    /// Begins anew: with a triangle of the last post, for two posts, or elsewhere, for four. `first`: the first that is not drawn.
    fn jump(&mut self, first: usize, out: &mut Vec<u32>) {
        let last = out.last().copied();
        let here = last.and_then(|w| self.of(w).min_by_key(|t| self.ways(*t)));
        let start = here.unwrap_or_else(|| {
            let mut near = first..self.triangles.len().min(first + LOOK);
            near.find(|t| !self.drawn[*t] && self.ways(*t) <= 1).unwrap_or(first)
        });
        let mut t = self.triangles[start];
        let head = match here {
            Some(_) => t.iter().position(|p| Some(*p) == last),
            // The last edge leads to the neighbour with the fewest ways out.
            None => {
                (0..3).min_by_key(|k| self.beyond(t[(k + 1) % 3], t[(k + 2) % 3]).map_or(3, |n| self.ways(n)))
            }
        };
        t.rotate_left(head.unwrap_or(0));
        self.drawn[start] = true;
        match last {
            Some(w) if here.is_some() => out.push(w),
            Some(w) => out.extend([w, t[0], t[0]]),
            None => out.push(t[0]),
        }
        // In odd places triangles run the other way.
        out.extend(if out.len() % 2 == 1 { [t[1], t[2]] } else { [t[2], t[1]] });
    }
}

fn edges([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}
