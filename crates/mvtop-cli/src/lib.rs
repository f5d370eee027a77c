//! Command line of mvtop. Exit code 0 when all is well, 2 with one sentence on stderr otherwise.
//!
//! A library, so that Python's wheel installs the same command.

mod args;
mod audit;
mod doctor;
mod eval;
mod failure;
mod infer;
mod matching;
mod model_dir;
mod old_spelling;
mod plot;
mod progress;
mod rig;
mod table;
mod write;

use std::ffi::OsString;

use clap::Parser;

use args::{Cli, Command};

/// Runs the command that `args` name, the first being the program's own name; returns the exit code.
pub fn run(args: impl IntoIterator<Item = OsString>) -> u8 {
    let args: Vec<OsString> = args.into_iter().collect();
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(answer) => {
            if let Some(today) = old_spelling::today(&args).filter(|_| answer.use_stderr()) {
                write::complain(&format!(
                    "error: this was an earlier spelling; today, type: {today}"
                ));
                return 2;
            }
            // Help and version come here as well. There is nowhere left to say that printing failed.
            let _ = answer.print();
            return if answer.use_stderr() { 2 } else { 0 };
        }
    };
    let done = match cli.command {
        Command::Infer(args) => infer::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Audit(args) => audit::run(&args),
        Command::Rig(args) => rig::run(&args),
        Command::Doctor(args) => doctor::run(&args),
    };
    match done {
        Ok(()) => 0,
        Err(failure) => {
            write::complain(&format!("error: {failure}"));
            2
        }
    }
}
