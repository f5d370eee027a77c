//! Results on disk while they come: one line of JSON for each group, so that an evaluation that
//! was cut short goes on where it stopped.

use std::collections::HashSet;
use std::fs::{File, OpenOptions, TryLockError, remove_file};
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::bop::Estimate;
use mvtop_core::{file, json};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::detection::Detections;
use super::score::Scored;
use super::tally::Tally;
use crate::{Error, Result, files};

/// What a group gave.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Line {
    /// Scene and views: unique in a split.
    pub group: String,
    /// Number of the scene.
    pub scene: u32,
    /// Of the reference image; empty where the scene has one only.
    pub sensor: String,
    /// Number of the reference image.
    pub image: u32,
    /// Seconds from decoded images to poses, where they are known.
    pub time_s: Option<f64>,
    /// Predictions that no object of the truth was matched with.
    pub extra: usize,
    /// What each of these says of itself; null where it was not refined.
    pub extra_confidences: Vec<Option<f64>>,
    /// In the reference image.
    pub estimates: Vec<Estimate>,
    /// What BOP's average recalls count, by object.
    pub tallies: Vec<Tally>,
    /// What its average precisions count, by object.
    pub detections: Vec<Detections>,
    /// Of each target.
    pub objects: Vec<Scored>,
}

/// `run.json` says what is evaluated, `groups.jsonl` what came of it so far.
pub struct Journal {
    file: File,
    path: PathBuf,
}

const ABOUT: &str = "run.json";
const GROUPS: &str = "groups.jsonl";
/// Largest files of results that are read.
const MAX_ABOUT_BYTES: u64 = 1 << 20;
const MAX_GROUPS_BYTES: u64 = 1 << 34;

impl Journal {
    /// Opens a folder of results, new or to go on with, and gives the lines that are whole. Until it
    /// is dropped, or its process ends in whatever way, no other can open it.
    ///
    /// - `run`: all that results depend on; what was begun with another one is refused
    /// - `results`: names of the files that will be written beside the journal
    /// - `read`: files that the evaluation reads, which none of these may be
    /// - `force`: begin anew, removing what an evaluation wrote; other files are refused all the same
    pub fn open(
        dir: &Path,
        run: &Value,
        results: &[&str],
        read: &[&Path],
        force: bool,
    ) -> Result<(Self, Vec<Line>)> {
        let (about, path) = (dir.join(ABOUT), dir.join(GROUPS));
        for name in results.iter().chain(&[ABOUT, GROUPS]) {
            files::spare(&dir.join(name), read, "name another folder")?;
        }
        files::folder(dir)?;
        // Before `run.json` is looked for: an evaluation that begins meanwhile writes that first.
        let foreign = foreign(dir, results);
        if let (Some(name), None) = (foreign, begun(&about)?) {
            return Err(Error::Input(format!(
                "{} holds {name}, but no {ABOUT} that says of which evaluation; name another \
                 folder, or move the file",
                dir.display()
            )));
        }
        let file = OpenOptions::new().create(true).append(true).open(&path);
        let file = file.map_err(Error::write("open", &path))?;
        file.try_lock().map_err(|cause| match cause {
            TryLockError::WouldBlock => Error::Input(format!(
                "another evaluation is writing to {}; wait for it, or name another folder",
                dir.display()
            )),
            TryLockError::Error(cause) => Error::write("lock", &path)(cause),
        })?;
        // Not before: another evaluation may have begun and ended in between.
        let mut begun = begun(&about)?;
        if force && begun.is_some() {
            file.set_len(0).map_err(Error::write("empty", &path))?;
            for old in results
                .iter()
                .map(|name| dir.join(name))
                .chain([about.clone()])
            {
                if old.symlink_metadata().is_ok() {
                    remove_file(&old).map_err(Error::write("remove", &old))?;
                }
            }
            begun = None;
        }
        if let Some(begun) = begun {
            if begun != *run {
                return Err(Error::Input(format!(
                    "{} is of another evaluation ({}); name another folder, or begin anew with \
                     --force",
                    dir.display(),
                    difference(&begun, run)
                )));
            }
        } else {
            files::whole(&about, format!("{run:#}\n").as_bytes())?;
        }
        let lines = whole_lines(&path)?;
        Ok((Self { file, path }, lines))
    }

    pub fn append(&mut self, line: &Line) -> Result<()> {
        let text = files::json(line)? + "\n";
        // In one piece; what a kill leaves of it is dropped when it is read again.
        self.file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.flush())
            .map_err(Error::write("write", &self.path))
    }
}

/// One of the names that something in a folder has, if any. A journal without a line is nothing: it is
/// what an evaluation leaves that was killed before it could say what it is of.
fn foreign<'a>(dir: &Path, results: &[&'a str]) -> Option<&'a str> {
    let there = |name: &str| dir.join(name).symlink_metadata().ok();
    let begun = there(GROUPS).is_some_and(|about| !about.is_file() || about.len() > 0);
    let mut results = results.iter().copied();
    let result = results.find(|name| there(name).is_some());
    result.or(begun.then_some(GROUPS))
}

/// What a folder's evaluation was begun with; `None` where there is none. A file of that name which
/// does not say that it is an evaluation's is refused.
fn begun(about: &Path) -> Result<Option<Value>> {
    if about.symlink_metadata().is_err() {
        return Ok(None);
    }
    let text = file::read_text(about, MAX_ABOUT_BYTES)?;
    let begun: Value = json::from_str(&text).unwrap_or_default();
    let source = ["model_sha256", "predictions_sha256"].map(|key| begun.get(key));
    match source {
        [Some(_), _] | [_, Some(_)] => Ok(Some(begun)),
        [None, None] => Err(Error::Input(format!(
            "{} is not one of mvtop-cli's; name another folder",
            about.display()
        ))),
    }
}

/// The lines that end in a line break; what follows the last one is cut off.
fn whole_lines(path: &Path) -> Result<Vec<Line>> {
    let text = file::read(path, MAX_GROUPS_BYTES)?;
    let end = text.iter().rposition(|&byte| byte == b'\n');
    let end = end.map_or(0, |last| last + 1);
    if end < text.len() {
        let file = OpenOptions::new().write(true).open(path);
        file.and_then(|file| file.set_len(end as u64))
            .map_err(Error::write("cut", path))?;
    }
    let whole = text[..end].split(|&byte| byte == b'\n');
    let read = |(i, line): (usize, &[u8])| {
        serde_json::from_slice(line).map_err(|cause| {
            let (path, line) = (path.display(), i + 1);
            Error::Input(format!(
                "{path}: line {line} is not one of mvtop-cli's ({cause}); begin anew with --force"
            ))
        })
    };
    let lines = whole.filter(|line| !line.is_empty()).enumerate();
    let lines: Vec<Line> = lines.map(read).collect::<Result<_>>()?;
    let mut groups = HashSet::new();
    match lines.iter().find(|line| !groups.insert(&line.group)) {
        None => Ok(lines),
        Some(twice) => Err(Error::Input(format!(
            "{}: group {} stands twice, so it would count twice; begin anew with --force",
            path.display(),
            twice.group
        ))),
    }
}

/// Names and values of what differs.
fn difference(begun: &Value, now: &Value) -> String {
    let now = now.as_object().into_iter().flatten();
    let differing = now.filter(|(key, value)| begun.get(key) != Some(value));
    let shown = differing.map(|(key, value)| format!("{key} was {}, is {value}", begun[key]));
    shown.collect::<Vec<_>>().join(", ")
}
