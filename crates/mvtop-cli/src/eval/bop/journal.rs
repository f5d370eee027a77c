//! Results on disk while they come: one line of JSON for each group, so that an evaluation that
//! was cut short goes on where it stopped.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use mvtop_eval::bop::Estimate;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::score::Scored;
use crate::failure::{Failure, Result};
use crate::write::{self, failed};

/// What a group gave.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Line {
    /// Scene and views: unique in a split.
    pub group: String,
    pub scene: u32,
    /// Of the reference image; empty where the scene has one only.
    pub sensor: String,
    /// Number of the reference image.
    pub image: u32,
    /// Seconds from decoded images to poses.
    pub time_s: f64,
    /// Predictions that no object of the truth was matched with.
    pub extra: usize,
    /// In the reference image.
    pub estimates: Vec<Estimate>,
    pub objects: Vec<Scored>,
}

/// `run.json` says what is evaluated, `groups.jsonl` what came of it so far.
pub struct Journal {
    file: File,
    path: PathBuf,
}

impl Journal {
    /// Opens a folder of results, new or to go on with, and gives the lines that are whole.
    ///
    /// - `run`: all that results depend on; what was begun with another one is refused
    /// - `force`: begin anew
    pub fn open(dir: &Path, run: &Value, force: bool) -> Result<(Self, Vec<Line>)> {
        let (about, path) = (dir.join("run.json"), dir.join("groups.jsonl"));
        write::folder(dir)?;
        if force {
            let results = ["summary.json", "report.html"].map(|name| dir.join(name));
            for old in results.iter().chain([&path, &about]) {
                if old.exists() {
                    std::fs::remove_file(old).map_err(failed("remove", old))?;
                }
            }
        }
        if about.exists() {
            let text = std::fs::read_to_string(&about).map_err(failed("read", &about))?;
            let begun: Value = serde_json::from_str(&text).unwrap_or_default();
            if begun != *run {
                return Err(Failure(format!(
                    "{} is of another evaluation ({}); name another folder, or begin anew with \
                     --force",
                    dir.display(),
                    difference(&begun, run)
                )));
            }
        } else if path.exists() {
            return Err(Failure(format!(
                "{} has results but no run.json to say of what; name another folder, or begin anew \
                 with --force",
                dir.display()
            )));
        } else {
            write::whole(&about, &format!("{run:#}\n"))?;
        }
        let lines = whole_lines(&path)?;
        let file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(failed("open", &path))?;
        Ok((Self { file, path }, lines))
    }

    pub fn append(&mut self, line: &Line) -> Result<()> {
        let text = write::json(line)? + "\n";
        // In one piece; what a kill leaves of it is dropped when it is read again.
        self.file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.flush())
            .map_err(failed("write", &self.path))
    }
}

/// The lines that end in a line break; what follows the last one is cut off.
fn whole_lines(path: &Path) -> Result<Vec<Line>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = std::fs::read(path).map_err(failed("read", path))?;
    let end = text.iter().rposition(|&byte| byte == b'\n');
    let end = end.map_or(0, |last| last + 1);
    if end < text.len() {
        let file = OpenOptions::new().write(true).open(path);
        file.and_then(|file| file.set_len(end as u64))
            .map_err(failed("cut", path))?;
    }
    let whole = text[..end].split(|&byte| byte == b'\n');
    let read = |(i, line): (usize, &[u8])| {
        serde_json::from_slice(line).map_err(|cause| {
            let (path, line) = (path.display(), i + 1);
            Failure(format!(
                "{path}: line {line} is not one of mvtop-cli's ({cause}); begin anew with --force"
            ))
        })
    };
    let lines = whole.filter(|line| !line.is_empty()).enumerate();
    lines.map(read).collect()
}

/// Names and values of what differs.
fn difference(begun: &Value, now: &Value) -> String {
    let now = now.as_object().into_iter().flatten();
    let differing = now.filter(|(key, value)| begun.get(key) != Some(value));
    let shown = differing.map(|(key, value)| format!("{key} was {}, is {value}", begun[key]));
    shown.collect::<Vec<_>>().join(", ")
}
