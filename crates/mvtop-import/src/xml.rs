//! OpenCV's FileStorage as XML, to the same kind of value as its YAML.
//!
//! Source: <https://docs.opencv.org/4.x/dd/d74/tutorial_file_input_output_with_xml_yml.html>: the root is
//! `opencv_storage`, an element is a key, `_` is an item of a list, and what a matrix consists of are
//! its elements `rows`, `cols`, `dt` and `data`.

use roxmltree::{Document, Node, ParsingOptions};
use serde_json::{Map, Number, Value};

use crate::Checked;

/// Most elements and attributes that are read.
const MOST_NODES: u32 = 1 << 20;
/// Deepest nesting that is read.
const DEEPEST: usize = 64;

/// Whether the text is XML.
pub fn is_xml(text: &str) -> bool {
    text.trim_start().starts_with('<')
}

/// The value of a FileStorage.
pub fn parse(text: &str) -> Checked<Value> {
    let options = ParsingOptions {
        nodes_limit: MOST_NODES,
        ..ParsingOptions::default()
    };
    let document =
        Document::parse_with_options(text, options).map_err(|error| format!("no XML: {error}"))?;
    let root = document.root_element();
    match root.tag_name().name() {
        "opencv_storage" => element(root, 0),
        got => Err(format!(
            "expected OpenCV's `opencv_storage`, a URDF's `robot` or Metashape's `document`, got XML of `{got}`"
        )),
    }
}

fn element(node: Node, depth: usize) -> Checked<Value> {
    if depth > DEEPEST {
        return Err(format!("nested more than {DEEPEST} deep"));
    }
    let mut map = Map::new();
    let mut list = Vec::new();
    for child in node.children().filter(Node::is_element) {
        let key = child.tag_name().name();
        let value = match key {
            // Also one number is a list there.
            "data" => Value::Array(words(child)),
            _ => element(child, depth + 1)?,
        };
        if key == "_" {
            list.push(value);
        } else if map.insert(key.to_owned(), value).is_some() {
            return Err(format!("the key `{key}` is there twice"));
        }
    }
    if !map.is_empty() {
        return Ok(Value::Object(map));
    }
    if !list.is_empty() {
        return Ok(Value::Array(list));
    }
    let mut words = words(node);
    Ok(match words.len() {
        0 => Value::Null,
        1 => words.remove(0),
        _ => Value::Array(words),
    })
}

/// Numbers, and words in quotes or without.
fn words(node: Node) -> Vec<Value> {
    let text = node.text().unwrap_or_default();
    text.split_whitespace()
        .map(|word| {
            let number = word.parse().ok().and_then(Number::from_f64);
            let text = || Value::String(word.trim_matches('"').to_owned());
            number.map_or_else(text, Value::Number)
        })
        .collect()
}
