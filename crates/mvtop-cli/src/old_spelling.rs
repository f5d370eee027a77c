//! Earlier spellings that were documented: what to type today.

use std::ffi::OsString;

/// The command line that does what `args` did, where they are an earlier spelling.
///
/// - `args`: the first is the program's own name
pub fn today(args: &[OsString]) -> Option<String> {
    let args: Option<Vec<&str>> = args.iter().skip(1).map(|arg| arg.to_str()).collect();
    let mut words = Words(args?.into_iter().map(str::to_owned).collect());
    let command: Vec<&str> = words.0.iter().take(2).map(String::as_str).collect();
    let today = match command[..] {
        ["eval", "samples" | "bop"] => return None,
        ["eval", ..] => words.eval()?,
        ["audit", "leakage"] => words.leakage()?,
        _ => return None,
    };
    let today = today.iter().map(String::as_str);
    shlex::try_join(["mvtop-cli"].into_iter().chain(today)).ok()
}

struct Words(Vec<String>);

impl Words {
    /// `eval --samples DIR`, `eval --dataset DIR`; both printed JSON.
    fn eval(&mut self) -> Option<Vec<String>> {
        let kind = match self.take("--samples") {
            Some(folder) => vec!["samples".to_owned(), folder],
            None if self.has("--dataset") => vec!["bop".to_owned()],
            None => return None,
        };
        self.0.splice(1..1, kind);
        self.0.push("--json".into());
        Some(self.0.clone())
    }

    /// `audit leakage --models DIR --json FILE --pairs FILE --picture FILE`
    fn leakage(&mut self) -> Option<Vec<String>> {
        let meshes = self.take("--models");
        let picture = self.take("--picture");
        let data = ["--json", "--pairs"].map(|name| self.take(name));
        let file = picture.iter().chain(data.iter().flatten()).next();
        let folder = file.map(|file| match file.rsplit_once('/') {
            Some((folder, _)) if !folder.is_empty() => folder.to_owned(),
            _ => ".".to_owned(),
        });
        let results = if picture.is_some() {
            "--report"
        } else {
            "--out"
        };
        let named = [("--meshes", meshes), (results, folder)];
        let named: Vec<String> = named
            .into_iter()
            .filter_map(|(name, value)| Some([name.to_owned(), value?]))
            .flatten()
            .collect();
        self.0.extend(named.iter().cloned());
        (!named.is_empty()).then(|| self.0.clone())
    }

    fn has(&self, name: &str) -> bool {
        let long = format!("{name}=");
        self.0
            .iter()
            .any(|word| word == name || word.starts_with(&long))
    }

    /// Takes out an option that has a value, and gives this.
    fn take(&mut self, name: &str) -> Option<String> {
        let long = format!("{name}=");
        let at = self
            .0
            .iter()
            .position(|word| word == name || word.starts_with(&long))?;
        if let Some(value) = self.0[at].strip_prefix(&long).map(str::to_owned) {
            self.0.remove(at);
            return Some(value);
        }
        self.0
            .get(at + 1)
            .filter(|value| !value.starts_with("--"))?;
        self.0.remove(at);
        Some(self.0.remove(at))
    }
}
