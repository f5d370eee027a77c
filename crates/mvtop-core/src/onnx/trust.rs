//! Whether a library is as safe to load as the program itself: who else could have written it.

use std::path::Path;

/// Refuses a library that any user of the machine may write to or may have put there: by the file's
/// rights, or by those of a folder on the way to it, links included. Nothing is known of a bare
/// name, which the loader looks for in the system's own folders.
#[cfg(unix)]
pub(super) fn check(path: &Path) -> Result<(), String> {
    if !path.is_absolute() {
        return Ok(());
    }
    // What is not there is the loader's to refuse, with its reason.
    let Ok(target) = path.canonicalize() else {
        return Ok(());
    };
    let own = rustix::process::geteuid().as_raw();
    let mut places = path.ancestors().chain(target.ancestors());
    match places.find(|place| open_to_others(place, own)) {
        None => Ok(()),
        Some(place) => Err(format!(
            "is not loaded as other users may change {}, take that right from them (`chmod o-w`) or \
             install ONNX Runtime in a folder of your own",
            place.display()
        )),
    }
}

/// Whether others may write a file or folder, or may have made it in a folder for all, as `/tmp`.
#[cfg(unix)]
fn open_to_others(place: &Path, own: u32) -> bool {
    use std::os::unix::fs::MetadataExt;
    const OTHERS_WRITE: u32 = 0o002;
    const STICKY: u32 = 0o1000;
    let Ok(about) = place.metadata() else {
        return false;
    };
    let for_all = |about: &std::fs::Metadata| about.mode() & OTHERS_WRITE != 0;
    // What lies in a sticky folder can be replaced by its owner alone.
    if for_all(&about) && !(about.is_dir() && about.mode() & STICKY != 0) {
        return true;
    }
    let folder = place.parent().and_then(|folder| folder.metadata().ok());
    let made_by = place
        .symlink_metadata()
        .map_or(about.uid(), |link| link.uid());
    folder.is_some_and(|folder| for_all(&folder)) && made_by != own && made_by != 0
}

/// Elsewhere rights are no bits of a file.
#[cfg(not(unix))]
pub(super) fn check(_: &Path) -> Result<(), String> {
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs::{Permissions, create_dir, set_permissions, write};
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    #[test]
    fn library_that_others_may_change_is_refused() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("lib");
        create_dir(&folder).unwrap();
        let library = folder.join("libonnxruntime.so");
        write(&library, "").unwrap();
        let mode = |path: &Path, mode| set_permissions(path, Permissions::from_mode(mode)).unwrap();
        let link = root.path().join("link.so");
        symlink(&library, &link).unwrap();
        for (folder_mode, file_mode, safe) in [
            (0o755, 0o644, true),
            (0o775, 0o664, true),
            (0o1777, 0o644, true), // made by this user
            (0o777, 0o644, false),
            (0o755, 0o666, false),
        ] {
            mode(&folder, folder_mode);
            mode(&library, file_mode);
            for path in [&library, &link] {
                let checked = check(path);
                assert_eq!(
                    checked.is_ok(),
                    safe,
                    "{folder_mode:o} {file_mode:o}: {checked:?}"
                );
                if let Err(problem) = checked {
                    assert!(problem.contains("other users may change"), "{problem}");
                }
            }
        }
        // Of another user, in a folder for all.
        mode(&folder, 0o1777);
        mode(&library, 0o644);
        let someone_else = rustix::process::geteuid().as_raw() + 1;
        let root_made_it = rustix::process::geteuid().is_root();
        assert_eq!(open_to_others(&library, someone_else), !root_made_it);
    }

    #[test]
    fn missing_library_and_bare_name_are_left_to_the_loader() {
        assert_eq!(check(Path::new("/no/such/libonnxruntime.so")), Ok(()));
        assert_eq!(check(Path::new("libonnxruntime.so.1")), Ok(()));
    }
}
