//! One hash of the logical content of a version: live surveys, patches, tops, kernels, tree. Computed from the bytes
//! on disk; independent of order of arrival, of numbers given inside the database and of where pages lie.

use super::database::Snapshot;
use super::view::{Tables, View};
use crate::base::Result;
use crate::base::bytes::Put;
use crate::height::cells::Fill;
use crate::height::lod::{Place, SurveyNumber};
use crate::store::quadtree::Node;
use crate::store::segment::PageRef;
use crate::store::table::{PageAddress, slot};
use std::collections::HashMap;

/// The fingerprint, as 64 hexadecimal digits. Reads every page but the samples, whose ids and keys it takes.
pub fn fingerprint(s: &Snapshot) -> Result<String> {
    let mut h = blake3::Hasher::new();
    h.put(b"terraquilt content 1");
    h.put_u32(super::root::DERIVATION_VERSION);
    h.put_text(&s.crs().code);
    h.put_text(s.policy().name());
    h.put_u8(s.unit().exponent as u8);
    for (name, value) in
        super::database::constants(s.kind()).into_iter().filter(|(n, _)| *n != "format_version")
    {
        h.put_text(name);
        h.put_text(&value);
    }
    let mut entries: Vec<_> = s.entries().cloned().collect();
    entries.sort_by_key(|e| e.id);
    h.put_u64(entries.len() as u64);
    for e in &entries {
        h.put(&e.id);
        h.put_text(&e.date.map_or(String::new(), |d| d.to_string()));
        h.put_text(&e.precedence.map_or(String::new(), |p| p.to_string()));
        h.put_i64(e.geometry.precedence);
        let head = s.view.head(e.number)?;
        h.put_u64(head.tiles.len() as u64);
        for t in &head.tiles {
            h.put(&t.key);
        }
        h.put_u8(head.level_max);
        let mut patches: Vec<(Place, Vec<u8>)> = Vec::new();
        s.view.each_patch(e.number, |place, p, t| {
            let mut line = Vec::new();
            line.put_u8(place.level);
            line.put_i32(place.i);
            line.put_i32(place.j);
            line.put(&p.fact.id.0);
            line.put_f32(p.fact.bot);
            line.put_u8(p.core as u8);
            line.put_f32(t.standing.top);
            line.put_u8(u8::from(t.standing.floor));
            line.put_u8(t.kernel as u8);
            if place.level == 0 && (p.core == Fill::Mixed || t.kernel == Fill::Mixed) {
                for b in cells(&s.view, e.number, place)? {
                    line.put_u32(b);
                }
            }
            patches.push((place, line));
            Ok(())
        })?;
        patches.sort_unstable_by_key(|(p, _)| (p.level, p.j, p.i));
        h.put_u64(patches.len() as u64);
        for (_, line) in &patches {
            h.put(line);
        }
    }
    let ids: HashMap<SurveyNumber, [u8; 16]> = entries.iter().map(|e| (e.number, e.id)).collect();
    if let Some(t) = &s.view.tree {
        node(&s.view, &t.page, &ids, &mut h)?;
    }
    Ok(h.finalize().to_hex().to_string())
}

/// Core and core' of a level-0 place.
fn cells(view: &View, n: SurveyNumber, place: Place) -> Result<Vec<u32>> {
    let at = PageAddress::of_place(place);
    let mut out = Vec::with_capacity(56);
    if let Some(p) = view.patch_page(n, at)? {
        out.extend(p.block(slot(place)).0);
    }
    if let Some(t) = view.top_page(n, at)? {
        out.extend(t.block(slot(place)).0);
    }
    Ok(out)
}

fn node(
    view: &View,
    at: &PageRef,
    ids: &HashMap<SurveyNumber, [u8; 16]>,
    h: &mut blake3::Hasher,
) -> Result<()> {
    let n = Node::read(&view.files, at)?;
    h.put_u32(n.records.len() as u32);
    for r in &n.records {
        h.put(ids.get(&r.survey).unwrap_or(&[0; 16]));
        h.put(&r.id.0);
        h.put_f32(r.top);
        h.put_f32(r.bot);
        h.put_u8(u8::from(r.floor));
        h.put_u8(r.place.level);
        h.put_i32(r.place.i);
        h.put_i32(r.place.j);
    }
    for c in &n.children {
        h.put_u8(u8::from(c.is_some()));
        if let Some(c) = c {
            h.put_f32(c.top_max);
            h.put_f32(c.bot_min);
            h.put_u8(u8::from(c.floor));
            node(view, &c.page, ids, h)?;
        }
    }
    Ok(())
}
