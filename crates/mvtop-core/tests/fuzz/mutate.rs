//! Files that were good once.

use proptest::prelude::*;

/// What breaks readers: numbers beyond their type, other types, brackets, marks, other encodings.
const TOKENS: [&str; 20] = [
    "null",
    "true",
    "[",
    "]",
    "{}",
    "\"",
    ",",
    "-",
    "1e999",
    "1e-400",
    "-0.0",
    "NaN",
    "0",
    "4294967296",
    "18446744073709551616",
    "99999999999999999999999999",
    "\u{feff}",
    "\0",
    "\u{202e}",
    "\\ud800",
];

/// One change, at places that are shares of the length.
#[derive(Debug, Clone)]
pub enum Edit {
    Set(f64, u8),
    Cut(f64, usize),
    Repeat(f64, usize),
    Insert(f64, usize),
    End(f64),
}

/// Some changes of a file; few, as most end at the first.
pub fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let place = || 0.0..1.0;
    let edit = prop_oneof![
        (place(), any::<u8>()).prop_map(|(at, byte)| Edit::Set(at, byte)),
        (place(), 1..40usize).prop_map(|(at, length)| Edit::Cut(at, length)),
        (place(), 1..40usize).prop_map(|(at, length)| Edit::Repeat(at, length)),
        (place(), 0..TOKENS.len()).prop_map(|(at, token)| Edit::Insert(at, token)),
        place().prop_map(Edit::End),
    ];
    prop::collection::vec(edit, 1..4)
}

/// The file with the changes made.
pub fn changed(good: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut bytes = good.to_vec();
    for edit in edits {
        let place = |share: f64| (share * bytes.len() as f64) as usize;
        match *edit {
            _ if bytes.is_empty() => {}
            Edit::Set(at, byte) => {
                let at = place(at);
                bytes[at] = byte;
            }
            Edit::Cut(at, length) => {
                let at = place(at);
                bytes.drain(at..(at + length).min(bytes.len()));
            }
            Edit::Repeat(at, length) => {
                let at = place(at);
                let part = bytes[at..(at + length).min(bytes.len())].to_vec();
                bytes.splice(at..at, part);
            }
            Edit::Insert(at, token) => {
                let at = place(at);
                bytes.splice(at..at, TOKENS[token].bytes());
            }
            Edit::End(at) => bytes.truncate(place(at)),
        }
    }
    bytes
}
