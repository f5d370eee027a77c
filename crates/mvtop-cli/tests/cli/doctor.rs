//! `doctor`.

use crate::{mvtop, refusal, stdout};

#[test]
fn doctor_says_what_was_found_or_what_to_do() {
    let text = stdout(&mvtop(&["doctor"]));
    for found in ["ONNX Runtime", "providers   cpu", "mvball", "all well"] {
        assert!(text.contains(found), "{found} is missing in:\n{text}");
    }
    let output = mvtop(&["doctor", "--ort-lib", "none.so"]);
    assert!(refusal(&output).contains("none.so"));
    assert!(String::from_utf8_lossy(&output.stdout).contains("checksums  match"));
    let error = refusal(&mvtop(&["doctor", "--model", "none"]));
    assert!(error.contains("none"), "{error}");
}
