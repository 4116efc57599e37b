//! Sizes of grids and windows that are asked for, held against the limits before anything is allocated.

use crate::base::{Error, Result, limits};
use crate::height::source::{SourceInfo, Window};

/// Refuses grids without posts, and those that are larger than any survey file.
pub fn check_size(file: &str, cols: u64, rows: u64) -> Result<()> {
    if cols == 0 || rows == 0 {
        return Err(Error::corrupt(file, "grid size", format!("{cols} x {rows} posts")));
    }
    for (side, what) in [(cols, "columns"), (rows, "rows")] {
        if side > limits::SIDE_MAX {
            return Err(Error::limit(format!("{what} of {file}"), limits::SIDE_MAX, side));
        }
    }
    if cols * rows > limits::POSTS_MAX {
        return Err(Error::limit(format!("posts of {file}"), limits::POSTS_MAX, cols * rows));
    }
    Ok(())
}

/// Rows of a grid that are worth reading together where every read passes over the whole file: all, unless
/// that is more posts than fit.
pub fn tall_batch(info: &SourceInfo) -> usize {
    const POSTS: u64 = 16 << 20;
    (POSTS / info.cols).clamp(1, info.rows) as usize
}

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
