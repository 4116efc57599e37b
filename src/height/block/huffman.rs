//! Bytes in a prefix code of at most 11 bits: four streams side by side, several bytes a look into the table.
//!
//! Small differences have short codes, so that 11 bits hold many of them: the table gives up to six bytes for every
//! 11 bits that can come. Four streams are read in turns, since each waits for its last look. Bytes are drawn in
//! `docs/format.md`.

use crate::base::bytes::Put;
use multiversion::multiversion;

/// Longest code.
pub const BITS: usize = 11;
const STREAMS: usize = 4;
/// Looks into the table for which one load of 64 bits is enough, and the bytes in which they write.
const LOOKS: usize = 5;
const REACH: usize = 40;

// An entry of the table: bits taken (lowest byte), how many bytes come (second), and up to six bytes, the first lowest.
// Added up, entries tell bits and bytes of several looks.
const SYMBOLS: u64 = 6;
fn entry_bits(e: u64) -> usize {
    e as usize & 255
}
fn entry_count(e: u64) -> usize {
    (e >> 8) as usize & 255
}

/// Lengths of the codes of all bytes; 0: the byte does not come.
pub struct Lengths([u8; 256]);

impl Lengths {
    /// Lengths that make bytes with these counts short. At least two bytes come.
    ///
    /// Huffman's, over counts that are raised to a floor until no code is longer than [`BITS`].
    pub fn of(counts: &[u32; 256]) -> Lengths {
        let mut leaves: Vec<(u32, u8)> = (0..=255u8).map(|s| (counts[usize::from(s)], s)).collect();
        leaves.retain(|(count, _)| *count > 0);
        leaves.sort_unstable();
        let total: u32 = counts.iter().sum();
        let mut floor = (total >> BITS).max(1);
        loop {
            let depths = depths(&leaves, floor);
            if depths.iter().all(|d| usize::from(*d) <= BITS) {
                let mut lengths = [0; 256];
                leaves.iter().zip(&depths).for_each(|((_, s), d)| lengths[usize::from(*s)] = *d);
                return Lengths(lengths);
            }
            floor *= 2;
        }
    }

    /// Bytes that [`encode`] writes for bytes with these counts, or a few less.
    pub fn bytes(&self, counts: &[u32; 256]) -> usize {
        let bits: u64 = self.0.iter().zip(counts).map(|(l, c)| u64::from(*l) * u64::from(*c)).sum();
        bits.div_ceil(8) as usize + self.last() / 2 + 2 + 2 * (STREAMS - 1)
    }

    /// The greatest byte that comes.
    fn last(&self) -> usize {
        self.0.iter().rposition(|l| *l > 0).unwrap_or(0)
    }

    /// Bytes that come, in the order of their codes: by length, then by value.
    fn in_order(&self) -> Vec<u8> {
        let mut starts = [0usize; 17];
        self.0.iter().for_each(|l| starts[usize::from(*l) + 1] += 1);
        starts[1] = 0;
        (1..17).for_each(|l| starts[l] += starts[l - 1]);
        let mut order = vec![0; starts[16]];
        for (s, l) in (0..=255u8).zip(&self.0).filter(|(_, l)| **l > 0) {
            order[starts[usize::from(*l)]] = s;
            starts[usize::from(*l)] += 1;
        }
        order
    }
}

/// Depths of the leaves of a Huffman tree over weights `max(count, floor)`; leaves ascend by count.
fn depths(leaves: &[(u32, u8)], floor: u32) -> Vec<u8> {
    let n = leaves.len();
    // Nodes: the leaves, then joins in the order in which they are made, which is ascending, too.
    let mut weights: Vec<u32> = leaves.iter().map(|(count, _)| (*count).max(floor)).collect();
    let mut parents = vec![0usize; 2 * n - 1];
    let (mut leaf, mut join) = (0, n);
    for node in n..2 * n - 1 {
        let mut weight = 0;
        for _ in 0..2 {
            let next = if leaf < n && (join == node || weights[leaf] <= weights[join]) {
                &mut leaf
            } else {
                &mut join
            };
            weight += weights[*next];
            parents[*next] = node;
            *next += 1;
        }
        weights.push(weight);
    }
    let mut depths = vec![0u8; 2 * n - 1];
    for node in (0..2 * n - 2).rev() {
        depths[node] = depths[parents[node]] + 1;
    }
    depths.truncate(n);
    depths
}

/// Ends of the four parts of `n` bytes.
fn ends(n: usize) -> [usize; STREAMS] {
    std::array::from_fn(|k| ((k + 1) * n.div_ceil(STREAMS)).min(n))
}

/// Appends bytes in the codes of `lengths`, which has one for each of them.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
pub fn encode(bytes: &[u8], lengths: &Lengths, out: &mut Vec<u8>) {
    let last = lengths.last();
    out.put_u8(last as u8);
    for pair in lengths.0[..=last].chunks(2) {
        out.put_u8(pair[0] | pair.get(1).unwrap_or(&0) << 4);
    }
    let mut codes = [(0u64, 0u32); 256];
    let mut next = 0u64;
    for s in lengths.in_order() {
        let len = u32::from(lengths.0[usize::from(s)]);
        codes[usize::from(s)] = (next >> (BITS as u32 - len), len);
        next += 1 << (BITS as u32 - len);
    }
    let sizes_at = out.len();
    out.put(&[0; 2 * (STREAMS - 1)]);
    let mut start = 0;
    for (k, end) in ends(bytes.len()).into_iter().enumerate() {
        let from = out.len();
        out.resize(from + (end - start) * BITS / 8 + 16, 0);
        let (mut at, mut held, mut count) = (from, 0u64, 0u32);
        for four in bytes[start..end].chunks(4) {
            for b in four {
                let (code, len) = codes[usize::from(*b)];
                held = held << len | code;
                count += len;
            }
            out[at..at + 8].copy_from_slice(&(held << (64 - count)).to_be_bytes());
            at += count as usize / 8;
            count %= 8;
        }
        out.truncate(at + usize::from(count > 0));
        let size = (out.len() - from) as u16;
        if k < STREAMS - 1 {
            out[sizes_at + 2 * k..][..2].copy_from_slice(&size.to_le_bytes());
        }
        start = end;
    }
}

/// What 11 bits mean, for all that can come.
struct Table {
    /// Entries for `r` bits lie at `2^r + bits`: as many codes as fit into them. Only lengths that are needed are made.
    entries: Box<[u64; 2 << BITS]>,
    lengths: Lengths,
}

impl Table {
    /// # Errors
    /// If the lengths leave bits without a meaning, or give some two.
    #[inline(always)]
    fn new(lengths: Lengths) -> Result<Table, &'static str> {
        let order = lengths.in_order();
        let taken: usize = order.iter().map(|s| 1 << (BITS - usize::from(lengths.0[usize::from(*s)]))).sum();
        if taken != 1 << BITS {
            return Err("lengths of codes that are no prefix code");
        }
        let mut present = [false; BITS + 1];
        order.iter().for_each(|s| present[usize::from(lengths.0[usize::from(*s)])] = true);
        // Bits that can be left after codes.
        let mut needed = [false; BITS + 1];
        needed[BITS] = true;
        for r in (1..=BITS).rev() {
            if needed[r] {
                (1..=r).filter(|len| present[*len]).for_each(|len| needed[r - len] = true);
            }
        }
        let entries = vec![0; 2 << BITS].into_boxed_slice();
        let mut entries: Box<[u64; 2 << BITS]> = entries.try_into().expect("that many were asked for");
        for r in (1..=BITS).filter(|r| needed[*r]) {
            let (shorter, here) = entries.split_at_mut(1 << r);
            let mut at = 0;
            for s in &order {
                let len = usize::from(lengths.0[usize::from(*s)]);
                if len > r {
                    break;
                }
                let size = 1usize << (r - len);
                let one = u64::from(*s) << 16 | 1 << 8 | len as u64;
                for (e, rest) in here[at..at + size].iter_mut().zip(&shorter[size..2 * size]) {
                    // What the rest of the bits mean follows, unless those are six bytes already.
                    let both = one + ((rest >> 16) << 24) + (rest & 0xffff);
                    *e = if rest >> 8 & 255 == SYMBOLS { one } else { both };
                }
                at += size;
            }
        }
        Ok(Table { entries, lengths })
    }

    /// The entry of the highest bits.
    #[inline(always)]
    fn entry(&self, bits: u64) -> u64 {
        self.entries[(1 << BITS) + (bits >> (64 - BITS)) as usize]
    }
}

/// 64 bits from a position on; zeros past the end.
#[inline(always)]
fn load(packed: &[u8], bit: usize) -> u64 {
    let from = packed.get(bit / 8..).unwrap_or(&[]);
    let word = match from.first_chunk::<8>() {
        Some(b) => u64::from_be_bytes(*b),
        None => {
            let mut b = [0; 8];
            b[..from.len()].copy_from_slice(from);
            u64::from_be_bytes(b)
        }
    };
    word << (bit % 8)
}

/// One stream while it is read.
struct Stream<'a> {
    /// Position in the packed bytes.
    bit: usize,
    out: &'a mut [u8],
    /// Bytes read.
    at: usize,
}

impl Stream<'_> {
    /// Whether [`Stream::step`] stays inside.
    #[inline(always)]
    fn may_step(&self, packed: &[u8]) -> bool {
        self.out.len() - self.at >= REACH && packed.len() >= self.bit / 8 + 8
    }

    #[inline(always)]
    fn step(&mut self, packed: &[u8], table: &Table) {
        let mut bits = load(packed, self.bit);
        let Some(out) = self.out[self.at..].first_chunk_mut::<REACH>() else { return };
        let mut sum = 0;
        for _ in 0..LOOKS {
            let e = table.entry(bits);
            let at = entry_count(sum) & 31;
            // Six bytes and two zeros; those past the count are written over by what comes next.
            out[at..at + 8].copy_from_slice(&(e >> 16).to_le_bytes());
            sum = e.wrapping_add(sum);
            bits <<= e & 63;
        }
        self.at += entry_count(sum);
        self.bit += entry_bits(sum);
    }

    #[inline(always)]
    fn finish(&mut self, packed: &[u8], table: &Table) {
        while self.may_step(packed) {
            self.step(packed, table);
        }
        while self.at < self.out.len() {
            let symbol = (table.entry(load(packed, self.bit)) >> 16) as u8;
            self.out[self.at] = symbol;
            self.at += 1;
            self.bit += usize::from(table.lengths.0[usize::from(symbol)]);
        }
    }
}

/// Reads `out.len()` bytes back that [`encode`] wrote. Returns how many bytes of `packed` they took.
///
/// # Errors
/// If the bytes are none that [`encode`] writes.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2"))]
pub fn decode(packed: &[u8], out: &mut [u8]) -> Result<usize, &'static str> {
    let short = "codes reach past the end";
    let (last, rest) = packed.split_first().ok_or(short)?;
    let pairs = usize::from(*last) / 2 + 1;
    let (pairs, rest) = rest.split_at_checked(pairs).ok_or(short)?;
    let mut lengths = [0; 256];
    for (l, pair) in lengths.chunks_exact_mut(2).zip(pairs) {
        (l[0], l[1]) = (pair & 15, pair >> 4);
    }
    if lengths.iter().any(|l| usize::from(*l) > BITS) {
        return Err("codes of more than 11 bits");
    }
    let table = Table::new(Lengths(lengths))?;
    let (sizes, streams) = rest.split_at_checked(2 * (STREAMS - 1)).ok_or(short)?;
    let mut starts = [0; STREAMS];
    for k in 1..STREAMS {
        let size = u16::from_le_bytes([sizes[2 * k - 2], sizes[2 * k - 1]]);
        starts[k] = starts[k - 1] + usize::from(size);
    }
    let ends = ends(out.len());
    let (half, rest) = out.split_at_mut(ends[1]);
    let (a, b) = half.split_at_mut(ends[0]);
    let (c, d) = rest.split_at_mut(ends[2] - ends[1]);
    let mut k = 0;
    let [mut a, mut b, mut c, mut d] = [a, b, c, d].map(|out| {
        k += 1;
        Stream { bit: 8 * starts[k - 1], out, at: 0 }
    });
    while a.may_step(streams) && b.may_step(streams) && c.may_step(streams) && d.may_step(streams) {
        a.step(streams, &table);
        b.step(streams, &table);
        c.step(streams, &table);
        d.step(streams, &table);
    }
    let mut end = 0;
    for (k, s) in [a, b, c, d].iter_mut().enumerate() {
        s.finish(streams, &table);
        end = s.bit.div_ceil(8);
        if starts.get(k + 1).is_some_and(|next| *next != end) {
            return Err("a stream of codes that does not end where it should");
        }
    }
    if end > streams.len() {
        return Err(short);
    }
    Ok(packed.len() - streams.len() + end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(seed: u64) -> impl FnMut() -> u64 {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state
        }
    }

    fn counts(bytes: &[u8]) -> [u32; 256] {
        let mut counts = [0; 256];
        bytes.iter().for_each(|b| counts[usize::from(*b)] += 1);
        counts
    }

    fn packed(bytes: &[u8]) -> Vec<u8> {
        let counts = counts(bytes);
        let lengths = Lengths::of(&counts);
        let mut out = Vec::new();
        encode(bytes, &lengths, &mut out);
        let told = lengths.bytes(&counts);
        assert!((told..told + 4).contains(&out.len()), "{told} told, {} written", out.len());
        out
    }

    /// Bytes of many shapes: from two values to all, from even to very uneven, of any number.
    fn shapes() -> impl Iterator<Item = Vec<u8>> {
        (0..400u64).filter_map(|seed| {
            let mut next = random(seed + 1);
            let n = [2, 3, 5, 39, 40, 41, 160, 163, 1000, 12544, 50176][seed as usize % 11];
            let bits = 1 + seed % 8;
            // The `and` of several random numbers has few ones: small numbers are likely.
            let rare = seed / 11 % 4;
            let bytes: Vec<u8> = (0..n)
                .map(|_| ((0..rare).fold(next(), |v, _| v & next()) & ((1 << bits) - 1)) as u8)
                .collect();
            bytes.iter().any(|b| *b != bytes[0]).then_some(bytes)
        })
    }

    #[test]
    fn bytes_come_back_whatever_follows() {
        for bytes in shapes() {
            let mut p = packed(&bytes);
            let size = p.len();
            for more in [0, 1, 100] {
                p.resize(size + more, 0xa5);
                let mut out = vec![7; bytes.len()];
                assert_eq!(decode(&p, &mut out), Ok(size));
                assert!(out == bytes, "{} bytes", bytes.len());
            }
        }
    }

    #[test]
    fn very_uneven_counts_have_codes_that_are_short_enough() {
        let (mut counts, mut a, mut b) = ([0u32; 256], 1, 1);
        for count in counts.iter_mut().take(30) {
            *count = a;
            (a, b) = (b, a + b);
        }
        let lengths = Lengths::of(&counts);
        assert!((0..30).all(|k| (1..=BITS as u8).contains(&lengths.0[k])));
        assert!(Table::new(lengths).is_ok());
    }

    #[test]
    fn damaged_codes_are_errors_or_other_bytes_and_never_panics() {
        for bytes in shapes().filter(|b| b.len() < 2000).step_by(7) {
            let p = packed(&bytes);
            let mut out = vec![0; bytes.len()];
            for cut in 0..p.len() {
                assert!(decode(&p[..cut], &mut out).is_err(), "cut at {cut} of {}", p.len());
            }
            for bit in 0..p.len() * 8 {
                let mut q = p.clone();
                q[bit / 8] ^= 1 << (bit % 8);
                if let Ok(took) = decode(&q, &mut out) {
                    assert!(took <= q.len());
                }
            }
        }
        let mut next = random(99);
        for _ in 0..20_000 {
            let p: Vec<u8> = (0..next() % 60).map(|_| next() as u8).collect();
            let _ = decode(&p, &mut [0; 50]);
        }
    }
}
