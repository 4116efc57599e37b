//! Pages of the patch table (a function of one survey) and of the top table (a function of the set).
//!
//! A page holds the 16 x 16 places of one level whose indices share their upper bits. Bytes: `docs/format.md`.

use super::segment::PageRef;
use crate::base::Result;
use crate::base::bytes::{Put, Reader};
use crate::height::cells::{Block, Fill};
use crate::height::lod::{Fact, PatchId, Place, Standing};

/// Places across a page.
pub const PAGE_SIDE: i32 = 16;
/// Sample blocks across a page: 16 kernels of 28 cells are 4 blocks of 112 vertices.
pub const PAGE_BLOCKS: i32 = 4;
const SLOTS: usize = (PAGE_SIDE * PAGE_SIDE) as usize;
const BLOCKS: usize = (PAGE_BLOCKS * PAGE_BLOCKS) as usize;

/// Address of a page in a survey's tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PageAddress {
    pub level: u8,
    pub i: i32,
    pub j: i32,
}

impl PageAddress {
    pub fn of_place(p: Place) -> PageAddress {
        PageAddress { level: p.level, i: p.i.div_euclid(PAGE_SIDE), j: p.j.div_euclid(PAGE_SIDE) }
    }
    pub fn of_block(level: u8, bi: i64, bj: i64) -> PageAddress {
        let side = i64::from(PAGE_BLOCKS);
        PageAddress { level, i: bi.div_euclid(side) as i32, j: bj.div_euclid(side) as i32 }
    }
    /// The place in a slot.
    pub fn place(&self, slot: usize) -> Place {
        let (a, b) = ((slot as i32) % PAGE_SIDE, (slot as i32) / PAGE_SIDE);
        Place { level: self.level, i: self.i * PAGE_SIDE + a, j: self.j * PAGE_SIDE + b }
    }
}

/// The slot of a place in its page.
pub fn slot(p: Place) -> usize {
    (p.j.rem_euclid(PAGE_SIDE) * PAGE_SIDE + p.i.rem_euclid(PAGE_SIDE)) as usize
}

/// The slot of a sample block in its page.
pub fn block_slot(bi: i64, bj: i64) -> usize {
    let side = i64::from(PAGE_BLOCKS);
    (bj.rem_euclid(side) * side + bi.rem_euclid(side)) as usize
}

/// One patch: its fact and how much of its rectangle is in core(G).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchEntry {
    pub fact: Fact,
    pub core: Fill,
}

/// A page of the patch table.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchPage {
    pub patches: Vec<Option<PatchEntry>>,
    /// Cells of core(G) of the level-0 places whose fill is mixed, in slot order.
    pub cells: Vec<(u8, Block)>,
    /// Sample blocks of this level (levels above 0; level 0 lives in the tiles).
    pub blocks: Vec<Option<PageRef>>,
}

impl Default for PatchPage {
    fn default() -> Self {
        PatchPage { patches: vec![None; SLOTS], cells: Vec::new(), blocks: vec![None; BLOCKS] }
    }
}

impl PatchPage {
    pub fn is_empty(&self) -> bool {
        self.patches.iter().all(Option::is_none) && self.blocks.iter().all(Option::is_none)
    }

    pub fn block(&self, slot: usize) -> Block {
        cells_of(&self.cells, slot, self.patches[slot].map_or(Fill::Empty, |p| p.core))
    }

    pub fn set_block(&mut self, slot: usize, block: Option<Block>) {
        set_cells(&mut self.cells, slot, block);
    }

    pub fn encode(&self, at: PageAddress) -> Vec<u8> {
        let mut out = Vec::new();
        put_address(&mut out, PATCH_PAGE, at);
        for (slot, p) in self.patches.iter().enumerate() {
            if let Some(p) = p {
                out.put_u8(slot as u8);
                out.put_u8(p.core as u8);
                out.put(&p.fact.id.0);
                out.put_f32(p.fact.bot);
            }
        }
        let n = self.patches.iter().flatten().count() as u16;
        out[10..12].copy_from_slice(&n.to_le_bytes());
        put_cells(&mut out, &self.cells);
        let present = self.blocks.iter().enumerate().fold(0u16, |m, (k, b)| m | u16::from(b.is_some()) << k);
        out.put_u16(present);
        for b in self.blocks.iter().flatten() {
            b.put(&mut out);
        }
        out
    }

    pub fn decode(bytes: &[u8], at: PageAddress, file: &str) -> Result<PatchPage> {
        let mut r = Reader::new(bytes, file, "patch page");
        let n = read_address(&mut r, PATCH_PAGE, at)?;
        let mut page = PatchPage::default();
        for _ in 0..n {
            let slot = r.u8()? as usize;
            let code = r.u8()?;
            let core = Fill::from_code(code).ok_or_else(|| r.bad(format!("fill {code}")))?;
            let id = PatchId(r.take(16)?.try_into().expect("16 bytes were taken"));
            let bot = r.f32()?;
            page.patches[slot] = Some(PatchEntry { fact: Fact { id, bot }, core });
        }
        page.cells = read_cells(&mut r)?;
        let present = r.u16()?;
        for k in 0..BLOCKS {
            if present >> k & 1 == 1 {
                page.blocks[k] = Some(PageRef::read(&mut r)?);
            }
        }
        r.end()?;
        Ok(page)
    }
}

/// What the set makes of one patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TopEntry {
    pub standing: Standing,
    /// How much of the rectangle is in core'.
    pub kernel: Fill,
}

/// A page of the top table; it has the same places as the patch page of its address.
#[derive(Clone, Debug, PartialEq)]
pub struct TopPage {
    pub tops: Vec<Option<TopEntry>>,
    /// Cells of core' of the level-0 places whose kernel is mixed, in slot order.
    pub cells: Vec<(u8, Block)>,
}

impl Default for TopPage {
    fn default() -> Self {
        TopPage { tops: vec![None; SLOTS], cells: Vec::new() }
    }
}

impl TopPage {
    pub fn is_empty(&self) -> bool {
        self.tops.iter().all(Option::is_none)
    }

    pub fn block(&self, slot: usize) -> Block {
        cells_of(&self.cells, slot, self.tops[slot].map_or(Fill::Empty, |p| p.kernel))
    }

    pub fn set_block(&mut self, slot: usize, block: Option<Block>) {
        set_cells(&mut self.cells, slot, block);
    }

    pub fn encode(&self, at: PageAddress) -> Vec<u8> {
        let mut out = Vec::new();
        put_address(&mut out, TOP_PAGE, at);
        for (slot, t) in self.tops.iter().enumerate() {
            if let Some(t) = t {
                out.put_u8(slot as u8);
                out.put_u8(t.kernel as u8 | u8::from(t.standing.floor) << 4);
                out.put_f32(t.standing.top);
            }
        }
        let n = self.tops.iter().flatten().count() as u16;
        out[10..12].copy_from_slice(&n.to_le_bytes());
        put_cells(&mut out, &self.cells);
        out
    }

    pub fn decode(bytes: &[u8], at: PageAddress, file: &str) -> Result<TopPage> {
        let mut r = Reader::new(bytes, file, "top page");
        let n = read_address(&mut r, TOP_PAGE, at)?;
        let mut page = TopPage::default();
        for _ in 0..n {
            let slot = r.u8()? as usize;
            let code = r.u8()?;
            let kernel = Fill::from_code(code & 15).ok_or_else(|| r.bad(format!("fill {code}")))?;
            let top = r.f32()?;
            page.tops[slot] =
                Some(TopEntry { standing: Standing { top, floor: code >> 4 & 1 == 1 }, kernel });
        }
        page.cells = read_cells(&mut r)?;
        r.end()?;
        Ok(page)
    }
}

const PATCH_PAGE: u8 = b'P';
const TOP_PAGE: u8 = b'T';

/// Kind, level, indices, and room for the number of entries: 12 bytes.
fn put_address(out: &mut Vec<u8>, kind: u8, at: PageAddress) {
    out.put_u8(kind);
    out.put_u8(at.level);
    out.put_i32(at.i);
    out.put_i32(at.j);
    out.put_u16(0);
}

fn read_address(r: &mut Reader, kind: u8, at: PageAddress) -> Result<usize> {
    let found = r.u8()?;
    let here = PageAddress { level: r.u8()?, i: r.i32()?, j: r.i32()? };
    if found != kind || here != at {
        return Err(
            r.bad(format!("holds page '{}' {here:?}, '{}' {at:?} was wanted", found as char, kind as char))
        );
    }
    let n = r.u16()? as usize;
    if n > SLOTS {
        return Err(r.bad(format!("{n} entries, at most {SLOTS}")));
    }
    Ok(n)
}

fn put_cells(out: &mut Vec<u8>, cells: &[(u8, Block)]) {
    out.put_u16(cells.len() as u16);
    for (slot, b) in cells {
        out.put_u8(*slot);
        for row in b.0 {
            out.put_u32(row);
        }
    }
}

fn read_cells(r: &mut Reader) -> Result<Vec<(u8, Block)>> {
    let n = r.u16()? as usize;
    if n > SLOTS {
        return Err(r.bad(format!("{n} cell blocks, at most {SLOTS}")));
    }
    let mut cells: Vec<(u8, Block)> = Vec::with_capacity(n);
    for _ in 0..n {
        let slot = r.u8()?;
        let mut b = Block::EMPTY;
        for row in b.0.iter_mut() {
            *row = r.u32()? & Block::FULL.0[0];
        }
        if cells.last().is_some_and(|(s, _)| *s >= slot) {
            return Err(r.bad("cell blocks out of order"));
        }
        cells.push((slot, b));
    }
    Ok(cells)
}

fn cells_of(cells: &[(u8, Block)], slot: usize, fill: Fill) -> Block {
    match fill {
        Fill::Empty => Block::EMPTY,
        Fill::Full => Block::FULL,
        Fill::Mixed => {
            cells.binary_search_by_key(&(slot as u8), |c| c.0).map_or(Block::EMPTY, |k| cells[k].1)
        }
    }
}

fn set_cells(cells: &mut Vec<(u8, Block)>, slot: usize, block: Option<Block>) {
    let found = cells.binary_search_by_key(&(slot as u8), |c| c.0);
    match (found, block.filter(|b| b.fill() == Fill::Mixed)) {
        (Ok(k), Some(b)) => cells[k].1 = b,
        (Ok(k), None) => {
            cells.remove(k);
        }
        (Err(k), Some(b)) => cells.insert(k, (slot as u8, b)),
        (Err(_), None) => {}
    }
}

/// Page addresses of a survey and where each page is, ascending.
pub type PageList = Vec<(PageAddress, PageRef)>;

pub fn put_list(out: &mut Vec<u8>, list: &PageList) {
    out.put_u32(list.len() as u32);
    for (a, r) in list {
        out.put_u8(a.level);
        out.put_i32(a.i);
        out.put_i32(a.j);
        r.put(out);
    }
}

pub fn read_list(r: &mut Reader) -> Result<PageList> {
    let n = r.u32()? as usize;
    const ENTRY: usize = 9 + PageRef::BYTES;
    if n > r.remaining() / ENTRY {
        return Err(r.bad(format!("{n} pages in {} bytes", r.remaining())));
    }
    let mut list = Vec::with_capacity(n);
    for _ in 0..n {
        let a = PageAddress { level: r.u8()?, i: r.i32()?, j: r.i32()? };
        const FAR: u32 = 1 << 26;
        if a.level > crate::height::lod::LEVEL_MAX || a.i.unsigned_abs() > FAR || a.j.unsigned_abs() > FAR {
            return Err(r.bad(format!("page address {a:?} is out of range")));
        }
        list.push((a, PageRef::read(r)?));
    }
    if !list.is_sorted_by(|a, b| a.0 < b.0) {
        return Err(r.bad("page list out of order"));
    }
    Ok(list)
}

pub fn find(list: &PageList, at: PageAddress) -> Option<PageRef> {
    list.binary_search_by_key(&at, |e| e.0).ok().map(|k| list[k].1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_come_back_and_damage_is_an_error() {
        let at = PageAddress { level: 0, i: -3, j: 7 };
        let mut page = PatchPage::default();
        let mut tops = TopPage::default();
        for slot in [0usize, 17, 255] {
            let core = if slot == 17 { Fill::Mixed } else { Fill::Full };
            page.patches[slot] =
                Some(PatchEntry { fact: Fact { id: PatchId([slot as u8; 16]), bot: 1.5 }, core });
            let standing = Standing { top: f32::INFINITY, floor: slot == 0 };
            tops.tops[slot] = Some(TopEntry { standing, kernel: core });
        }
        let mut b = Block::FULL;
        b.clear(3, 3);
        page.set_block(17, Some(b));
        tops.set_block(17, Some(b));
        page.blocks[5] = Some(PageRef { file: 1, len: 2, offset: 3, crc: 4 });
        let bytes = page.encode(at);
        assert_eq!(PatchPage::decode(&bytes, at, "t").unwrap(), page);
        let top_bytes = tops.encode(at);
        assert_eq!(TopPage::decode(&top_bytes, at, "t").unwrap(), tops);
        for cut in 0..bytes.len() {
            assert!(PatchPage::decode(&bytes[..cut], at, "t").is_err());
        }
        for bit in 0..bytes.len() * 8 {
            let mut x = bytes.clone();
            x[bit / 8] ^= 1 << (bit % 8);
            let _ = PatchPage::decode(&x, at, "t");
        }
        for bit in 0..top_bytes.len() * 8 {
            let mut x = top_bytes.clone();
            x[bit / 8] ^= 1 << (bit % 8);
            let _ = TopPage::decode(&x, at, "t");
        }
        assert!(PatchPage::decode(&bytes, PageAddress { level: 0, i: 0, j: 0 }, "t").is_err());
    }
}
