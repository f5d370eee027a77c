//! `docs/reference/inference.md` has a line for each setting of the inference, with its default.

use mvtop_core::config::InferenceConfig;
use serde_json::Value;

/// Dotted path and default of each setting, as compact JSON; arrays are values.
fn leaves(path: &str, value: &Value, found: &mut Vec<(String, String)>) {
    let Value::Object(fields) = value else {
        found.push((path.to_owned(), value.to_string()));
        return;
    };
    for (name, value) in fields {
        match path {
            "" => leaves(name, value, found),
            _ => leaves(&format!("{path}.{name}"), value, found),
        }
    }
}

#[test]
fn docs_list_every_setting_with_its_default() {
    // By way of text, as 32-bit numbers become long ones otherwise.
    let text = serde_json::to_string(&InferenceConfig::default()).unwrap();
    let mut settings = Vec::new();
    leaves("", &serde_json::from_str(&text).unwrap(), &mut settings);

    let docs = include_str!("../../../../docs/reference/inference.md");
    let rows = docs.lines().filter_map(|line| line.strip_prefix("- `"));
    let rows: Vec<(&str, &str)> = rows
        .map(|row| {
            let (path, rest) = row.split_once("` (").unwrap();
            (path, rest.split_once("): ").unwrap().0)
        })
        .collect();
    for (path, default) in &settings {
        let described = rows.iter().filter(|(row, _)| row == path);
        let described: Vec<&str> = described.map(|(_, default)| *default).collect();
        assert_eq!(described, [default.as_str()], "line of `{path}`");
    }
    for (row, _) in &rows {
        let known = settings.iter().any(|(path, _)| path == row);
        assert!(known, "`{row}` is no setting");
    }
}
