//! Keys that look like a part of a lens and that a format's reader does not know.

use crate::Checked;
use crate::node::Node;
use crate::opencv::keys::{About, about};

/// Refuses an object with a key that looks like a part of a lens: what is left out would change the camera.
///
/// - `known`: keys that were read, or that are known to be none of it
pub fn refuse(node: &Node, known: &[&str]) -> Checked<()> {
    for (key, inner) in node.entries() {
        if !known.contains(&key) && about(key, inner.value) == Some(About::Lens) {
            return Err(format!(
                "{}: the key `{key}` looks like a part of its lens and is not known; give it by a name that \
                 docs/how-to/import-a-calibration.md lists, or leave it out if it is none",
                node.place
            ));
        }
    }
    Ok(())
}
