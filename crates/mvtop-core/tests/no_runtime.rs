//! What happens without a usable ONNX Runtime. A binary of its own, because a process that has
//! loaded the library once keeps it.

use mvtop_core::Error;
use mvtop_core::onnx::Runtime;
use std::path::Path;

fn problem(path: &Path) -> String {
    match Runtime::locate(Some(path)) {
        Err(Error::Runtime {
            path: named,
            problem,
        }) => {
            assert_eq!(named, path);
            problem
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_missing_file_is_an_error_with_the_loader_s_reason() {
    let problem = problem(Path::new("/no/such/libonnxruntime.so"));
    assert!(problem.starts_with("cannot be loaded"), "{problem}");
    assert!(
        cfg!(not(target_os = "linux")) || problem.contains("No such file"),
        "{problem}"
    );
}

#[test]
fn a_file_that_is_no_library_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("libonnxruntime.so");
    std::fs::write(&path, "not a library").unwrap();
    let problem = problem(&path);
    assert!(problem.starts_with("cannot be loaded"), "{problem}");
}

/// Compiles a shared library from C, for versions of ONNX Runtime that are not at hand.
#[cfg(target_os = "linux")]
fn compile(dir: &Path, source: &str) -> std::path::PathBuf {
    let (c, library) = (dir.join("fake.c"), dir.join("libonnxruntime.so"));
    std::fs::write(&c, source).unwrap();
    let status = std::process::Command::new("cc")
        .args(["-shared", "-fPIC", "-o"])
        .args([&library, &c])
        .status()
        .expect("a C compiler, which Rust needs for linking anyway");
    assert!(status.success());
    library
}

#[cfg(target_os = "linux")]
#[test]
fn another_library_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let problem = problem(&compile(dir.path(), "int answer(void) { return 42; }"));
    assert_eq!(problem, "is not an ONNX Runtime library");
}

#[cfg(target_os = "linux")]
#[test]
fn a_library_that_is_too_old_is_an_error_with_both_versions_and_the_fix() {
    let dir = tempfile::tempdir().unwrap();
    let source = r#"
        static const void *api(unsigned version) { (void)version; return 0; }
        static const char *version(void) { return "1.19.2"; }
        static const struct { const void *(*a)(unsigned); const char *(*v)(void); } base = {api, version};
        const void *OrtGetApiBase(void) { return &base; }
    "#;
    let problem = problem(&compile(dir.path(), source));
    for part in ["1.19.2", "1.20 or newer", "pip install -U"] {
        assert!(problem.contains(part), "{problem}");
    }
}
