//! R and T of a pair of cameras, whichever file or section they are in.

use super::found::{Fields, PLACE, Part, is_placed};
use crate::Checked;
use crate::unread::{plain, words};

/// R and T from the first to the second of two cameras.
pub struct Pair {
    pub name: String,
    pub fields: Fields,
}

/// Fields of a place, and the others.
pub fn of_place(fields: Fields) -> (Fields, Fields) {
    let all = fields.into_iter();
    all.partition(|(key, _)| PLACE.contains(&key.as_str()))
}

/// Whether it is R and T of two cameras, and not of a camera that is not there.
///
/// # Errors
/// Where its name puts the second camera first.
pub fn is_pair(part: &Part, cameras: &[(String, Fields)]) -> Checked<bool> {
    let ids: Vec<&str> = cameras.iter().map(|(id, _)| id.as_str()).collect();
    let both = ids
        .iter()
        .map(|id| plain(id))
        .collect::<Vec<_>>()
        .join("to");
    let of_pair = |word: &String| ["stereo", "pair", "relative"].contains(&word.as_str());
    let is_pair = is_placed(|key| part.fields.get(key))
        && part.fields.contains_key("T")
        && (part.whole || plain(&part.name) == both || words(&part.name).iter().any(of_pair));
    match ids[..] {
        [first, second] if is_pair && is_backward(&part.name, first, second) => Err(format!(
            "R and T of `{}` are from the second camera to the first by their name, and R and T of a pair are read as \
             those from `{first}` to `{second}`; give the inverse, under a name that says so",
            part.name
        )),
        _ => Ok(is_pair),
    }
}

/// Whether a name has both cameras, or sides, the second one first.
fn is_backward(name: &str, first: &str, second: &str) -> bool {
    let (own, first, second) = (plain(name), plain(first), plain(second));
    if own.contains(&format!("{first}to{second}")) {
        return false;
    }
    if own.contains(&format!("{second}to{first}")) {
        return true;
    }
    let sides = [
        (first.as_str(), second.as_str()),
        ("left", "right"),
        ("first", "second"),
    ];
    // Cameras in the order of right and left turn that of the sides around.
    let turned = first.contains("right") && second.contains("left");
    sides.iter().enumerate().any(|(index, (a, b))| {
        let backward = own.find(b).zip(own.find(a)).map(|(b, a)| b < a);
        backward.is_some_and(|backward| backward != (index == 1 && turned))
    })
}
