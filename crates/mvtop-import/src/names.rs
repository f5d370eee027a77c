//! Names of files, sections and cameras: which of them are of one camera.

use crate::Checked;
use crate::unread::words;

/// Words of a name for a part of a calibration, beside the camera's own.
const PARTS: &[&str] = &[
    "cam",
    "camera",
    "intrinsic",
    "intrinsics",
    "intr",
    "intri",
    "int",
    "extrinsic",
    "extrinsics",
    "extr",
    "extri",
    "ext",
    "distortion",
    "dist",
    "lens",
    "pose",
    "poses",
    "calib",
    "calibration",
    "param",
    "params",
    "parameters",
    "info",
];

/// The words of a name that are the camera's own.
pub fn own_words(name: &str) -> Vec<String> {
    let mut own = words(name);
    own.retain(|word| !PARTS.contains(&word.as_str()));
    own
}

/// Which side or number a name says, in words that others may compare.
fn sides(words: &[String]) -> impl Iterator<Item = &String> {
    words.iter().filter(|word| {
        ["left", "right"].contains(&word.as_str()) || word.chars().all(|c| c.is_ascii_digit())
    })
}

/// Of each name the one of `cameras` that it is of, by the words that only one of these has; `None` where the names do
/// not say it.
///
/// # Errors
/// Where some say it and others do not, or two say the same.
pub fn matched(names: &[String], cameras: &[String]) -> Checked<Option<Vec<usize>>> {
    let all: Vec<Vec<String>> = cameras.iter().map(|name| own_words(name)).collect();
    let only = |word: &String| {
        let mut has = (0..all.len()).filter(|&index| all[index].contains(word));
        has.next().filter(|_| has.next().is_none())
    };
    let mut found = Vec::new();
    for name in names {
        let own = own_words(name);
        let mut hits: Vec<usize> = own.iter().filter_map(only).collect();
        hits.sort_unstable();
        hits.dedup();
        let other_side = hits.is_empty()
            && sides(&own).next().is_some()
            && all.iter().any(|words| sides(words).next().is_some());
        found.push(match hits[..] {
            [index] => Some(index),
            [] if !other_side => None,
            _ => return Err(unmatched(names, cameras)),
        });
    }
    if found.iter().all(Option::is_none) {
        return Ok(None);
    }
    let all_found: Option<Vec<usize>> = found.into_iter().collect();
    let once = |found: &Vec<usize>| (1..found.len()).all(|i| !found[..i].contains(&found[i]));
    all_found
        .filter(once)
        .map(Some)
        .ok_or_else(|| unmatched(names, cameras))
}

fn unmatched(names: &[String], cameras: &[String]) -> String {
    format!(
        "expected names that say which is of which camera, or none that do, got {} for {}; give each the name of its \
         camera",
        names.join(", "),
        cameras.join(", ")
    )
}
