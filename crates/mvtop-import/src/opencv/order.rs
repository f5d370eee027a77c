//! Which of two cameras or two sides comes first.

use crate::unread::plain;

/// Whether rows come before columns in a size of that name; `None` where programs differ.
pub fn rows_first(key: &str) -> Option<bool> {
    match plain(key).as_str() {
        shape if shape.contains("shape") || shape.ends_with("hw") => Some(true),
        // MATLAB's `ImageSize` is rows and columns, others' is not.
        _ if key == "ImageSize" => None,
        _ => Some(false),
    }
}

/// What a key consists of, in lower case; numbers compare by what they count, so `cam9` comes before `cam10`.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    Number(u64),
    Text(String),
}

pub fn in_parts(key: &str) -> Vec<Part> {
    let letters: Vec<char> = key.to_lowercase().chars().collect();
    let runs = letters.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit());
    let texts = runs.map(String::from_iter);
    texts
        .map(|text| text.parse().map_or(Part::Text(text), Part::Number))
        .collect()
}

/// Whether names say that one camera comes before another: by their numbers, or as left and right.
pub fn is_in_order(first: &str, second: &str) -> bool {
    let (a, b) = (in_parts(first), in_parts(second));
    let mut differ = a.iter().zip(&b).filter(|(a, b)| a != b);
    let numbered = match (differ.next(), differ.next()) {
        (Some((Part::Number(a), Part::Number(b))), None) => a < b,
        _ => false,
    };
    let (first, second) = (first.to_lowercase(), second.to_lowercase());
    let rest = first.strip_suffix('l');
    (a.len() == b.len() && numbered)
        || (first.contains("left") && second.contains("right"))
        || rest.is_some_and(|rest| second.strip_suffix('r') == Some(rest))
}
