//! YAML, JSON, TOML and OpenCV's XML to one kind of value.
//!
//! Not serde's YAML: OpenCV's `%YAML:1.0` is no YAML directive, its tags say nothing that is needed,
//! and a calibration that says a key twice must not lose one of the two.

use std::collections::BTreeMap;

use mvtop_geometry::json;
use saphyr_parser::{Event, Parser, ScalarStyle};
use serde_json::{Map, Number, Value};

use crate::source::Source;
use crate::{Checked, xml};

/// Deepest nesting that is read; calibrations have four.
const DEEPEST: usize = 64;

/// Most values that aliases may repeat.
const MOST_REPEATED: usize = 1 << 18;
/// The key that merges other mappings into one.
const MERGE: &str = "<<";

/// The documents of a file of YAML, JSON, TOML or OpenCV's XML.
pub fn documents(source: &Source) -> Checked<Vec<Value>> {
    let text = source.text()?;
    let of = |problem: String| format!("{}: {problem}", source.name);
    if text.trim_start().starts_with(['{', '[']) && source.file_name().ends_with(".json") {
        let value = json::from_str(text).map_err(|cause| {
            let unreal = ["NaN", "Infinity"]
                .iter()
                .find(|word| text.contains(**word));
            let hint = unreal.map_or(String::new(), |word| {
                format!(
                    "; {word} is no number in JSON, nor one of a calibration that has succeeded"
                )
            });
            of(format!("no JSON: {cause}{hint}"))
        })?;
        return Ok(vec![value]);
    }
    if source.file_name().ends_with(".toml") {
        let value = toml::from_str(text).map_err(|error| {
            let line = text[..error.span().map_or(0, |span| span.start)]
                .lines()
                .count();
            of(format!(
                "no TOML: line {line}: {}",
                error.message().replace('\n', " ")
            ))
        })?;
        return Ok(vec![value]);
    }
    if xml::is_xml(text) {
        return xml::parse(text).map(|value| vec![value]).map_err(of);
    }
    let read = parse(text).map_err(of);
    let holds = |value: &Value| value.is_object() || value.is_array();
    match read.as_ref().is_ok_and(|all| all.iter().any(holds)) {
        false if is_ini(text) => Err(of(
            "an INI file of a program that is not known; of these, only those of a ZED are read"
                .into(),
        )),
        _ => read,
    }
}

/// Whether text has sections and values: `[left]`, `fx = 905.5`.
fn is_ini(text: &str) -> bool {
    let mut lines = text.lines().map(str::trim);
    lines.any(|line| line.starts_with('[') && line.ends_with(']'))
        && lines.any(|line| {
            line.split_once('=')
                .is_some_and(|(key, _)| !key.trim().is_empty())
        })
}

/// The one document of a file.
pub fn document(source: &Source) -> Checked<Value> {
    let mut documents = documents(source)?;
    match (documents.pop(), documents.len()) {
        (Some(value), 0) => Ok(value),
        (None, _) => Err(format!(
            "{}: expected YAML or JSON, got nothing",
            source.name
        )),
        (_, more) => Err(format!(
            "{}: expected one YAML document, got {}",
            source.name,
            more + 1
        )),
    }
}

/// A list or mapping that is not complete yet.
enum Open {
    List(Vec<Value>),
    /// With the key whose value comes next, and what `<<` merges into it.
    Map(Map<String, Value>, Option<String>, Map<String, Value>),
}

/// Values that aliases repeat, by their anchors.
#[derive(Default)]
struct Anchors {
    values: BTreeMap<usize, Value>,
    /// How many values were repeated.
    repeated: usize,
}

impl Anchors {
    fn repeat(&mut self, anchor: usize) -> Checked<Value> {
        let value = self.values.get(&anchor);
        let value = value.ok_or("an alias (*) of something that is not there; write it out")?;
        self.repeated += count(value);
        match self.repeated > MOST_REPEATED {
            true => Err(format!(
                "aliases (*) repeat more than {MOST_REPEATED} values; write them out"
            )),
            false => Ok(value.clone()),
        }
    }

    /// Keeps a value for its aliases.
    fn keep(&mut self, anchor: usize, value: &Value) {
        // Without an anchor it is 0.
        if anchor > 0 {
            self.values.insert(anchor, value.clone());
        }
    }
}

fn count(value: &Value) -> usize {
    let inner: usize = match value {
        Value::Array(list) => list.iter().map(count).sum(),
        Value::Object(map) => map.values().map(count).sum(),
        _ => 0,
    };
    inner + 1
}

/// The entries that `<<` merges: of one mapping, or of a list of these, the first of which counts.
fn merged(value: Value) -> Option<Map<String, Value>> {
    let all = match value {
        Value::Array(list) => list,
        one => vec![one],
    };
    let mut entries = Map::new();
    for one in all {
        let Value::Object(map) = one else {
            return None;
        };
        for (key, value) in map {
            entries.entry(key).or_insert(value);
        }
    }
    Some(entries)
}

fn parse(text: &str) -> Checked<Vec<Value>> {
    // A comment in place of OpenCV's first line keeps the numbers of the others.
    let opencv = text.strip_prefix("%YAML:1.0");
    let text = opencv.map_or(text.to_owned(), |rest| format!("#        {rest}"));
    let mut documents = Vec::new();
    let mut open: Vec<(Open, usize)> = Vec::new();
    let mut anchors = Anchors::default();
    for event in Parser::new_from_str(&text) {
        let (event, span) = event.map_err(|error| {
            let line = error.marker().line();
            format!(
                "no YAML: line {line}: {}; leave out what is none, as lines of a log",
                error.info()
            )
        })?;
        let line = span.start.line();
        let value = match event {
            Event::Alias(anchor) => anchors
                .repeat(anchor)
                .map_err(|problem| format!("line {line}: {problem}"))?,
            Event::SequenceStart(..) | Event::MappingStart(..) if open.len() >= DEEPEST => {
                return Err(format!("line {line}: nested more than {DEEPEST} deep"));
            }
            Event::SequenceStart(anchor, _) => {
                open.push((Open::List(Vec::new()), anchor));
                continue;
            }
            Event::MappingStart(anchor, _) => {
                open.push((Open::Map(Map::new(), None, Map::new()), anchor));
                continue;
            }
            Event::Scalar(text, style, anchor, _) => {
                let value = scalar(&text, style);
                anchors.keep(anchor, &value);
                value
            }
            Event::SequenceEnd | Event::MappingEnd => {
                let Some((closed, anchor)) = open.pop() else {
                    continue;
                };
                let value = match closed {
                    Open::List(list) => Value::Array(list),
                    Open::Map(mut map, _, more) => {
                        for (key, value) in more {
                            map.entry(key).or_insert(value);
                        }
                        Value::Object(map)
                    }
                };
                anchors.keep(anchor, &value);
                value
            }
            _ => continue,
        };
        match open.last_mut().map(|(open, _)| open) {
            None => documents.push(value),
            Some(Open::List(list)) => list.push(value),
            Some(Open::Map(map, key @ None, _)) => {
                let name = match value {
                    Value::String(name) => name,
                    Value::Array(_) | Value::Object(_) => {
                        return Err(format!("line {line}: a key must be a word"));
                    }
                    other => other.to_string(),
                };
                if map.contains_key(&name) {
                    return Err(format!("line {line}: the key `{name}` is there twice"));
                }
                *key = Some(name);
            }
            Some(Open::Map(map, key, more)) => match key.take().unwrap_or_default() {
                key if key == MERGE => {
                    let wrong = || format!("line {line}: `<<` merges a mapping or a list of these");
                    more.extend(merged(value).ok_or_else(wrong)?);
                }
                key => {
                    map.insert(key, value);
                }
            },
        }
    }
    Ok(documents)
}

/// Plain words that are numbers are numbers; what is quoted is text.
fn scalar(text: &str, style: ScalarStyle) -> Value {
    if style != ScalarStyle::Plain {
        return Value::String(text.to_owned());
    }
    match text {
        "" | "~" | "null" => return Value::Null,
        "true" | "True" => return Value::Bool(true),
        "false" | "False" => return Value::Bool(false),
        _ => {}
    }
    if let Ok(whole) = text.parse::<i64>() {
        return Value::Number(whole.into());
    }
    // Rust also reads "inf" and "nan" as numbers, which a lens has none of.
    let number = text.parse::<f64>().ok().and_then(Number::from_f64);
    number.map_or_else(|| Value::String(text.to_owned()), Value::Number)
}
