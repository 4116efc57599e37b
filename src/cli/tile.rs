//! `export` of .ifs: its options, and what is said of a fractal tile.

use super::coded::at_most;
use super::output::count;
use crate::base::Result;
use crate::export::fractal::{Choice, TileTold, search_of};
use crate::wire::v1;
use crate::wire::v1::file_request::Search as Asked;
use clap::{Args, ValueEnum};
use terraquilt_codecs::fractal::Search;

/// Which domains a range meets.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SearchKind {
    Near,
    Classes,
    Exact,
}

/// What an .ifs is made with, beside bound and unit.
#[derive(Args)]
pub struct TileArgs {
    /// .ifs: so many maps at most, instead of a bound: the error that they make at posts is measured, not promised
    #[arg(long, value_name = "N", conflicts_with = "bound")]
    maps: Option<u64>,
    /// .ifs: which domains a range meets: the near ones; those of like classes far away; all, for the best of maps and
    /// a million posts at most. Default: near
    #[arg(long, value_enum)]
    search: Option<SearchKind>,
}

impl TileArgs {
    /// # Errors
    /// If one of them is given for a file of another kind.
    pub fn only_for_ifs(&self, ending: &str) -> Result<()> {
        self.choice(None, None).only_for_ifs(ending)
    }

    /// What is chosen, with what streams may choose too.
    pub fn choice(&self, bound: Option<f64>, unit: Option<f64>) -> Choice {
        let name = self.search.and_then(|s| s.to_possible_value());
        let search = name.as_ref().and_then(|v| search_of(v.get_name()));
        Choice { bound, maps: self.maps, unit, search }
    }
}

/// The question of a server, with what is chosen.
pub fn asked(request: v1::FileRequest, choice: &Choice) -> v1::FileRequest {
    let search = match choice.search {
        None => Asked::Unspecified,
        Some(Search::Near(_)) => Asked::Near,
        Some(Search::Classes) => Asked::Classes,
        Some(Search::Exact) => Asked::Exact,
    };
    v1::FileRequest {
        bound_m: choice.bound,
        maps: choice.maps,
        unit_m: choice.unit.unwrap_or(0.0),
        search: search as i32,
        ..request
    }
}

/// One line for people.
pub fn text(t: &TileTold) -> String {
    format!(
        "{} x {} posts on {}, {} maps, error at posts {} m (surface {:.3}, rounding {}, codec {:.3} {}), {:.2} bits a post",
        count(t.cols as u64),
        count(t.rows as u64),
        t.posts,
        count(t.maps),
        at_most(t.error_m),
        t.surface_error_m,
        t.rounding_m,
        t.codec_error_m,
        if t.bounded { "bounded" } else { "measured" },
        t.bits_per_sample
    )
}
