//! Files, read whole but not without end.

use std::path::{Path, PathBuf};

use mvtop_geometry::{Error, Result, file};

use crate::Checked;

/// Largest file that is read: COLMAP's images.bin lists the points of every image.
const MOST_BYTES: u64 = 1 << 29;
/// Largest file of text that is taken apart.
const MOST_TEXT: usize = 1 << 26;
/// Of COLMAP's folder, binary ones first, as COLMAP itself prefers them.
const COLMAP: [[&str; 2]; 2] = [["cameras.bin", "images.bin"], ["cameras.txt", "images.txt"]];

/// A file that was read.
pub struct Source {
    /// For errors.
    pub name: String,
    pub path: PathBuf,
    pub bytes: Vec<u8>,
    /// Whether its folder tells it from others that are called alike.
    by_folder: bool,
}

/// Reads files; of folders, those of COLMAP.
pub fn read(paths: &[PathBuf]) -> Result<Vec<Source>> {
    let mut sources = Vec::new();
    for path in paths {
        if !path.is_dir() {
            sources.push(Source::read(path)?);
            continue;
        }
        let complete = |names: &&[&str; 2]| names.iter().all(|name| path.join(name).is_file());
        let Some(names) = COLMAP.iter().find(complete) else {
            return Err(Error::Rig {
                origin: path.display().to_string(),
                problem: "a folder without COLMAP's cameras and images (.bin or .txt); name the \
                          calibration files themselves"
                    .into(),
                cause: None,
            });
        };
        for name in names {
            sources.push(Source::read(&path.join(name))?);
        }
    }
    name_by_folders(&mut sources);
    if sources.is_empty() {
        return Err(Error::Input(
            "no calibration file given: expected at least one".into(),
        ));
    }
    Ok(sources)
}

/// Marks files that are called alike in folders that are not: `cam1/calib.json` and `cam2/calib.json`.
fn name_by_folders(sources: &mut [Source]) {
    let names: Vec<_> = sources
        .iter()
        .map(|source| (source.own_stem(), source.folder()))
        .collect();
    for (source, (stem, folder)) in sources.iter_mut().zip(&names) {
        source.by_folder = names
            .iter()
            .any(|(other, of)| other == stem && of != folder);
    }
}

impl Source {
    fn read(path: &Path) -> Result<Self> {
        Ok(Self {
            name: path.display().to_string(),
            path: path.to_owned(),
            bytes: file::read(path, MOST_BYTES)?,
            by_folder: false,
        })
    }

    /// The file's own name, in lower case.
    pub fn file_name(&self) -> String {
        let name = self.path.file_name().unwrap_or_default();
        name.to_string_lossy().to_lowercase()
    }

    /// The name without its ending; the folder's where that tells files apart that are called alike.
    pub fn stem(&self) -> String {
        match self.folder().filter(|_| self.by_folder) {
            Some(folder) => folder,
            None => self.own_stem(),
        }
    }

    fn own_stem(&self) -> String {
        let name = self.path.file_stem().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    fn folder(&self) -> Option<String> {
        let name = self.path.parent()?.file_name()?;
        Some(name.to_string_lossy().into_owned())
    }

    /// Its text, without a byte order mark.
    pub fn text(&self) -> Checked<&str> {
        if self.bytes.len() > MOST_TEXT {
            let most = MOST_TEXT >> 20;
            return Err(format!("{}: larger than {most} MiB of text", self.name));
        }
        if self.bytes.starts_with(&[0xff, 0xfe]) || self.bytes.starts_with(&[0xfe, 0xff]) {
            return Err(format!(
                "{}: expected text in UTF-8, got UTF-16; save it as UTF-8",
                self.name
            ));
        }
        if self.bytes.starts_with(b"MATLAB ") {
            return Err(format!(
                "{}: expected text, got a MAT-file, whose objects MATLAB alone reads; write JSON there with \
                 `writelines(jsonencode(toStruct(params)), \"params.json\")` and give that",
                self.name
            ));
        }
        let text = std::str::from_utf8(&self.bytes)
            .map_err(|_| format!("{}: expected text (UTF-8), got other bytes", self.name))?;
        Ok(text.strip_prefix('\u{feff}').unwrap_or(text))
    }
}
