//! Files of results: none is overwritten unasked, and each appears when it is whole.

use std::fs::create_dir_all;
use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;

use crate::{Error, Result};

/// One line of JSON.
///
/// # Errors
/// [`Error::Data`] for what JSON does not express.
pub fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string(value).map_err(|cause| Error::Data(format!("cannot write JSON: {cause}")))
}

/// Refuses to overwrite a file unless `force`, and what is no file in any case. A link is there,
/// wherever it leads.
///
/// # Errors
/// [`Error::Input`].
pub fn may_write(path: &Path, force: bool) -> Result<()> {
    let Ok(about) = path.symlink_metadata() else {
        return Ok(());
    };
    let path = path.display();
    if !about.is_file() && !about.is_symlink() {
        return Err(Error::Input(format!(
            "{path} is a folder or a device, expected a file; name another one"
        )));
    }
    if !force {
        return Err(Error::Input(format!(
            "{path} exists already; give --force to overwrite it"
        )));
    }
    Ok(())
}

/// Refuses to overwrite a file that is read, whatever is forced.
///
/// - `fix`: what to do about it, `name another file`
///
/// # Errors
/// [`Error::Input`].
pub fn spare<P: AsRef<Path>>(
    path: &Path,
    read: impl IntoIterator<Item = P>,
    fix: &str,
) -> Result<()> {
    let mut read = read.into_iter();
    match read.find(|read| same_file(read.as_ref(), path)) {
        None => Ok(()),
        Some(read) => Err(Error::Input(format!(
            "{} is one of the files that are read, {}; {fix}",
            path.display(),
            read.as_ref().display()
        ))),
    }
}

/// Whether two names are of one file.
pub fn same_file(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let number = |path: &Path| path.metadata().ok().map(|about| (about.dev(), about.ino()));
        number(a).is_some() && number(a) == number(b)
    }
    #[cfg(not(unix))]
    {
        let place = |path: &Path| path.canonicalize().ok();
        place(a).is_some() && place(a) == place(b)
    }
}

/// Makes a folder and those above it, where they are not there.
///
/// # Errors
/// [`Error::Write`].
pub fn folder(path: &Path) -> Result<()> {
    create_dir_all(path).map_err(Error::write("create", path))
}

/// The file appears when it is whole: who finds it need not ask whether it is. What cannot be written
/// leaves nothing, and a link is replaced, not followed.
///
/// # Errors
/// [`Error::Write`].
pub fn whole(path: &Path, contents: &[u8]) -> Result<()> {
    persist(path, contents).map_err(Error::write("write", path))
}

/// The same as [`whole`] with the system's own error.
///
/// # Errors
/// That of the system.
pub fn persist(path: &Path, contents: &[u8]) -> io::Result<()> {
    let folder = path.parent().filter(|dir| !dir.as_os_str().is_empty());
    let mut options = tempfile::Builder::new();
    options.prefix(".mvtop-").suffix(".partial");
    #[cfg(unix)]
    options.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666)); // less the umask
    let mut file = options.tempfile_in(folder.unwrap_or(Path::new(".")))?;
    file.write_all(contents)?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_written_leaves_nothing_and_spares_what_is_there() {
        let dir = tempfile::tempdir().unwrap();
        let taken = dir.path().join("taken");
        std::fs::create_dir(&taken).unwrap();
        std::fs::write(dir.path().join("a.jsonl.partial"), "theirs").unwrap();
        let error = whole(&taken, b"text").unwrap_err().to_string();
        assert!(
            error.contains("cannot write") && error.contains("taken"),
            "{error}"
        );
        whole(&dir.path().join("a.jsonl"), b"text").unwrap();
        let mut names: Vec<_> = std::fs::read_dir(dir.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        names.sort();
        assert_eq!(names, ["a.jsonl", "a.jsonl.partial", "taken"]);
        let theirs = std::fs::read(dir.path().join("a.jsonl.partial")).unwrap();
        assert_eq!(theirs, b"theirs");
    }

    #[test]
    fn devices_and_folders_are_never_replaced() {
        let dir = tempfile::tempdir().unwrap();
        assert!(may_write(dir.path(), true).is_err());
        assert!(may_write(Path::new("/dev/null"), true).is_err() || cfg!(not(unix)));
    }
}
