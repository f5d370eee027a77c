use std::collections::HashSet;
use std::fmt;
use std::path::Path;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};

use crate::{Error, Result, file};

/// Largest file of JSON that is read: as large as annotations of long scenes get, several times.
const MAX_FILE_BYTES: u64 = 1 << 29;

/// Reads a file of JSON.
///
/// - `expected`: what the file should hold, for the error
///
/// # Errors
/// [`Error::Read`] where it cannot be read, [`Error::Json`] where it holds something else, a key
/// twice in one object, or lists in lists more than 127 deep.
pub fn read<T: DeserializeOwned>(path: &Path, expected: &str) -> Result<T> {
    let text = file::read_text(path, MAX_FILE_BYTES)?;
    from_str(&text).map_err(|cause| Error::Json {
        path: path.to_owned(),
        expected: expected.to_owned(),
        cause,
    })
}

/// Reads the text of JSON, as serde_json does, but that a key which comes twice in one object is
/// refused wherever it is: which of the two was meant, nobody knows.
///
/// # Errors
/// Those of serde_json, with line and column.
///
/// ```
/// use mvtop_geometry::json::from_str;
///
/// let twice = from_str::<serde_json::Value>(r#"{"fx": 600, "fy": 600, "fx": 60}"#);
/// assert!(twice.unwrap_err().to_string().contains("the key `fx` comes twice"));
/// ```
pub fn from_str<T: DeserializeOwned>(text: &str) -> serde_json::Result<T> {
    serde_json::from_str::<Unique>(text)?;
    serde_json::from_str(text)
}

/// Any value in which no key comes twice; nothing of it is kept.
struct Unique;

impl<'de> Deserialize<'de> for Unique {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Unique)
    }
}

impl<'de> Visitor<'de> for Unique {
    type Value = Self;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_unit<E>(self) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_bool<E>(self, _: bool) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_i64<E>(self, _: i64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_u64<E>(self, _: u64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_f64<E>(self, _: f64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_str<E>(self, _: &str) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Self, A::Error> {
        while items.next_element::<Self>()?.is_some() {}
        Ok(self)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Self, A::Error> {
        let mut keys = HashSet::new();
        while let Some(key) = entries.next_key::<String>()? {
            if keys.contains(&key) {
                return Err(A::Error::custom(format!(
                    "the key `{key}` comes twice in one object, leave one of them out"
                )));
            }
            keys.insert(key);
            entries.next_value::<Self>()?;
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn key_that_comes_twice_is_refused_at_any_depth() {
        for text in [
            r#"{"a": 1, "a": 1}"#,
            r#"[{"b": {"a": 1, "c": [], "a": null}}]"#,
        ] {
            let error = from_str::<Value>(text).unwrap_err().to_string();
            assert!(error.contains("`a` comes twice"), "{error}");
        }
        let apart = r#"[{"a": 1}, {"a": {"a": "x"}}, -1, 2.5, true, null]"#;
        assert_eq!(from_str::<Value>(apart).unwrap()[1]["a"]["a"], "x");
    }

    #[test]
    fn depth_is_limited() {
        let deep = "[".repeat(1_000_000);
        let error = from_str::<Value>(&deep).unwrap_err().to_string();
        assert!(error.contains("recursion limit"), "{error}");
    }
}
