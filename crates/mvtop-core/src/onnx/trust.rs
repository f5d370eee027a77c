//! Whether a library is as safe to load as the program itself: who else could have written it.

#[cfg(unix)]
use std::fs::Metadata;
#[cfg(unix)]
use std::os::unix::fs::MetadataExt;
#[cfg(unix)]
use std::path::Path;

use super::locate::Candidate;

/// Refuses a library of the current folder, and one that others may write to or have put there: by
/// the rights and the owner of the file and of each folder on the way to it, links included.
///
/// Who names a library trusts its owner; one that was found must belong to this user or to the
/// system. Nothing is known of a bare name, which the loader looks for in the system's own folders.
#[cfg(unix)]
pub(super) fn check(library: &Candidate) -> Result<(), String> {
    let path = library.path.as_path();
    if path.components().count() == 1 {
        return Ok(());
    }
    if !path.is_absolute() {
        return Err(
            "is not loaded as its path depends on the current folder, name it from the root in \
             ORT_DYLIB_PATH"
                .into(),
        );
    }
    // What is not there is the loader's to refuse, with its reason.
    let Ok(target) = path.canonicalize() else {
        return Ok(());
    };
    let own = rustix::process::geteuid().as_raw();
    let places: Vec<&Path> = path.ancestors().chain(target.ancestors()).collect();
    if let Some(place) = places.iter().find(|place| open_to_others(place, own)) {
        return Err(format!(
            "is not loaded as other users may change {}, take that right from them (`chmod o-w`) or \
             install ONNX Runtime in a folder of your own",
            place.display()
        ));
    }
    let foreign = |place: &&&Path| {
        place
            .symlink_metadata()
            .is_ok_and(|about| is_foreign(&about, own))
    };
    match places.iter().find(foreign).filter(|_| !library.binding) {
        None => Ok(()),
        Some(place) => Err(format!(
            "is not loaded as {} belongs to another user, name it in ORT_DYLIB_PATH if you trust them",
            place.display()
        )),
    }
}

/// Whether a file belongs neither to this user nor to the system.
#[cfg(unix)]
fn is_foreign(about: &Metadata, own: u32) -> bool {
    ![own, 0].contains(&about.uid())
}

/// Whether others may write a file or folder, or may have made it in a folder for all, as `/tmp`.
#[cfg(unix)]
fn open_to_others(place: &Path, own: u32) -> bool {
    const OTHERS_WRITE: u32 = 0o002;
    const STICKY: u32 = 0o1000;
    let Ok(about) = place.metadata() else {
        return false;
    };
    let for_all = |about: &Metadata| about.mode() & OTHERS_WRITE != 0;
    // What lies in a sticky folder can be replaced by its owner alone.
    if for_all(&about) && !(about.is_dir() && about.mode() & STICKY != 0) {
        return true;
    }
    let folder = place.parent().and_then(|folder| folder.metadata().ok());
    let made = place.symlink_metadata().unwrap_or(about);
    folder.is_some_and(|folder| for_all(&folder)) && is_foreign(&made, own)
}

/// Elsewhere rights are no bits of a file.
#[cfg(not(unix))]
pub(super) fn check(_: &Candidate) -> Result<(), String> {
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs::{Permissions, create_dir, set_permissions, write};
    use std::os::unix::fs::{PermissionsExt, chown, symlink};

    use super::*;

    fn found(path: &Path) -> Candidate {
        Candidate {
            path: path.to_owned(),
            found_in: "VIRTUAL_ENV".into(),
            binding: false,
        }
    }

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
                let checked = check(&found(path));
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
        for path in ["/no/such/libonnxruntime.so", "libonnxruntime.so.1"] {
            assert_eq!(check(&found(Path::new(path))), Ok(()));
        }
    }

    #[test]
    fn library_of_the_current_folder_is_refused() {
        for path in ["venv/lib/libonnxruntime.so", "./libonnxruntime.so"] {
            let problem = check(&found(Path::new(path))).unwrap_err();
            assert!(
                problem.contains("depends on the current folder"),
                "{problem}"
            );
        }
    }

    #[test]
    fn library_of_another_user_is_loaded_only_where_it_is_named() {
        let root = tempfile::tempdir().unwrap();
        let library = root.path().join("libonnxruntime.so");
        write(&library, "").unwrap();
        // Only the system's own user may give files away.
        if chown(
            &library,
            Some(rustix::process::geteuid().as_raw() + 1),
            None,
        )
        .is_err()
        {
            return;
        }
        let candidate = found(&library);
        let problem = check(&candidate).unwrap_err();
        assert!(problem.contains("belongs to another user"), "{problem}");
        let binding = true;
        assert_eq!(
            check(&Candidate {
                binding,
                ..candidate
            }),
            Ok(())
        );
    }
}
