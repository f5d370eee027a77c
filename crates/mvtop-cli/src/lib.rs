//! Command line of mvtop. Exit code 0 when all is well, 2 with one sentence on stderr otherwise.
//!
//! A library, so that Python's wheel installs the same command.

mod args;
mod audit;
mod doctor;
mod eval;
mod failure;
mod infer;
mod model_dir;
mod options;
mod plot;
mod progress;
mod request;
mod rig;
mod schema;
mod serve;
mod table;
mod write;

use std::ffi::OsString;
use std::io;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use clap::Parser;
use mvtop_eval::runner::bop::Options;

use args::{Cli, Command};

/// Says what the package that this runs from brings along. For the life of the process.
///
/// - `folder`: with the model and the example that it carries, in `model` and `example`
/// - `library`: of the ONNX Runtime that is installed with it, used where none is named
pub fn ship(folder: PathBuf, library: Option<PathBuf>) {
    model_dir::ship(folder, library);
}

/// Writes a file, which appears when it is whole.
///
/// - `overwrite`: whether one that is there may be replaced
///
/// # Errors
/// That of the system; of the kind `AlreadyExists` where there is one.
pub fn save(path: &Path, text: &str, overwrite: bool) -> io::Result<()> {
    if !overwrite && path.symlink_metadata().is_ok() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    write::persist(path, text.as_bytes())
}

/// Scores of the results in BOP's format that the options name, one line of JSON as `mvtop-cli eval bop
/// --json` prints; progress and warnings go to stderr.
///
/// - `report`: folder for results and pages, if they are wanted
///
/// # Errors
/// One sentence.
pub fn score_results(options: &Options, report: Option<&Path>) -> Result<String, String> {
    let answer = eval::score_results(options, report, report);
    answer.map(|answer| answer.json).map_err(|f| f.to_string())
}

/// Exit code where a pose is less certain than was asked for.
const NOT_ACCEPTED: u8 = 3;

/// Runs the command that `args` name, the first being the program's own name; returns the exit code.
pub fn run(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args: Vec<OsString> = args.into_iter().collect();
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(answer) => {
            // Help and version come here as well, for which a reader that has gone away is no failure.
            let printed = answer.print();
            let lost = printed.is_err_and(|cause| cause.kind() != ErrorKind::BrokenPipe);
            return if answer.use_stderr() || lost { 2 } else { 0 };
        }
    };
    let done = match cli.command {
        Command::Infer(args) => match infer::run(&args) {
            Ok(false) => return NOT_ACCEPTED,
            done => done.map(|_| ()),
        },
        Command::Serve(args) => serve::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Audit(args) => audit::run(&args),
        Command::Rig(args) => rig::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Schema(args) => schema::run(&args),
    };
    match done {
        Ok(()) => 0,
        Err(failure) => {
            write::complain(&format!("error: {failure}"));
            2
        }
    }
}
