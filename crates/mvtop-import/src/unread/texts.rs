//! Texts and flags: what is not known may state a lens, a place or a size as a number does.

use serde_json::Value;

use super::said::*;
use super::words::{HARMLESS_KEYS, SIZES};
use super::{Key, has, is_harmless_of, is_numbers, is_stating, plain, runs, words};
use crate::lens::Lens;
use crate::opencv::keys::{direction, is_yes, size_of_text};
use crate::options::Unit;

/// What a value says that is on or off; a number says neither.
pub fn flag(value: &Value) -> Option<bool> {
    is_yes(value).filter(|_| !value.is_number())
}

/// Whether a flag states something: a choice between conventions does both on and off, any other one where it is on.
pub fn flag_states(key: &Key, on: bool, value: &Value) -> bool {
    let words = key.words();
    if has(&words, CHOICES) || names_a_direction(&words) {
        return true;
    }
    let harmless =
        !has(&words, IMAGES) && (is_harmless_of(key, value) || has_harmless(key, &words, &[FLAGS]));
    on && !harmless
}

/// Whether a 0 chooses between conventions, as a flag that is off.
pub fn zero_chooses(key: &Key) -> bool {
    let words = key.words();
    has(&words, &["handed", "major", "based"]) || names_a_direction(&words)
}

/// Whether a text states something: one of a harmless key by what it says, any other one if it is not plain.
pub fn text_states(key: &Key, text: &str, value: &Value) -> bool {
    if text.trim().is_empty() {
        return false;
    }
    let words = key.words();
    if has(&words, CONVENTIONS) {
        return true;
    }
    let harmless = !has(&words, IMAGES)
        && (is_harmless_of(key, value) || has_harmless(key, &words, &[PROSE, TEXTS]));
    match harmless {
        true => says(text, [PROSE, FREE].iter().any(|list| has(&words, list))),
        false => !is_plain(key, &words, text),
    }
}

/// Whether texts in a list are coefficients in an order.
pub fn lists_coefficients(list: &[Value]) -> bool {
    let texts: Option<Vec<&str>> = list.iter().map(Value::as_str).collect();
    texts.is_some_and(|texts| is_order(&texts.join(" ")))
}

/// Whether words are of one of the lists, and none of a lens, a place or a size.
fn has_harmless(key: &Key, words: &[String], lists: &[&[&str]]) -> bool {
    let own = HARMLESS_KEYS.contains(&plain(&key.own).as_str());
    (own || lists.iter().any(|list| has(words, list)))
        && !is_stating(words, &[])
        && [SIZES, LENSES, RELATIVE]
            .iter()
            .all(|list| !has(words, list))
}

/// Whether text says a direction, axes, a unit, a size, an order of coefficients or a lens.
///
/// - `whole`: the text as a whole; else any of its words
fn says(text: &str, whole: bool) -> bool {
    let all = plain(text);
    let listed = |word: &str| {
        direction(word).is_some()
            || [AXES, LENS_NAMES, IMAGES]
                .iter()
                .any(|list| list.contains(&word))
    };
    let words = words(text);
    listed(&all)
        || UNITS.contains(&all.as_str())
        || Unit::of_file(text.trim()).is_some()
        || size_of_text(text).is_some()
        || is_order(text)
        || (!whole
            && (runs(&words).any(|run| listed(&run))
                || text
                    .split_whitespace()
                    .any(|word| size_of_text(word).is_some())))
}

/// Whether words, up to three in a row, are a direction: `camera_to_world` and `c2w`.
fn names_a_direction(words: &[String]) -> bool {
    runs(words).any(|run| direction(&run).is_some())
}

/// Whether text lists radial and tangential coefficients.
fn is_order(text: &str) -> bool {
    let all = plain(text);
    all.contains("k1") && all.contains("k2") && ["p1", "t1"].iter().any(|p| all.contains(p))
}

/// Whether text is the plain default of what its key is about, a date, a version or a file.
fn is_plain(key: &Key, words: &[String], text: &str) -> bool {
    let (said, own) = (plain(text), plain(&key.own));
    if has(words, &["unit"]) {
        return PLAIN_UNITS.contains(&said.as_str());
    }
    let is_type = TYPES.contains(&own.as_str());
    let of_lens = is_type || has(words, LENSES) || has(words, &["lens", "distortion", "camera"]);
    let length = said
        .strip_suffix("mm")
        .is_some_and(|mm| mm.parse::<u32>().is_ok());
    PLAIN.contains(&said.as_str())
        || (is_type && CAMERAS.contains(&said.as_str()))
        || (of_lens && (length || is_pinhole(text)))
        || is_date_or_version(text)
        || is_file(text)
}

fn is_pinhole(text: &str) -> bool {
    Lens::named(text, &[0.0; 4]).is_ok_and(|lens| !lens.is_fisheye())
}

/// Whether text is numbers between dots, dashes and colons: `2024-05-01 12:30`, `v1.4.2`.
fn is_date_or_version(text: &str) -> bool {
    let text = text.trim().trim_start_matches(['v', 'V']);
    let parts: Vec<&str> = text.split(|c: char| ".-:/ TZ+_".contains(c)).collect();
    let full = parts.iter().filter(|part| !part.is_empty());
    let numbers = full
        .clone()
        .all(|part| part.chars().all(|c| c.is_ascii_digit()));
    is_numbers(text).is_none() && numbers && full.count() >= 3
}

/// Whether text is the path of a file or folder, or an address.
fn is_file(text: &str) -> bool {
    let ending = text
        .rsplit_once('.')
        .map(|(_, ending)| ending.to_lowercase());
    ["/", "./", "../", "~/"]
        .iter()
        .any(|start| text.starts_with(start))
        || text.contains("://")
        || text.contains(":\\")
        || ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}
