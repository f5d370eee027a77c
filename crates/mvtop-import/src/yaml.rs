//! YAML, JSON, TOML and OpenCV's XML to one kind of value.
//!
//! Not serde's YAML: OpenCV's `%YAML:1.0` is no YAML directive, its tags say nothing that is needed,
//! and a calibration that says a key twice must not lose one of the two.

use mvtop_geometry::json;
use saphyr_parser::{Event, Parser, ScalarStyle};
use serde_json::{Map, Number, Value};

use crate::source::Source;
use crate::{Checked, xml};

/// Deepest nesting that is read; calibrations have four.
const DEEPEST: usize = 64;

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
    Map(Map<String, Value>, Option<String>),
}

fn parse(text: &str) -> Checked<Vec<Value>> {
    // A comment in place of OpenCV's first line keeps the numbers of the others.
    let opencv = text.strip_prefix("%YAML:1.0");
    let text = opencv.map_or(text.to_owned(), |rest| format!("#        {rest}"));
    let mut documents = Vec::new();
    let mut open: Vec<Open> = Vec::new();
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
            Event::Alias(_) => {
                return Err(format!(
                    "line {line}: YAML aliases (*) are not read; write it out"
                ));
            }
            Event::SequenceStart(..) | Event::MappingStart(..) if open.len() >= DEEPEST => {
                return Err(format!("line {line}: nested more than {DEEPEST} deep"));
            }
            Event::SequenceStart(..) => {
                open.push(Open::List(Vec::new()));
                continue;
            }
            Event::MappingStart(..) => {
                open.push(Open::Map(Map::new(), None));
                continue;
            }
            Event::Scalar(text, style, ..) => scalar(&text, style),
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some(Open::List(list)) => Value::Array(list),
                Some(Open::Map(map, _)) => Value::Object(map),
                None => continue,
            },
            _ => continue,
        };
        match open.last_mut() {
            None => documents.push(value),
            Some(Open::List(list)) => list.push(value),
            Some(Open::Map(map, key @ None)) => {
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
            Some(Open::Map(map, key)) => {
                map.insert(key.take().unwrap_or_default(), value);
            }
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
