//! `serve`: the same as a service.

pub mod args;

use std::path::PathBuf;
use std::time::Duration;

use mvtop_core::file;
use mvtop_serve::{Config, Line, Record};

use self::args::Serve;
use crate::failure::{Failure, Result};
use crate::model_dir;
use crate::request::base;
use crate::write::complain;

/// Environment variable of the token.
const TOKEN: &str = "MVTOP_TOKEN";
/// Largest file of a token that is read, bytes.
const MAX_TOKEN_BYTES: u64 = 1 << 16;
/// Fewest characters of a token: one that is shorter can be tried out.
const SHORTEST_TOKEN: usize = 16;

pub fn run(args: &Serve) -> Result<()> {
    let mut models = named(&args.models);
    if models.is_empty() {
        models = named(&[model_dir::find(None)?.folder.display().to_string()]);
    }
    let mut rigs = named(&args.rigs);
    if args.example {
        let rig = model_dir::example()?.folder.join("rig.json");
        rigs.push(("example".to_owned(), rig));
    }
    let record = args.record.as_ref().map(|dir| Record {
        dir: dir.clone(),
        most: args.record_most as usize,
        most_bytes: u64::from(args.record_most_mb) << 20,
        below: args.record_below,
    });
    let line = args.line_port.map(|port| Line {
        port,
        images: args.line_images.clone(),
    });
    let config = Config {
        host: args.host.clone(),
        port: args.port,
        models,
        options: args.runtime.options(),
        rigs,
        base_from_world: args.base.as_deref().map(base).transpose()?,
        token: token(args)?,
        waiting: args.waiting as usize,
        max_body: (args.max_body_mb as usize) << 20,
        body_time: Duration::from_secs(args.body_seconds.into()),
        request_time: Duration::from_secs(args.request_seconds.into()),
        history_bytes: (args.history_mb as usize) << 20,
        record,
        line,
    };
    mvtop_serve::run(config, complain).map_err(Failure)
}

/// `NAME=PATH`, or a path whose last part is the name: a folder, or a file without its ending.
fn named(given: &[String]) -> Vec<(String, PathBuf)> {
    let named = |text: &String| match text.split_once('=') {
        Some((name, path)) => (name.to_owned(), path.into()),
        None => {
            let path = PathBuf::from(text);
            // `.` has a name all the same.
            let whole = path.canonicalize().unwrap_or_else(|_| path.clone());
            let name = match whole.is_file() {
                true => whole.file_stem(),
                false => whole.file_name(),
            };
            let name = name.unwrap_or_default().to_string_lossy();
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
            (name.replace(|c| !plain(c), "_"), path)
        }
    };
    given.iter().map(named).collect()
}

/// The token of the file that is named, else of the environment.
fn token(args: &Serve) -> Result<Option<String>> {
    let (from, token) = match &args.token_file {
        Some(path) => (
            path.display().to_string(),
            file::read_text(path, MAX_TOKEN_BYTES)?,
        ),
        None => match std::env::var(TOKEN) {
            Ok(token) if !token.is_empty() => (format!("${TOKEN}"), token),
            _ => return Ok(None),
        },
    };
    let token = token.trim();
    if token.len() < SHORTEST_TOKEN || !token.bytes().all(|c| c.is_ascii_graphic()) {
        return Err(Failure(format!(
            "{from}: expected a token of at least {SHORTEST_TOKEN} letters, digits and signs without spaces, \
             got one of {}; make one with `openssl rand -hex 32`",
            token.chars().count()
        )));
    }
    Ok(Some(token.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::named;

    #[test]
    fn things_without_a_name_have_that_of_their_path() {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
        let given = [
            "a=b/c".into(),
            format!("{root}/models/mvball"),
            format!("{root}/Cargo.toml"),
        ];
        let names: Vec<String> = named(&given).into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["a", "mvball", "Cargo"]);
    }
}
