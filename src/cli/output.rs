//! Where results and messages go.

use crate::base::{Error, Result};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::io::{BufWriter, IsTerminal, StdoutLock, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

/// Standard output, buffered.
pub struct Output {
    out: BufWriter<StdoutLock<'static>>,
}

impl Default for Output {
    fn default() -> Output {
        Output::new()
    }
}

impl Output {
    pub fn new() -> Output {
        Output { out: BufWriter::new(std::io::stdout().lock()) }
    }

    pub fn line(&mut self, text: impl AsRef<str>) -> Result<()> {
        writeln!(self.out, "{}", text.as_ref()).map_err(|e| Error::io("standard output", e))
    }

    /// One JSON document on one line.
    pub fn json(&mut self, value: &impl Serialize) -> Result<()> {
        serde_json::to_writer(&mut self.out, value).map_err(|e| Error::io("standard output", e.into()))?;
        writeln!(self.out).map_err(|e| Error::io("standard output", e))
    }

    /// Bytes as they are.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(|e| Error::io("standard output", e))
    }

    pub fn end(mut self) -> Result<bool> {
        self.out.flush().map_err(|e| Error::io("standard output", e))?;
        Ok(true)
    }
}

/// A line for the person, on stderr.
pub fn message(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Set by Ctrl-C: work stops at the next step and nothing is changed. A second Ctrl-C ends the process.
pub fn stop_flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let seen = flag.clone();
        let _ = ctrlc::set_handler(move || {
            if seen.swap(true, Ordering::Relaxed) {
                std::process::exit(1);
            }
            message("stopping");
        });
        flag
    })
    .clone()
}

/// A bar with the time left, on a terminal only, and only once a second has passed.
pub struct Meter {
    started: Instant,
    bar: Mutex<Option<(String, ProgressBar)>>,
    terminal: bool,
}

impl Default for Meter {
    fn default() -> Meter {
        Meter::new()
    }
}

impl Meter {
    pub fn new() -> Meter {
        Meter { started: Instant::now(), bar: Mutex::new(None), terminal: std::io::stderr().is_terminal() }
    }

    /// Whether anybody sees it by now.
    pub fn is_shown(&self) -> bool {
        self.terminal && self.started.elapsed() >= Duration::from_secs(1)
    }

    pub fn report(&self, stage: &str, share: f64) {
        if !self.is_shown() {
            return;
        }
        let Ok(mut bar) = self.bar.lock() else { return };
        if bar.as_ref().is_none_or(|(s, _)| s != stage) {
            if let Some((_, old)) = bar.take() {
                old.finish_and_clear();
            }
            let new = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr());
            let style =
                ProgressStyle::with_template("{msg:12} {bar:40} {percent:>3}%  {elapsed} gone, {eta} left");
            if let Ok(style) = style {
                new.set_style(style);
            }
            new.set_message(stage.to_string());
            *bar = Some((stage.to_string(), new));
        }
        if let Some((_, b)) = bar.as_ref() {
            b.set_position((share * 1000.0) as u64);
        }
    }

    pub fn clear(&self) {
        if let Ok(mut bar) = self.bar.lock()
            && let Some((_, b)) = bar.take()
        {
            b.finish_and_clear();
        }
    }
}

/// Bytes for people.
pub fn bytes(n: u64) -> String {
    match n {
        0..=9_999 => format!("{n} B"),
        10_000..=9_999_999 => format!("{:.1} kB", n as f64 / 1e3),
        10_000_000..=9_999_999_999 => format!("{:.1} MB", n as f64 / 1e6),
        _ => format!("{:.1} GB", n as f64 / 1e9),
    }
}

/// A count with thin separators.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (k, c) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(c);
    }
    out
}

/// Columns of text, aligned.
pub fn table(header: &[&str], rows: &[Vec<String>], out: &mut Output) -> Result<()> {
    let mut width: Vec<usize> = header.iter().map(|h| h.chars().count()).collect();
    for r in rows {
        for (w, c) in width.iter_mut().zip(r) {
            *w = (*w).max(c.chars().count());
        }
    }
    let line = |cells: Vec<&str>| {
        let padded: Vec<String> = cells
            .iter()
            .zip(&width)
            .map(|(c, w)| format!("{c}{}", " ".repeat(w - c.chars().count())))
            .collect();
        padded.join("  ").trim_end().to_string()
    };
    out.line(line(header.to_vec()))?;
    for r in rows {
        out.line(line(r.iter().map(String::as_str).collect()))?;
    }
    Ok(())
}
