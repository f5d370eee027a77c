//! Whether a library is as safe to load as the program itself: who else could have written it.

#[cfg(unix)]
use std::fs::Metadata;
#[cfg(unix)]
use std::os::unix::fs::MetadataExt;
#[cfg(unix)]
use std::path::{Path, PathBuf};

use super::locate::Candidate;

/// More folders than any path to a library has.
#[cfg(unix)]
const MOST_DEEP: usize = 64;

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
    if path.canonicalize().is_err() {
        return Ok(());
    }
    let own = rustix::process::geteuid().as_raw();
    let places = places(path);
    if let Some(place) = places.iter().find(|place| open_to_others(place, own)) {
        return Err(format!(
            "is not loaded as other users may change {}, take that right from them (`chmod go-w`) or \
             install ONNX Runtime in a folder of your own",
            place.display()
        ));
    }
    let foreign = |place: &&PathBuf| {
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

/// A path, those that its links lead to, and all folders around these.
#[cfg(unix)]
fn places(path: &Path) -> Vec<PathBuf> {
    let mut places = Vec::new();
    let mut next = Some(path.to_owned());
    while let Some(path) = next.take() {
        let from_root: Vec<PathBuf> = path.ancestors().map(Path::to_owned).collect();
        let link = from_root.iter().rev().find_map(|place| {
            let target = place.read_link().ok()?;
            let rest = path.strip_prefix(place).ok()?;
            Some(place.parent()?.join(target).join(rest))
        });
        places.extend(from_root);
        // As many as Linux follows.
        next = link.filter(|_| places.len() < 40 * MOST_DEEP);
    }
    places
}

/// Whether a file belongs neither to this user nor to the system.
#[cfg(unix)]
fn is_foreign(about: &Metadata, own: u32) -> bool {
    ![own, 0].contains(&about.uid())
}

/// Whether others may write a file or folder, or may have made it in a folder for all, as `/tmp`. Of groups,
/// those of this user and of the system are none of the others.
#[cfg(unix)]
fn open_to_others(place: &Path, own: u32) -> bool {
    const OTHERS_WRITE: u32 = 0o002;
    const GROUP_WRITES: u32 = 0o020;
    const STICKY: u32 = 0o1000;
    let Ok(about) = place.metadata() else {
        return false;
    };
    let for_all = |about: &Metadata| {
        about.mode() & OTHERS_WRITE != 0
            || (about.mode() & GROUP_WRITES != 0 && is_of_other_people(about.gid()))
    };
    // What lies in a sticky folder can be replaced by its owner alone.
    if for_all(&about) && !(about.is_dir() && about.mode() & STICKY != 0) {
        return true;
    }
    let folder = place.parent().and_then(|folder| folder.metadata().ok());
    let made = place.symlink_metadata().unwrap_or(about);
    folder.is_some_and(|folder| for_all(&folder)) && is_foreign(&made, own)
}

/// Whether a group has people in it, and this user is none of them.
#[cfg(unix)]
fn is_of_other_people(group: u32) -> bool {
    const FIRST_OF_PEOPLE: u32 = if cfg!(target_os = "macos") { 500 } else { 1000 };
    let effective = rustix::process::getegid();
    let mut own = rustix::process::getgroups().unwrap_or_default();
    own.push(effective);
    group >= FIRST_OF_PEOPLE && !own.iter().any(|own| own.as_raw() == group)
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
    fn links_on_the_way_are_checked_as_well() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        for folder in ["mine", "shared", "lib"] {
            create_dir(at(folder)).unwrap();
        }
        write(at("lib/libonnxruntime.so"), "").unwrap();
        symlink(at("lib/libonnxruntime.so"), at("shared/current.so")).unwrap();
        symlink("../shared/current.so", at("mine/lib.so")).unwrap();
        let library = at("mine/lib.so");
        assert_eq!(check(&found(&library)), Ok(()));
        set_permissions(at("shared"), Permissions::from_mode(0o777)).unwrap();
        let problem = check(&found(&library)).unwrap_err();
        assert!(problem.contains("other users may change"), "{problem}");
        // Links in a circle lead nowhere.
        symlink(at("mine/b"), at("mine/a")).unwrap();
        symlink(at("mine/a"), at("mine/b")).unwrap();
        assert_eq!(check(&found(&at("mine/a"))), Ok(()));
    }

    #[test]
    fn a_group_of_other_people_may_not_write_it() {
        let root = tempfile::tempdir().unwrap();
        let library = root.path().join("libonnxruntime.so");
        write(&library, "").unwrap();
        set_permissions(&library, Permissions::from_mode(0o664)).unwrap();
        for (group, safe) in [(50, true), (54_321, false)] {
            // Only the system's own user may give files away.
            if chown(&library, None, Some(group)).is_err() {
                return;
            }
            assert_eq!(check(&found(&library)).is_ok(), safe, "{group}");
        }
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
