//! Where an ONNX Runtime library may be.

use std::cmp::Reverse;
use std::env;
use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A library that may be loaded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Candidate {
    pub path: PathBuf,
    /// The place of the search that it came from.
    pub found_in: String,
    /// Whether it was asked for, so that no other may take its place.
    pub binding: bool,
}

/// What the search reads of the process it runs in.
pub(super) struct Surroundings {
    pub variable: fn(&str) -> Option<OsString>,
    pub executable: Option<PathBuf>,
    /// The interpreter that is asked for its packages.
    pub python: &'static str,
}

impl Surroundings {
    pub fn of_process() -> Self {
        Self {
            variable: |name| env::var_os(name),
            executable: env::current_exe().ok(),
            python: if cfg!(windows) { "python" } else { "python3" },
        }
    }
}

/// What the loader finds in the system's own folders.
const SYSTEM_LIBRARY: &str = if cfg!(windows) {
    "onnxruntime.dll"
} else if cfg!(target_os = "macos") {
    "libonnxruntime.dylib"
} else {
    "libonnxruntime.so.1"
};

/// Variables with folders in which the loader looks for a bare name.
const LOADER_FOLDERS: &[&str] = if cfg!(windows) {
    &["PATH"]
} else if cfg!(target_os = "macos") {
    &["DYLD_LIBRARY_PATH", "DYLD_FALLBACK_LIBRARY_PATH"]
} else {
    &["LD_LIBRARY_PATH"]
};

/// How long `python3` may take to start.
const PYTHON_TIMEOUT: Duration = Duration::from_secs(10);

/// The libraries to try, in order. Later places are not looked at until they are reached.
///
/// Only what was named or installed: the current folder is none of these, nor is any above it, as a
/// library is code, and who unpacks a data set does not mean to run it.
pub(super) fn candidates(
    explicit: Option<&Path>,
    around: Surroundings,
) -> Box<dyn Iterator<Item = Candidate>> {
    let variable = |name: &str| (around.variable)(name).filter(|value| !value.is_empty());
    let explicit = explicit.map(|path| (path.to_owned(), "the path given"));
    let named = explicit.or_else(|| Some((variable("ORT_DYLIB_PATH")?.into(), "ORT_DYLIB_PATH")));
    if let Some((path, found_in)) = named {
        return Box::new(std::iter::once(Candidate {
            // Made absolute because a bare name would be looked for in the system's folders.
            path: std::path::absolute(&path).unwrap_or(path),
            found_in: found_in.into(),
            binding: true,
        }));
    }

    type Search = Box<dyn FnOnce() -> Vec<PathBuf>>;
    let mut places: Vec<(String, Search)> = Vec::new();
    let executable = around.executable.as_deref();
    if let Some(dir) = executable.and_then(Path::parent).map(Path::to_owned) {
        let beside = dir.clone();
        let search = Box::new(move || libraries_in(&beside));
        places.push(("the executable's folder".into(), search));
        // Installed into an environment: its commands lie in this folder.
        let commands = ["bin", "Scripts"].iter().any(|name| dir.ends_with(name));
        if let Some(prefix) = dir.parent().filter(|_| commands).map(Path::to_owned) {
            let search = Box::new(move || libraries_of(&prefix));
            places.push(("the executable's environment".into(), search));
        }
    }
    for name in ["VIRTUAL_ENV", "CONDA_PREFIX"] {
        if let Some(prefix) = variable(name).map(PathBuf::from) {
            places.push((name.into(), Box::new(move || libraries_of(&prefix))));
        }
    }
    let of_package = move || {
        let package = package_of(around.python, PYTHON_TIMEOUT);
        package.map_or(Vec::new(), |package| libraries_in(&package.join("capi")))
    };
    places.push((around.python.into(), Box::new(of_package)));
    // The loader looks there first, and in the current folder for an entry that is empty or relative.
    let folders = LOADER_FOLDERS
        .iter()
        .filter_map(|name| (around.variable)(name));
    let mut folders = folders.flat_map(|folders| env::split_paths(&folders).collect::<Vec<_>>());
    if folders.all(|folder| folder.is_absolute()) {
        let search = Box::new(|| vec![SYSTEM_LIBRARY.into()]);
        places.push(("the system".into(), search));
    }
    Box::new(places.into_iter().flat_map(|(found_in, search)| {
        search().into_iter().map(move |path| Candidate {
            path,
            found_in: found_in.clone(),
            binding: false,
        })
    }))
}

/// The ONNX Runtime libraries in a folder. Wheels hold one with its version in the name and none
/// without.
fn libraries_in(dir: &Path) -> Vec<PathBuf> {
    let is_library = |name: &str| {
        name == "onnxruntime.dll"
            || name == "libonnxruntime.so"
            || name.starts_with("libonnxruntime.so.")
            || (name.ends_with(".dylib")
                && (name == "libonnxruntime.dylib" || name.starts_with("libonnxruntime.1")))
    };
    let name = |path: &PathBuf| path.file_name()?.to_str().map(is_library);
    let mut paths = sorted_entries(dir);
    paths.retain(|path| name(path) == Some(true));
    paths
}

/// The libraries of the `onnxruntime` package in a virtual or conda environment.
fn libraries_of(prefix: &Path) -> Vec<PathBuf> {
    let mut site_packages = vec![prefix.join("Lib/site-packages")]; // Windows
    let lib = sorted_entries(&prefix.join("lib"));
    site_packages.extend(lib.into_iter().map(|python| python.join("site-packages")));
    site_packages
        .iter()
        .flat_map(|dir| libraries_in(&dir.join("onnxruntime/capi")))
        .collect()
}

/// Sorted from last to first by the numbers in the names, so that the newest of several versions
/// comes first.
fn sorted_entries(dir: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir).into_iter().flatten();
    let mut paths: Vec<_> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    paths.sort_by_cached_key(|path| Reverse((numbers(path), path.clone())));
    paths
}

/// 3 and 12 of `python3.12`.
fn numbers(path: &Path) -> Vec<u64> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let digits = name.split(|c: char| !c.is_ascii_digit());
    digits.filter_map(|digits| digits.parse().ok()).collect()
}

/// The folder of the `onnxruntime` package of a Python interpreter, which is not imported.
fn package_of(python: &str, timeout: Duration) -> Option<PathBuf> {
    // Isolated (`-I`) and elsewhere, so that neither a variable nor the current folder says what it
    // runs. What the user has installed is looked at again: naming a folder runs nothing of it.
    const SCRIPT: &str = "import importlib.util as u, site, sys; \
                          sys.path.append(site.getusersitepackages()); \
                          print(u.find_spec('onnxruntime').submodule_search_locations[0])";
    let mut child = Command::new(python)
        .args(["-I", "-c", SCRIPT])
        .current_dir(std::path::absolute("/").ok()?)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let deadline = Instant::now() + timeout;
    let status = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status,
            Ok(None) if Instant::now() < deadline => std::thread::sleep(Duration::from_millis(10)),
            _ => {
                // Best effort: the child may have ended in between.
                let _ = child.kill();
                let _ = child.wait();
                return None;
            }
        }
    };
    let mut path = String::new();
    child.stdout.take()?.read_to_string(&mut path).ok()?;
    status.success().then(|| PathBuf::from(path.trim_end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nowhere() -> Surroundings {
        Surroundings {
            variable: |_| None,
            executable: None,
            python: "no-such-interpreter",
        }
    }

    fn wheel(prefix: &Path, python: &str, library: &str) -> PathBuf {
        let capi = prefix
            .join("lib")
            .join(python)
            .join("site-packages/onnxruntime/capi");
        std::fs::create_dir_all(&capi).unwrap();
        std::fs::write(capi.join(library), "").unwrap();
        std::fs::write(capi.join("libonnxruntime_providers_shared.so"), "").unwrap();
        capi.join(library)
    }

    fn paths(candidates: impl Iterator<Item = Candidate>) -> Vec<PathBuf> {
        candidates.map(|c| c.path).collect()
    }

    #[test]
    fn a_path_given_is_the_only_candidate() {
        let around = Surroundings {
            variable: |_| Some("/other".into()),
            ..nowhere()
        };
        let all: Vec<_> = candidates(Some(Path::new("/given.so")), around).collect();
        assert_eq!(all.len(), 1);
        assert_eq!(
            (all[0].path.as_path(), all[0].binding),
            (Path::new("/given.so"), true)
        );
    }

    #[test]
    fn the_variable_is_the_only_candidate_and_counts_only_when_it_is_not_empty() {
        let variable = |name: &str| (name == "ORT_DYLIB_PATH").then(|| "/named.so".into());
        let all: Vec<_> = candidates(
            None,
            Surroundings {
                variable,
                ..nowhere()
            },
        )
        .collect();
        assert_eq!(paths(all.into_iter()), [Path::new("/named.so")]);
        let empty = |name: &str| (name == "ORT_DYLIB_PATH").then(OsString::new);
        let all: Vec<_> = candidates(
            None,
            Surroundings {
                variable: empty,
                ..nowhere()
            },
        )
        .collect();
        assert_eq!(paths(all.into_iter()), [Path::new(SYSTEM_LIBRARY)]);
    }

    #[cfg(all(unix, not(target_os = "macos")))]
    #[test]
    fn the_loader_is_not_asked_where_it_looks_in_the_current_folder() {
        let of = |variable| {
            let around = Surroundings {
                variable,
                ..nowhere()
            };
            paths(candidates(None, around)).len()
        };
        assert_eq!(
            of(|name| (name == "LD_LIBRARY_PATH").then(|| "/a:/b".into())),
            1
        );
        assert_eq!(
            of(|name| (name == "LD_LIBRARY_PATH").then(|| ":/b".into())),
            0
        );
        assert_eq!(
            of(|name| (name == "LD_LIBRARY_PATH").then(|| "/a:lib".into())),
            0
        );
    }

    #[test]
    fn the_executable_s_folder_comes_before_its_environment() {
        let root = tempfile::tempdir().unwrap();
        let bin = root.path().join("bin");
        std::fs::create_dir_all(&bin).unwrap();
        let installed = wheel(root.path(), "python3.12", "libonnxruntime.so.1.31.1");
        let beside = bin.join("libonnxruntime.so");
        std::fs::write(&beside, "").unwrap();
        let around = Surroundings {
            executable: Some(bin.join("mvtop-cli")),
            ..nowhere()
        };
        let all = paths(candidates(None, around));
        assert_eq!(all, [beside, installed, SYSTEM_LIBRARY.into()]);
    }

    #[test]
    fn versions_are_compared_as_numbers() {
        let root = tempfile::tempdir().unwrap();
        let wheels = [
            ("python3.9", "libonnxruntime.so.1.31.1"),
            ("python3.12", "libonnxruntime.so.1.9.0"),
            ("python3.12", "libonnxruntime.so.1.20.1"),
        ];
        let installed = wheels.map(|(python, library)| wheel(root.path(), python, library));
        let newest_first: Vec<_> = installed.into_iter().rev().collect();
        assert_eq!(libraries_of(root.path()), newest_first);
    }

    #[cfg(unix)]
    #[test]
    fn an_interpreter_that_hangs_is_given_up() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let script = dir.path().join("python");
        std::fs::write(&script, "#!/bin/sh\nexec sleep 60\n").unwrap();
        std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
        let start = Instant::now();
        assert_eq!(
            package_of(script.to_str().unwrap(), Duration::from_millis(200)),
            None
        );
        assert!(start.elapsed() < Duration::from_secs(20));
    }

    #[cfg(unix)]
    #[test]
    fn the_interpreter_is_started_isolated_and_elsewhere() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let script = dir.path().join("python");
        std::fs::write(&script, "#!/bin/sh\necho \"$(pwd) $1\"\n").unwrap();
        std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
        let said = package_of(script.to_str().unwrap(), Duration::from_secs(20));
        assert_eq!(said.unwrap(), Path::new("/ -I"));
    }

    #[cfg(unix)]
    #[test]
    fn the_interpreter_names_the_folder_of_the_package() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let script = dir.path().join("python");
        std::fs::write(&script, "#!/bin/sh\necho /packages/onnxruntime\n").unwrap();
        std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
        let package = package_of(script.to_str().unwrap(), Duration::from_secs(20));
        assert_eq!(package.unwrap(), Path::new("/packages/onnxruntime"));
    }
}
