//! Exposures that somebody should look at, in a folder each: images, rig, request and answer.
//!
//! `infer` gives the same answer from such a folder. A folder appears when it is whole.

use std::collections::VecDeque;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::UNIX_EPOCH;

use mvtop_core::{Options, Rig};
use serde_json::json;

use crate::config::Record;
use crate::exposure::{Exposure, Upload};
use crate::log;

/// Exposures that may wait to be written: their images are in memory.
const WAITING: usize = 4;
/// What names a folder as one of these: only such ones are ever removed.
const ABOUT: &str = "about.json";
const FORMAT: &str = "mvtop-record";
const VERSION: u32 = 1;
/// How the folders' names begin.
const PREFIX: &str = "exposure-";
/// How those begin that are not whole yet.
const PARTIAL: &str = ".mvtop-partial-";

/// Writes exposures in a thread of its own.
pub struct Recorder {
    writer: Mutex<Option<(SyncSender<Kept>, JoinHandle<()>)>>,
}

struct Kept {
    exposure: Arc<Exposure>,
    uploads: Arc<Vec<Upload>>,
    rig: Rig,
    model: PathBuf,
    doubt: String,
}

impl Recorder {
    /// - `options`: by which the models were loaded
    pub fn new(record: &Record, options: &Options) -> Result<Self, String> {
        let failed = |cause| format!("--record {}: cannot be used: {cause}", record.dir.display());
        fs::create_dir_all(&record.dir).map_err(failed)?;
        let mut folder = Folder::open(record, options).map_err(failed)?;
        let (kept, taken): (SyncSender<Kept>, Receiver<Kept>) = sync_channel(WAITING);
        let write = move || {
            while let Ok(kept) = taken.recv() {
                if let Err(cause) = folder.write(&kept) {
                    let dir = folder.dir.display();
                    let number = kept.exposure.number;
                    log::line(&format!(
                        "warning: cannot keep exposure {number} in {dir}: {cause}"
                    ));
                }
            }
        };
        let thread = thread::Builder::new().name("record".into()).spawn(write);
        let thread = thread.map_err(|cause| format!("cannot start a thread: {cause}"))?;
        Ok(Self {
            writer: Mutex::new(Some((kept, thread))),
        })
    }

    /// Keeps an exposure; `false` where too many wait already, as nobody is to wait for a disk.
    ///
    /// - `model`: the bundle's folder
    /// - `doubt`: why it is kept
    pub fn keep(
        &self,
        exposure: Arc<Exposure>,
        uploads: Arc<Vec<Upload>>,
        rig: Rig,
        model: &Path,
        doubt: String,
    ) -> bool {
        let model = model.to_owned();
        let kept = Kept {
            exposure,
            uploads,
            rig,
            model,
            doubt,
        };
        let writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
        writer
            .as_ref()
            .is_some_and(|(writer, _)| writer.try_send(kept).is_ok())
    }

    /// Writes what waits.
    pub fn finish(&self) {
        let writer = self
            .writer
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some((writer, thread)) = writer {
            drop(writer);
            let _ = thread.join();
        }
    }
}

/// The folder of all exposures that are kept.
struct Folder {
    dir: PathBuf,
    /// Of the command that repeats an exposure: what runs networks, and how.
    options: String,
    most: usize,
    most_bytes: u64,
    /// The oldest first, with their bytes.
    kept: VecDeque<(PathBuf, u64)>,
}

impl Folder {
    /// With what is in it from earlier, without what was begun by a process that was killed.
    fn open(record: &Record, options: &Options) -> io::Result<Self> {
        let mut kept = Vec::new();
        for entry in fs::read_dir(&record.dir)? {
            let path = entry?.path();
            let name = path.file_name().and_then(|name| name.to_str());
            let named = |prefix| name.is_some_and(|name| name.starts_with(prefix));
            if named(PARTIAL) && path.is_dir() {
                fs::remove_dir_all(&path)?;
            } else if named(PREFIX) && is_ours(&path) {
                let bytes = size(&path)?;
                kept.push((path, bytes));
            }
        }
        // Their names begin with the time.
        kept.sort();
        let mut text = format!(" --provider {}", options.session.provider);
        for (key, value) in &options.inference {
            text.push_str(&format!(" --set {}", quoted(&format!("{key}={value}"))));
        }
        Ok(Self {
            dir: record.dir.clone(),
            options: text,
            most: record.most.max(1),
            most_bytes: record.most_bytes,
            kept: kept.into(),
        })
    }

    fn write(&mut self, kept: &Kept) -> io::Result<()> {
        let since = kept.exposure.time.duration_since(UNIX_EPOCH);
        let ms = since.map_or(0, |since| since.as_millis());
        let path = self
            .dir
            .join(format!("{PREFIX}{ms:014}-{}", kept.exposure.number));
        let whole = tempfile::Builder::new()
            .prefix(PARTIAL)
            .tempdir_in(&self.dir)?;
        write_exposure(whole.path(), kept, &self.options, ms)?;
        let bytes = size(whole.path())?;
        fs::rename(whole.path(), &path)?;
        // It is no longer there under that name.
        let _ = whole.keep();
        self.kept.push_back((path, bytes));
        let mut all: u64 = self.kept.iter().map(|(_, bytes)| bytes).sum();
        while self.kept.len() > self.most || (all > self.most_bytes && self.kept.len() > 1) {
            let Some((oldest, bytes)) = self.kept.pop_front() else {
                break;
            };
            all -= bytes;
            if is_ours(&oldest) {
                fs::remove_dir_all(&oldest)?;
            }
        }
        Ok(())
    }
}

fn write_exposure(dir: &Path, kept: &Kept, options: &str, ms: u128) -> io::Result<()> {
    let Kept {
        exposure,
        uploads,
        rig,
        model,
        doubt,
    } = kept;
    // The command is for another folder.
    let model = model.canonicalize().unwrap_or_else(|_| model.clone());
    let mut images = serde_json::Map::new();
    let mut command = format!(
        "mvtop-cli infer --json --model {}",
        quoted(&model.display().to_string())
    );
    command.push_str(options);
    command.push_str(" --rig rig.json --request request.json");
    for upload in uploads.iter() {
        let camera = &rig.cameras()[upload.camera];
        let (bytes, ending) = upload.file(camera);
        // An id is always one that a file may have.
        let name = format!("{}.{ending}", camera.id());
        fs::write(dir.join(&name), &bytes)?;
        command.push_str(&format!(" {}", quoted(&format!("{}={name}", camera.id()))));
        images.insert(camera.id().to_owned(), name.into());
    }
    fs::write(dir.join("rig.json"), rig.to_json())?;
    fs::write(
        dir.join("request.json"),
        serde_json::to_string_pretty(&exposure.request)?,
    )?;
    if let Ok(found) = &exposure.outcome {
        fs::write(dir.join("answer.json"), &found.json)?;
    }
    let about = json!({
        "format": FORMAT,
        "version": VERSION,
        "mvtop": env!("CARGO_PKG_VERSION"),
        "request_id": exposure.id,
        "unix_ms": ms as u64,
        "why": doubt,
        "model": model.display().to_string(),
        "images": images,
        "replay": command,
    });
    fs::write(dir.join(ABOUT), serde_json::to_string_pretty(&about)?)
}

/// A word for a shell.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// Whether a folder is one that this wrote.
fn is_ours(path: &Path) -> bool {
    let about = path.join(ABOUT);
    let is_folder = path.symlink_metadata().is_ok_and(|about| about.is_dir());
    // A pipe would be waited for.
    let is_file = about.symlink_metadata().is_ok_and(|about| about.is_file());
    if !(is_folder && is_file) {
        return false;
    }
    let text = fs::read_to_string(about).unwrap_or_default();
    let about: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    about["format"] == FORMAT
}

fn size(dir: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(dir)? {
        bytes += entry?.metadata()?.len();
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    use mvtop_core::{Camera, Intrinsics, Projection};
    use nalgebra::Isometry3;

    use crate::exposure::Layout;

    fn kept(number: u64) -> Kept {
        let lens = Intrinsics::new(9., 9., 4., 3., Projection::Pinhole).unwrap();
        let camera = Camera::new("top", [8, 6], lens, Isometry3::identity()).unwrap();
        let upload = Upload {
            camera: 0,
            bytes: vec![7; 48].into(),
            layout: Layout::Mono8,
        };
        Kept {
            exposure: Arc::new(Exposure::failed(number)),
            uploads: Arc::new(vec![upload]),
            rig: Rig::new(vec![camera], 0).unwrap(),
            model: "models/it's".into(),
            doubt: "failed: a sentence".into(),
        }
    }

    fn names(dir: &Path) -> Vec<String> {
        let entries = fs::read_dir(dir).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn oldest_exposures_make_way_and_nothing_else_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("exposure-0-theirs")).unwrap();
        let theirs = dir.path().join(format!("{PARTIAL}theirs"));
        fs::write(&theirs, "a file").unwrap();
        let record = Record {
            dir: dir.path().to_owned(),
            most: 2,
            most_bytes: 1 << 20,
            below: 0.5,
        };
        let mut folder = Folder::open(&record, &Options::default()).unwrap();
        fs::remove_file(&theirs).unwrap();
        for number in 1..=3 {
            folder.write(&kept(number)).unwrap();
        }
        let all = [
            "exposure-0-theirs",
            "exposure-00000000002000-2",
            "exposure-00000000003000-3",
        ];
        assert_eq!(names(dir.path()), all);
        // Started again it knows what it has, and removes what was not finished.
        let begun = dir.path().join(format!("{PARTIAL}a"));
        fs::create_dir(&begun).unwrap();
        fs::write(begun.join("top.png"), "half").unwrap();
        let mut folder = Folder::open(&record, &Options::default()).unwrap();
        folder.write(&kept(4)).unwrap();
        assert_eq!(
            names(dir.path())[1..],
            ["exposure-00000000003000-3", "exposure-00000000004000-4"]
        );
        let one = dir.path().join("exposure-00000000004000-4");
        assert_eq!(
            names(&one),
            ["about.json", "request.json", "rig.json", "top.png"]
        );
        let about = fs::read_to_string(one.join(ABOUT)).unwrap();
        assert!(
            about.contains(r"'models/it'\\''s'") && about.contains("'top=top.png'"),
            "{about}"
        );
        let few = Record {
            most: 9,
            most_bytes: 1,
            ..record
        };
        Folder::open(&few, &Options::default())
            .unwrap()
            .write(&kept(5))
            .unwrap();
        assert_eq!(names(dir.path())[1..], ["exposure-00000000005000-5"]);
    }
}
