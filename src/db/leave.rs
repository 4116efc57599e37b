//! What leaves, and what is said otherwise of a survey: remove, set.

use super::change::{Call, Outcome};
use super::commit::{Plan, Retiled};
use super::head::Tile;
use super::root::SurveyEntry;
use super::writing::Writing;
use crate::base::date::Date;
use crate::base::{Error, Result};
use crate::store::segment::{PageRef, SegmentKind, SegmentWriter};

impl Writing {
    /// Takes surveys out, or one tile of one.
    pub fn remove(&mut self, call: &Call, names: &[String], tile: Option<String>) -> Result<Outcome> {
        if let Some(tile) = tile {
            let [name] = names else {
                return Err(Error::invalid("--tile", "names a tile of one survey; give exactly one survey"));
            };
            let e = self.find(name)?.clone();
            let head = self.view.head(e.number)?.clone();
            let found: Vec<&Tile> =
                head.tiles.iter().filter(|t| t.id().starts_with(&tile) || t.file == tile).collect();
            let t = match found.as_slice() {
                [t] => (*t).clone(),
                [] => {
                    return Err(Error::missing(
                        format!("tile '{tile}' of survey '{}'", e.name),
                        "see `terraquilt tiles`",
                    ));
                }
                many => {
                    return Err(Error::invalid(
                        "--tile",
                        format!(
                            "'{tile}' fits {} tiles of '{}'; name one by its key (see `terraquilt tiles`)",
                            many.len(),
                            e.name
                        ),
                    ));
                }
            };
            if head.tiles.len() > 1 {
                let number = self.next_file();
                let segment = SegmentWriter::create(call.db.disk(), number, SegmentKind::Survey)?;
                let retiled = Retiled {
                    survey: e.number,
                    before: Some(head.clone()),
                    declaration: head.declaration.clone(),
                    tiles: head.tiles.iter().filter(|k| k.key != t.key).cloned().collect(),
                    dirty: vec![t.posts],
                    compare: false,
                    dead: self.tile_pages(&t)?,
                    segment,
                    date: e.date,
                    precedence: e.precedence,
                    since: e.since,
                };
                let action = format!("remove tile '{}' of '{}'", t.file, e.name);
                return self.commit(call, Plan { retiled: Some(retiled), action, ..Plan::default() });
            }
        }
        let mut gone = Vec::new();
        for n in names {
            let e = self.find(n)?.clone();
            if !gone.iter().any(|g: &SurveyEntry| g.number == e.number) {
                gone.push(e);
            }
        }
        let list: Vec<&str> = gone.iter().map(|e| e.name.as_str()).collect();
        let action = format!("remove '{}'", list.join("', '"));
        self.commit(call, Plan { gone, action, ..Plan::default() })
    }

    /// Changes a survey's date or precedence.
    pub fn set(
        &mut self,
        call: &Call,
        name: &str,
        date: Option<Date>,
        precedence: Option<i64>,
    ) -> Result<Outcome> {
        let e = self.find(name)?.clone();
        let mut new = e.clone();
        new.date = date.or(e.date);
        new.precedence = precedence.or(e.precedence);
        if new == e {
            return Ok(Outcome {
                survey: e.name.clone(),
                version: self.counters.version,
                live: e.live,
                dormant: e.dormant,
                patches: e.live + e.dormant,
                warnings: vec![format!(
                    "survey '{}' has these attributes already; nothing was changed",
                    e.name
                )],
                ..Outcome::default()
            });
        }
        let mut said = Vec::new();
        if new.date != e.date {
            said.extend(new.date.map(|d| format!("date {d}")));
        }
        if new.precedence != e.precedence {
            said.extend(new.precedence.map(|p| format!("precedence {p}")));
        }
        let action = format!("set '{}': {}", e.name, said.join(", "));
        self.commit(call, Plan { attributes: vec![new], action, ..Plan::default() })
    }

    /// Every page that only this survey holds.
    pub(super) fn survey_pages(&self, e: &SurveyEntry) -> Result<Vec<PageRef>> {
        let head = self.view.head(e.number)?.clone();
        let mut dead = vec![e.head, e.tops];
        for t in &head.tiles {
            dead.extend(self.tile_pages(t)?);
        }
        self.view.each_patch_page(e.number, |_, p| {
            dead.extend(p.blocks.iter().flatten());
            Ok(())
        })?;
        dead.extend(head.pages.iter().map(|(_, r)| *r));
        dead.extend(self.view.top_list(e.number)?.iter().map(|(_, r)| *r));
        Ok(dead)
    }
}
