//! The one way in which files are read: whole, bounded, and never from what may not end.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

use crate::{Error, Result};

/// Opens a file for reading; a pipe or a device, which may never end, is none.
///
/// # Errors
/// [`Error::Read`] where it cannot be opened, or is no regular file.
pub fn open(path: &Path) -> Result<File> {
    regular(path).map_err(Error::read(path))
}

/// The bytes of a file.
///
/// - `most`: as many at most
///
/// # Errors
/// As [`open`], and [`Error::Read`] where the file is larger.
///
/// ```
/// use std::path::Path;
/// use mvtop_geometry::file;
///
/// assert_eq!(file::read(Path::new("Cargo.toml"), 1 << 20)?, std::fs::read("Cargo.toml").unwrap());
/// assert!(file::read(Path::new("Cargo.toml"), 10).is_err());
/// assert!(file::read(Path::new("src"), 1 << 20).is_err());
/// # Ok::<(), mvtop_geometry::Error>(())
/// ```
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>> {
    bounded(path, most).map_err(Error::read(path))
}

/// The text of a file, without the byte order mark that some editors begin it with.
///
/// - `most`: bytes at most
///
/// # Errors
/// As [`read`], and [`Error::Read`] where it is no UTF-8.
pub fn read_text(path: &Path, most: u64) -> Result<String> {
    let mut bytes = read(path, most)?;
    if bytes.starts_with("\u{feff}".as_bytes()) {
        bytes.drain(..3);
    }
    String::from_utf8(bytes).map_err(|cause| {
        let problem = format!("expected text in UTF-8, got others: {}", cause.utf8_error());
        Error::read(path)(io::Error::new(ErrorKind::InvalidData, problem))
    })
}

fn regular(path: &Path) -> io::Result<File> {
    // Asked before it is opened: to open a pipe waits for who writes to it.
    let about = path.metadata()?;
    if about.is_file() {
        return File::open(path);
    }
    let what = if about.is_dir() {
        "folder"
    } else {
        "pipe or device"
    };
    let problem = format!("it is a {what}, expected a file");
    Err(io::Error::new(ErrorKind::InvalidInput, problem))
}

fn bounded(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    regular(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 <= most {
        return Ok(bytes);
    }
    let problem = format!("it is larger than {}, more than expected", size(most));
    Err(io::Error::new(ErrorKind::FileTooLarge, problem))
}

fn size(bytes: u64) -> String {
    match bytes >> 20 {
        0 => format!("{bytes} bytes"),
        mebibytes => format!("{mebibytes} MiB"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn byte_order_mark_is_no_part_of_the_text() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "\u{feff}{}").unwrap();
        assert_eq!(read_text(file.path(), 9).unwrap(), "{}");
        std::fs::write(file.path(), b"\xff\xfe{").unwrap();
        let error = read_text(file.path(), 9).unwrap_err().to_string();
        assert!(error.contains("expected text in UTF-8"), "{error}");
    }

    #[test]
    fn file_that_is_larger_than_expected_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "12345").unwrap();
        assert_eq!(read(file.path(), 5).unwrap(), b"12345");
        let error = read(file.path(), 4).unwrap_err().to_string();
        assert!(error.contains("larger than 4 bytes"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn pipes_devices_and_folders_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe.json");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        for (path, what) in [
            (pipe.as_path(), "pipe or device"),
            (Path::new("/dev/zero"), "pipe or device"),
            (folder.path(), "folder"),
        ] {
            let error = read(path, 1 << 20).unwrap_err().to_string();
            assert!(
                error.contains(what) && error.contains("expected a file"),
                "{error}"
            );
        }
    }
}
