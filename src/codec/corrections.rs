//! The correction of a survey over a level-0 place (section 15 of the LOD-space specification), drawn in `docs/payload.md`.
//!
//! Nodes are whole numbers of [`STEP_LOG2`] steps, so they come back bit for bit. They are predicted from their neighbours; what is
//! left is written as the vertices of patches are.

use super::bits::{BitReader, BitWriter};
use super::vertices::code::{WHOLE_MAX, around, put_number, take_number, unzigzag, zigzag};
use crate::base::{Error, Result};
use crate::height::surface::seam::{Channel, Field, NODES, STEP_LOG2};

/// Channels of one block, at most.
pub const CHANNELS_MAX: usize = 1024;
/// Spans of one channel, at most: their ends are powers of 2^(1/4).
const SPANS_MAX: usize = 255;
/// More bytes than any block packs to: 1024 channels, 10 bytes a node.
pub const BYTES_MAX: usize = 64 << 20;

const SMOOTH: u8 = 1;

fn bad(place: impl ToString, what: impl ToString) -> Error {
    Error::corrupt("correction", place, what)
}

/// Packs a field.
///
/// # Errors
/// `Limit` if it has more channels than [`CHANNELS_MAX`]: so many spans of tolerance never meet in one place.
pub fn pack(field: &Field) -> Result<Vec<u8>> {
    let channels = field.channels();
    let spans = channels.iter().map(|c| c.spans.len()).max().unwrap_or(0);
    if channels.len() > CHANNELS_MAX || spans > SPANS_MAX {
        let what = "channels and spans of a block of corrections";
        return Err(Error::limit(what, CHANNELS_MAX as u64, channels.len().max(spans) as u64));
    }
    let mut head = vec![u8::from(field.is_smooth()) * SMOOTH];
    head.extend((channels.len() as u16).to_le_bytes());
    for c in channels {
        head.push(c.spans.len() as u8);
        c.spans.iter().flatten().for_each(|v| head.extend(v.to_le_bytes()));
    }
    let side = NODES + 2 * usize::from(field.is_smooth());
    let mut w = BitWriter::after(head);
    for c in channels {
        put_nodes(&mut w, &c.nodes, side);
        put_flags(&mut w, &c.contradicted);
    }
    Ok(w.end())
}

/// A node from its neighbours W, N, NW, and eight times what was left around.
fn expected(q: &[i64], m: &[u64], a: usize, b: usize, side: usize) -> (i64, u64) {
    let Some([w, n, nw, ne, ww, nn]) = around(a, b, side) else { return (0, 0) };
    let p = (q[w] + q[n] - q[nw]).clamp(-WHOLE_MAX, WHOLE_MAX);
    (p, 2 * (m[w] + m[n]) + m[nw] + m[ne] + m[ww] + m[nn])
}

fn put_nodes(out: &mut BitWriter, nodes: &[f32], side: usize) {
    let q: Vec<i64> = nodes.iter().map(|v| (f64::from(*v) * f64::from(STEP_LOG2).exp2()) as i64).collect();
    let mut m = vec![0u64; q.len()];
    for k in 0..q.len() {
        let (p, s) = expected(&q, &m, k % side, k / side, side);
        m[k] = zigzag(q[k] - p);
        put_number(out, m[k], s);
    }
}

fn put_flags(out: &mut BitWriter, flags: &[bool]) {
    let runs = flags.chunk_by(|a, b| a == b);
    out.put(u64::from(flags.first().copied().unwrap_or(false)), 1);
    runs.for_each(|r| out.put_gamma(r.len() as u32));
}

/// Unpacks a field.
///
/// # Errors
/// If the bytes are none that [`pack`] makes.
pub fn unpack(bytes: &[u8]) -> Result<Field> {
    if bytes.len() > BYTES_MAX {
        return Err(bad("its bytes", format!("{}, above {BYTES_MAX}", bytes.len())));
    }
    let mut rest = bytes;
    let mut take = |n: usize| {
        let (head, tail) = rest
            .split_at_checked(n)
            .ok_or_else(|| bad("spans", format!("they end after {} bytes", bytes.len())))?;
        rest = tail;
        Ok::<_, Error>(head)
    };
    let flags = take(1)?[0];
    if flags > SMOOTH {
        return Err(bad("flags", format!("{flags}")));
    }
    let smooth = flags == SMOOTH;
    let count = take(2)?;
    let count = usize::from(u16::from_le_bytes([count[0], count[1]]));
    if count == 0 || count > CHANNELS_MAX {
        return Err(bad("channels", format!("{count}, not 1 to {CHANNELS_MAX}")));
    }
    let mut all = Vec::new();
    for k in 0..count {
        let n = usize::from(take(1)?[0]);
        let ends = take(8 * n)?.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let ends: Vec<f32> = ends.collect();
        if !(ends.iter().all(|v| *v >= 0.0) && ends.is_sorted()) {
            return Err(bad(format!("channel {k}"), format!("spans {ends:?} do not ascend")));
        }
        all.push(ends.chunks_exact(2).map(|s| [s[0], s[1]]).collect());
    }
    let side = NODES + 2 * usize::from(smooth);
    let mut r = BitReader::new(rest);
    let mut channels = Vec::new();
    for spans in all {
        let nodes = take_nodes(&mut r, side)?;
        let contradicted = take_flags(&mut r, side * side)?;
        channels.push(Channel { spans, nodes, contradicted });
    }
    r.end()?;
    Ok(Field::of(channels, smooth))
}

fn take_nodes(r: &mut BitReader, side: usize) -> Result<Vec<f32>> {
    let (mut q, mut m) = (vec![0i64; side * side], vec![0u64; side * side]);
    for k in 0..q.len() {
        let (p, s) = expected(&q, &m, k % side, k / side, side);
        m[k] = take_number(r, s).map_err(|e| bad(format!("node {k}"), e.to_string()))?;
        q[k] = p + unzigzag(m[k]);
        if q[k].abs() > WHOLE_MAX {
            return Err(bad(format!("node {k}"), format!("number {}", q[k])));
        }
    }
    Ok(q.iter().map(|q| (*q as f64 * f64::from(-STEP_LOG2).exp2()) as f32).collect())
}

fn take_flags(r: &mut BitReader, count: usize) -> Result<Vec<bool>> {
    let mut flags = Vec::with_capacity(count);
    let mut now = r.take(1)? == 1;
    while flags.len() < count {
        let run = r.take_gamma()? as usize;
        if run > count - flags.len() {
            return Err(bad(format!("flag {}", flags.len()), format!("a run of {run} of {count}")));
        }
        flags.resize(flags.len() + run, now);
        now = !now;
    }
    Ok(flags)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hill of two channels.
    fn field(smooth: bool) -> Field {
        let side = NODES + 2 * usize::from(smooth);
        let node = |k: usize, tall: f64| {
            let r = ((k % side) as f64 - 20.0).hypot((k / side) as f64 - 31.5) / 24.0;
            let v = tall * (1.0 - r).max(0.0).powi(3);
            ((v * f64::from(STEP_LOG2).exp2()).round() / f64::from(STEP_LOG2).exp2()) as f32
        };
        let channel = |tall: f64, spans: &[[f32; 2]]| Channel {
            spans: spans.into(),
            nodes: (0..side * side).map(|k| node(k, tall)).collect(),
            contradicted: (0..side * side).map(|k| tall < 0.0 && k % side > 12).collect(),
        };
        Field::of(
            vec![channel(7.3, &[[0.0, f32::INFINITY]]), channel(-900.0, &[[0.0, 2.0], [8.0, 16.0]])],
            smooth,
        )
    }

    #[test]
    fn fields_come_back_bit_for_bit() {
        for smooth in [false, true] {
            let f = field(smooth);
            let bytes = pack(&f).unwrap();
            assert_eq!(unpack(&bytes).unwrap(), f);
            assert!(bytes.len() < 10_000, "{} bytes", bytes.len());
        }
    }

    #[test]
    fn the_bytes_are_as_drawn() {
        // All nodes 0 but the last: 1 step; contradicted is the last node alone.
        let mut nodes = vec![0.0; NODES * NODES];
        *nodes.last_mut().unwrap() = f64::from(-STEP_LOG2).exp2() as f32;
        let mut contradicted = vec![false; NODES * NODES];
        *contradicted.last_mut().unwrap() = true;
        let spans = [[0.0, 4.0]].into();
        let bytes = pack(&Field::of(vec![Channel { spans, nodes, contradicted }], false)).unwrap();
        assert_eq!(bytes[..12], [0, 1, 0, 1, 0, 0, 0, 0, 0, 0, 128, 64]);
        // 3248 zeros, then zigzag(1) = 2 as 110; 0; gamma(3248) as 11 zeros and 110010110000; gamma(1) as 1.
        assert!(bytes[12..12 + 406].iter().all(|b| *b == 0));
        assert_eq!(bytes[418..], [0xc0, 0x01, 0x96, 0x10], "{:x?}", &bytes[418..]);
    }

    #[test]
    fn damaged_bytes_are_refused_or_are_another_field() {
        let bytes = pack(&field(true)).unwrap();
        for n in (0..bytes.len()).step_by(61) {
            assert!(unpack(&bytes[..n]).is_err(), "{n} bytes");
        }
        assert!(unpack(&[&bytes[..], &[0]].concat()).is_err());
        let mut refused = 0;
        for k in (0..bytes.len() * 8).step_by(127) {
            let mut b = bytes.clone();
            b[k / 8] ^= 1 << (k % 8);
            match unpack(&b) {
                Err(_) => refused += 1,
                Ok(f) => assert!(f.channels().len() == 2 || f.channels().len() == 1),
            }
        }
        assert!(refused > 0);
        assert!(unpack(&[0, 255, 255]).is_err() && unpack(&[9, 1, 0]).is_err() && unpack(&[]).is_err());
    }
}
