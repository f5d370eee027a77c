//! Earlier spellings that were documented: what to type today.

use std::ffi::OsString;

/// The command line that does what `args` did, where they are an earlier spelling.
///
/// - `args`: the first is the program's own name
pub fn today(args: &[OsString]) -> Option<String> {
    let words: Option<Vec<String>> = args
        .iter()
        .map(|arg| arg.to_str().map(Into::into))
        .collect();
    let mut words = words?;
    *words.first_mut()? = "mvtop-cli".into();
    let command: Vec<&str> = words.iter().skip(1).take(2).map(String::as_str).collect();
    match command[..] {
        ["eval", "samples" | "bop"] => return None,
        ["eval", ..] => eval(&mut words)?,
        ["audit", "leakage"] => leakage(&mut words)?,
        _ => return None,
    }
    shlex::try_join(words.iter().map(String::as_str)).ok()
}

/// `eval --samples DIR`, `eval --dataset DIR`; both printed JSON.
fn eval(words: &mut Vec<String>) -> Option<()> {
    let kind = match take(words, "--samples") {
        Some(folder) => vec!["samples".to_owned(), folder],
        None => position(words, "--dataset").map(|_| vec!["bop".to_owned()])?,
    };
    words.splice(2..2, kind);
    words.push("--json".into());
    Some(())
}

/// `audit leakage --models DIR --json FILE --pairs FILE --picture FILE`
fn leakage(words: &mut Vec<String>) -> Option<()> {
    let [meshes, picture, json, pairs] =
        ["--models", "--picture", "--json", "--pairs"].map(|name| take(words, name));
    let results = if picture.is_some() {
        "--report"
    } else {
        "--out"
    };
    let folder = picture
        .or(json)
        .or(pairs)
        .map(|file| match file.rsplit_once('/') {
            Some((folder, _)) if !folder.is_empty() => folder.to_owned(),
            _ => ".".to_owned(),
        });
    let before = words.len();
    for (name, value) in [("--meshes", meshes), (results, folder)] {
        words.extend(value.into_iter().flat_map(|value| [name.to_owned(), value]));
    }
    (words.len() > before).then_some(())
}

fn position(words: &[String], name: &str) -> Option<usize> {
    let is = |word: &String| {
        word.strip_prefix(name)
            .is_some_and(|w| w.is_empty() || w.starts_with('='))
    };
    words.iter().position(is)
}

/// Takes out an option that has a value, and gives this.
fn take(words: &mut Vec<String>, name: &str) -> Option<String> {
    let at = position(words, name)?;
    if let Some((_, value)) = words[at].split_once('=') {
        let value = value.to_owned();
        words.remove(at);
        return Some(value);
    }
    words.get(at + 1).filter(|value| !value.starts_with("--"))?;
    words.remove(at);
    Some(words.remove(at))
}
