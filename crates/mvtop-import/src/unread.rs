//! What a file states and no reader has read: nothing of it may be left out unseen, as it may be a part of a
//! lens, a place or a size.

mod said;
mod texts;
mod words;

use serde_json::{Map, Value};

use crate::lens::Lens;
use crate::node::{Node, count_of_numbers};
use crate::{Checked, Options};

use self::said::LENSES;
use self::words::*;

/// A key, and the path to it from the object that was asked about.
struct Key {
    own: String,
    path: String,
    /// Words of the keys around it.
    around: Vec<String>,
}

impl Key {
    fn of(key: &str) -> Self {
        Self {
            own: key.to_owned(),
            path: key.to_owned(),
            around: Vec::new(),
        }
    }

    /// Of an entry of the object at this key.
    fn entry(&self, key: &str) -> Self {
        Self {
            own: key.to_owned(),
            path: format!("{}_{key}", self.path),
            around: self.words(),
        }
    }

    fn words(&self) -> Vec<String> {
        words(&self.path)
    }
}

/// Refuses an object with something that was not read.
///
/// - `known`: keys that were read
pub fn refuse(node: &Node, known: &[&str], options: &Options) -> Checked<()> {
    let entries = node.entries();
    let rest = entries.iter().filter(|(key, _)| !known.contains(key));
    let unread = rest.filter(|(key, inner)| matters(key, inner.value));
    refuse_all(unread.map(|(key, _)| (*key).to_owned()), options)
        .map_err(|problem| format!("{}: {problem}", node.place))
}

/// Refuses these keys, each with the name of its camera before it where it has one.
pub fn refuse_all(unread: impl Iterator<Item = String>, options: &Options) -> Checked<()> {
    match unread
        .filter(|path| !options.ignores(path))
        .collect::<Vec<_>>()
    {
        unread if unread.is_empty() => Ok(()),
        unread => Err(sentence(&unread)),
    }
}

fn sentence(paths: &[String]) -> String {
    let mut keys: Vec<&str> = Vec::new();
    for path in paths {
        let key = path.rsplit(": ").next().unwrap_or(path);
        if keys.len() <= MOST_NAMED && !keys.contains(&key) {
            keys.push(key);
        }
    }
    let others = keys.len() > MOST_NAMED;
    keys.truncate(MOST_NAMED);
    let joined = |each: &dyn Fn(&&str) -> String, between: &str| {
        keys.iter().map(each).collect::<Vec<_>>().join(between)
    };
    let (noun, are, it) = match keys.len() {
        1 => ("the key", "is", "it"),
        _ => ("the keys", "are", "them"),
    };
    format!(
        "{noun} {}{} {are} not known and may state a lens, a place or a size; give {it} by a name that \
         docs/how-to/import-a-calibration.md lists, or, if there is none of these in {it}, `ignore` ({})",
        joined(&|key| format!("`{key}`"), ", "),
        if others { " and others" } else { "" },
        joined(&|key| format!("--ignore {key}"), " ")
    )
}

/// Whether a key is not harmless and its value states something.
pub fn matters(key: &str, value: &Value) -> bool {
    matters_at(&Key::of(key), value)
}

/// The same; what is inside an object is harmless by its own key and by none around it.
fn matters_at(key: &Key, value: &Value) -> bool {
    match value {
        Value::Object(map) if is_header(&key.own, map) => false,
        Value::Object(map) if !map.contains_key("data") => map
            .iter()
            .any(|(inner, value)| matters_at(&key.entry(inner), value)),
        Value::Array(list) if list.iter().any(Value::is_object) => {
            list.iter().any(|value| matters_at(key, value))
        }
        Value::Array(list) if texts::lists_coefficients(list) => true,
        value => {
            let zero = value.as_f64() == Some(0.0) && texts::zero_chooses(key);
            zero || states(key, value, is_harmless_of(key, value))
        }
    }
}

/// Whether it is the header of a message of ROS.
fn is_header(key: &str, map: &Map<String, Value>) -> bool {
    key == "header"
        && map
            .keys()
            .all(|key| ["seq", "stamp", "frame_id"].contains(&key.as_str()))
}

/// Whether numbers of a key, or what an object of that key has, are about something else than a camera's lens, place
/// and size.
pub fn is_harmless(key: &str, value: &Value) -> bool {
    is_harmless_of(&Key::of(key), value)
}

fn is_harmless_of(key: &Key, value: &Value) -> bool {
    let (own, words) = (plain(&key.own), key.words());
    let objects = || match value {
        Value::Array(list) => list.iter().any(Value::is_object),
        value => value.is_object(),
    };
    let alone = || !is_stating(&key.around, &[]) && !has(&key.around, LENSES);
    (HARMLESS_KEYS.contains(&own.as_str()) && !objects() && alone())
        || is_of_rectified(&own, value)
        || is_new_matrix(&self::words(&key.own), value)
        || (own == "extrinsicparameters" && has_rows_of_six(value))
        || is_of_quality(&words)
        || (!is_stating(&words, &[])
            && (has(&words, SIZED)
                || (!has(&words, SIZES) && (has(&words, HARMLESS) || has(&words, QUALITY)))))
}

/// Words of a key in lower case: split at signs, digits and capitals.
pub fn words(key: &str) -> Vec<String> {
    let letters: Vec<char> = key.chars().collect();
    let mut words: Vec<String> = Vec::new();
    for (i, &c) in letters.iter().enumerate() {
        if !c.is_alphanumeric() {
            continue;
        }
        let before = i.checked_sub(1).and_then(|i| letters.get(i));
        let next = letters.get(i + 1);
        let goes_on = before.is_some_and(|before| {
            before.is_alphanumeric()
                && before.is_numeric() == c.is_numeric()
                && !(c.is_uppercase()
                    && (before.is_lowercase() || next.is_some_and(|c| c.is_lowercase())))
        });
        match words.last_mut() {
            Some(word) if goes_on => word.extend(c.to_lowercase()),
            _ => words.push(c.to_lowercase().collect()),
        }
    }
    words
}

/// Whether some of the words, up to three in a row, are in a list: `focal_length` as "focallength".
fn has(words: &[String], list: &[&str]) -> bool {
    runs(words).any(|run| is_in(&run, list))
}

/// The words alone, and two and three in a row as one.
fn runs(words: &[String]) -> impl Iterator<Item = String> {
    (1..=3).flat_map(|count| words.windows(count).map(|run| run.concat()))
}

/// Whether a word or, of several things, its singular is in a list.
fn is_in(word: &str, list: &[&str]) -> bool {
    list.contains(&word)
        || word
            .strip_suffix('s')
            .is_some_and(|one| list.contains(&one))
}

/// Whether words are of a lens or a place, those of a list left aside.
fn is_stating(words: &[String], aside: &[&str]) -> bool {
    let coefficient = words.windows(2).any(|pair| is_coefficient(&pair.concat()));
    let mut counted = words.iter().filter(|word| !is_in(word, aside));
    coefficient
        || counted.any(|word| {
            !is_in(word, HARMLESS)
                && (is_in(word, STATING_WORDS) || STATING.iter().any(|part| word.contains(part)))
        })
}

/// Whether a key begins or ends with words of how well it was calibrated.
fn is_of_quality(words: &[String]) -> bool {
    let count = words.len();
    (1..=count.min(2)).any(|of| {
        let ends = [&words[..of], &words[count - of..]];
        ends.iter().any(|run| is_in(&run.concat(), QUALITY))
    })
}

/// Whether it is a camera matrix or a turn of undistorted or rectified images.
fn is_new_matrix(words: &[String], value: &Value) -> bool {
    const NEW: &[&str] = &[
        "rectified",
        "rectification",
        "rectify",
        "rect",
        "undistorted",
        "newcamera",
        "optimalcamera",
        "optimalnew",
    ];
    matches!(count_of_numbers(value), Some(9 | 12))
        && has(words, NEW)
        && !is_stating(words, OF_MATRICES)
}

/// Whether OpenCV has rectified or undistorted images by it: a region of interest beside it is theirs.
pub fn rectifies(key: &str, value: &Value) -> bool {
    let projects = matches!(count_of_numbers(value), Some(12 | 16));
    (projects && is_of_rectified(&plain(key), value)) || is_new_matrix(&words(key), value)
}

/// Whether it is a row of a Rodrigues vector and a translation for each view.
fn has_rows_of_six(value: &Value) -> bool {
    let rows = || value.as_array().into_iter().flatten();
    value.get("cols").is_some_and(|cols| cols == 6)
        || (value.is_array() && rows().all(|row| row.as_array().map(Vec::len) == Some(6)))
}

/// Whether it is a matrix of rectified images or of a pair.
fn is_of_rectified(plain: &str, value: &Value) -> bool {
    let count = count_of_numbers(value);
    let known = |name: &str| {
        let mut known = RECTIFIED.iter();
        known.any(|(known, numbers)| *known == name && count == Some(*numbers))
    };
    cuts(plain).any(|(name, _)| known(name))
}

/// A plain key as a name and the camera after it: "" where it is a name as a whole, "1" of `m1`, "left" of
/// `kleft` and `kl`.
pub fn cuts(plain: &str) -> impl Iterator<Item = (&str, &str)> {
    const SIDES: [(&str, &str); 4] = [
        ("left", "left"),
        ("right", "right"),
        ("l", "left"),
        ("r", "right"),
    ];
    let digits = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    let sides = SIDES
        .iter()
        .filter_map(|(end, side)| Some((plain.strip_suffix(end)?, *side)));
    [(plain, ""), (digits, &plain[digits.len()..])]
        .into_iter()
        .chain(sides)
}

/// Whether a value states anything: numbers that are not 0 of a key that is not harmless, also as text; flags and texts
/// as [`texts`] has it.
fn states(key: &Key, value: &Value, harmless: bool) -> bool {
    if let Some(on) = texts::flag(value) {
        return texts::flag_states(key, on, value);
    }
    match value {
        Value::Number(number) => !harmless && number.as_f64() != Some(0.0),
        Value::String(text) => match is_numbers(text) {
            Some(any) => any && !harmless,
            None => texts::text_states(key, text, value),
        },
        Value::Array(list) => list.iter().any(|value| states(key, value, harmless)),
        Value::Object(map) => map
            .get("data")
            .is_some_and(|data| states(key, data, harmless)),
        _ => false,
    }
}

/// Of text that is numbers, whether one of them is not 0.
fn is_numbers(text: &str) -> Option<bool> {
    let words = text.split(|c: char| c.is_whitespace() || ",;[]()".contains(c));
    let number = |word: &str| word.trim_start_matches('.').parse::<f64>().ok();
    let numbers = words.filter(|word| !word.is_empty()).map(number);
    let numbers: Vec<f64> = numbers.collect::<Option<_>>()?;
    (!numbers.is_empty()).then(|| numbers.iter().any(|number| *number != 0.0))
}

/// Whether text is a lens by name, other than a pinhole with or without OpenCV's distortion.
pub fn names_a_lens(text: &str) -> bool {
    let plain = plain(text);
    !plain.is_empty()
        && (Lens::named(text, &[0.0; 4]).is_ok_and(|lens| lens.is_fisheye())
            || [
                "fisheye",
                "equidist",
                "kannala",
                "omni",
                "doublesphere",
                "scaramuzza",
                "thinprism",
                "unified",
            ]
            .iter()
            .any(|name| plain.contains(name))
            || [
                "mei", "eucm", "ds", "kb", "kb4", "kb8", "ucm", "fov", "ftheta",
            ]
            .contains(&plain.as_str()))
}

/// Whether a key is a coefficient by its letter and number.
fn is_coefficient(plain: &str) -> bool {
    let base = plain.trim_end_matches(|c: char| c.is_ascii_digit());
    base.len() < plain.len() && ["k", "p", "s", "l"].contains(&base)
}

/// A key without case and signs.
pub fn plain(key: &str) -> String {
    let letters = key.chars().filter(|c| c.is_alphanumeric());
    letters.flat_map(char::to_lowercase).collect()
}
