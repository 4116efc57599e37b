//! Windows that are asked for, held against the grid and the limits before anything is allocated.

use crate::base::{Error, Result, limits};
use crate::height::source::{SourceInfo, Window};

/// Refuses windows that leave the grid or hold more posts than one call may hand over.
pub fn check(info: &SourceInfo, w: Window) -> Result<()> {
    let col_end = w.col.checked_add(w.cols as u64);
    let row_end = w.row.checked_add(w.rows as u64);
    let inside = col_end.is_some_and(|c| c <= info.cols) && row_end.is_some_and(|r| r <= info.rows);
    if !inside {
        let reason = format!(
            "{} x {} posts from column {}, row {} leave the grid of {} x {}",
            w.cols, w.rows, w.col, w.row, info.cols, info.rows
        );
        return Err(Error::invalid(format!("window of {}", info.file), reason));
    }
    // Both factors are below SIDE_MAX, so the product fits.
    let posts = w.cols as u64 * w.rows as u64;
    if posts > limits::WINDOW_POSTS_MAX {
        let what = format!("posts in one window of {}", info.file);
        return Err(Error::limit(what, limits::WINDOW_POSTS_MAX, posts));
    }
    Ok(())
}
