//! USGS ASCII DEM (`.dem`): a header of 1024 characters, then one profile a column, west to east, each from south
//! to north and with a place of its own, then a record of accuracies.
//!
//! Opening goes once through the profiles and keeps where each one lies and begins; posts of the rectangle around
//! them that no profile reaches are void, like those of -32767. Heights are whole steps of the header's vertical
//! resolution; the scale turns them into metres, also from feet.
//!
//! Layout: USGS, Standards for Digital Elevation Models, part 2 (1998), records A, B and C. The accuracy is that of
//! record C: the root mean squares of the datum and of the heights on it, together, times 1.6449 (90 %).

mod fields;
mod header;

use super::input::Input;
use super::sidecar;
use super::voids::Voids;
use super::window;
use crate::base::{Error, Result, limits};
use crate::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};
use fields::Fields;
use header::Header;
use std::sync::Arc;

pub use header::begins;

const VOID: i32 = -32767;
/// How far profiles may lie from the grid's lines, in steps: the header's steps have six digits.
const LATTICE_SLACK: f64 = 0.02;

/// One column of the grid.
struct Profile {
    /// Column, from the first profile.
    col: u64,
    /// Row of its southernmost post, from the south.
    south: u64,
    posts: u64,
    /// Steps of the vertical resolution that its heights are counted from.
    base: i32,
    /// Byte where its heights begin.
    at: u64,
}

/// One DEM.
pub struct UsgsDem {
    info: SourceInfo,
    input: Arc<Input>,
    /// By column; a column may have none.
    profiles: Vec<Profile>,
    voids: Voids,
}

impl UsgsDem {
    /// Opens a DEM and goes once through its profiles.
    ///
    /// # Errors
    /// [`Error::Corrupt`], with the profile, for headers and profiles that are not understood or end early;
    /// [`Error::Unsupported`] for patterns that are no grid.
    pub fn open(input: Input) -> Result<UsgsDem> {
        let input = Arc::new(input);
        let header = Header::read(&input)?;
        let found = Found::read(&input, &header)?;
        let (cols, rows) = (found.cols, found.rows);
        window::check_size(&input.file, cols, rows)?;
        // Real quadrangles are slanted a little; a grid that is almost all void is a lie about places.
        if cols * rows > found.posts.saturating_mul(8) + (1 << 16) {
            let reason =
                format!("{} posts, but the places of the profiles span {cols} x {rows}", found.posts);
            return Err(Error::corrupt(&input.file, "profiles", reason));
        }
        let [dx, dy] = header.step;
        let to_degrees = |v: f64| v * header.degrees;
        let north = found.south + (rows - 1) as f64 * dy;
        let affine = Affine {
            origin: [to_degrees(found.west), to_degrees(north)],
            col_step: [to_degrees(dx), 0.0],
            row_step: [0.0, -to_degrees(dy)],
        };
        let mut notes = header.notes.clone();
        notes.extend(found.accuracy.map(|(rmse, _)| {
            format!(
                "its record of accuracies: {rmse:.2} m root mean square, 1.6449 times that is taken (90 %)"
            )
        }));
        let crs = header.crs(&mut notes);
        let mut info = SourceInfo {
            file: input.file.clone(),
            format: "USGS DEM",
            cols,
            rows,
            sample_type: if found.small { SampleType::I16 } else { SampleType::I32 },
            affine: Some(affine).filter(sidecar::usable),
            crs,
            nodata: Some(f64::from(VOID)),
            scale: header.height_step * header.height_unit_m,
            offset: 0.0,
            accuracy_m: found.accuracy.map(|(_, le90)| le90),
            product: Some("USGS DEM"),
            vertical_datum: None,
            vertical_unit_m: None,
            notes,
        };
        sidecar::complete(&mut info, &input, &[])?;
        let voids = Voids::of(&mut info);
        Ok(UsgsDem { info, input, profiles: found.profiles, voids })
    }
}

impl HeightSource for UsgsDem {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
        self.voids = Voids::of(&mut self.info);
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        window::check(&self.info, w)?;
        let mut posts = vec![VOID; w.cols * w.rows];
        // Rows of the window, counted from the south: first and end.
        let south = self.info.rows - w.row - w.rows as u64;
        let north = self.info.rows - w.row;
        let inside = |p: &&Profile| (w.col..w.col + w.cols as u64).contains(&p.col);
        for p in self.profiles.iter().filter(inside) {
            let mut fields = Fields::new(self.input.reader(p.at), p.at);
            for row in p.south..(p.south + p.posts).min(north) {
                let post = fields.integer().map_err(|e| Error::io(&self.info.file, e))?;
                let Some(post) = post.and_then(|v| above(v, p.base)) else {
                    let place = format!("profile {}", p.col + 1);
                    return Err(Error::corrupt(&self.info.file, place, "the file changed while it was read"));
                };
                if row >= south {
                    posts[(north - 1 - row) as usize * w.cols + (p.col - w.col) as usize] = post;
                }
            }
        }
        let data: Vec<u8> = if self.info.sample_type == SampleType::I16 {
            posts.iter().flat_map(|v| (*v as i16).to_le_bytes()).collect()
        } else {
            posts.iter().flat_map(|v| v.to_le_bytes()).collect()
        };
        // A reach that no profile has is void under any nodata value.
        let mut valid = self.voids.valid(&data);
        valid.iter_mut().zip(&posts).filter(|(_, v)| **v == VOID).for_each(|(valid, _)| *valid = 0);
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid })
    }

    /// Every read passes over all profiles.
    fn row_batch(&self) -> usize {
        window::tall_batch(&self.info)
    }
}

/// A height on its profile's base; voids stay.
fn above(post: i32, base: i32) -> Option<i32> {
    if post == VOID { Some(VOID) } else { post.checked_add(base) }
}

/// What one pass through the profiles finds.
struct Found {
    profiles: Vec<Profile>,
    cols: u64,
    rows: u64,
    /// Posts stored.
    posts: u64,
    /// Place of the south-west post of the rectangle, in the header's units.
    west: f64,
    south: f64,
    /// All posts fit int16.
    small: bool,
    /// Root mean square error and 90 % error of the heights, metres.
    accuracy: Option<(f64, f64)>,
}

impl Found {
    fn read(input: &Arc<Input>, header: &Header) -> Result<Found> {
        let mut fields = Fields::new(input.reader(header.profiles_at), header.profiles_at);
        // Place of each profile's southernmost post, posts, base, byte.
        let mut places: Vec<([f64; 2], u64, i32, u64)> = Vec::new();
        let (mut posts, mut small) = (0u64, true);
        for number in 1..=header.profiles {
            let place = format!("profile {number} of {}", header.profiles);
            let bad = |reason: String| Error::corrupt(&input.file, &place, reason);
            let read = |e: std::io::Error| Error::io(&input.file, e);
            let mut head = [0; 4];
            for v in &mut head {
                *v = fields
                    .integer()
                    .map_err(read)?
                    .ok_or_else(|| bad("its head ends early or is no number".into()))?;
            }
            let [_, _, count, columns] = head;
            if count < 1 || columns != 1 {
                return Err(bad(format!("{count} x {columns} posts; a profile has some in one column")));
            }
            let mut reals = [0.0; 5];
            for v in &mut reals {
                // Least and largest height may be blank: nothing hangs on them.
                *v = fields.real().map_err(read)?.unwrap_or(f64::NAN);
            }
            let [x, y, base_height, ..] = reals;
            if !(x.is_finite() && y.is_finite() && base_height.is_finite()) {
                return Err(bad("its place or its base is no number".into()));
            }
            let base = base_height / header.height_step;
            if base.fract() != 0.0 || base.abs() > 1e6 {
                return Err(bad(format!(
                    "its heights are counted from {base_height}, which is no multiple of {}",
                    header.height_step
                )));
            }
            let at = fields.at();
            for k in 0..count {
                let post = fields.integer().map_err(read)?.and_then(|v| above(v, base as i32));
                let post = post.ok_or_else(|| bad(format!("{k} of {count} heights, then something else")))?;
                small &= i16::try_from(post).is_ok();
            }
            posts += count as u64;
            places.push(([x, y], count as u64, base as i32, at));
        }
        let accuracy = header.states_accuracy.then(|| accuracy(&mut fields, header)).flatten();
        let west = places[0].0[0];
        let south = places.iter().map(|p| p.0[1]).fold(f64::INFINITY, f64::min);
        let mut found = Found { profiles: Vec::new(), cols: 0, rows: 0, posts, west, south, small, accuracy };
        for (k, (at, count, base, byte)) in places.into_iter().enumerate() {
            let steps = [(at[0] - west) / header.step[0], (at[1] - south) / header.step[1]];
            let on_grid = steps.iter().all(|s| {
                (0.0..limits::SIDE_MAX as f64).contains(&s.round()) && (s - s.round()).abs() <= LATTICE_SLACK
            });
            let [col, row] = steps.map(|s| s.round().max(0.0) as u64);
            if !on_grid || (k > 0 && col < found.cols) {
                let reason = format!(
                    "it begins {:.3} x {:.3} steps from the south-west post; profiles must go east on a grid",
                    steps[0], steps[1]
                );
                return Err(Error::corrupt(&input.file, format!("profile {}", k + 1), reason));
            }
            found.cols = col + 1;
            found.rows = found.rows.max(row + count);
            found.profiles.push(Profile { col, south: row, posts: count, base, at: byte });
        }
        Ok(found)
    }
}

/// Record C: of the datum and of the heights on it, each a flag, three root mean squares (x, y, z), a count.
fn accuracy<R: std::io::Read>(fields: &mut Fields<R>, header: &Header) -> Option<(f64, f64)> {
    const LE90: f64 = 1.6449;
    let mut squares = 0.0;
    for _ in 0..2 {
        let mut five = [0; 5];
        for v in &mut five {
            *v = fields.integer().ok()??;
        }
        let [stated, _, _, z, _] = five;
        if stated == 1 && z > 0 {
            squares += (f64::from(z) * header.height_unit_m).powi(2);
        }
    }
    (squares > 0.0).then(|| (squares.sqrt(), squares.sqrt() * LE90))
}
