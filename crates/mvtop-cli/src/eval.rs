//! `eval`: errors of the poses over many images whose truth is known.

pub mod args;
mod bop;
mod samples;

use self::args::Eval;
pub use self::bop::of_files as score_results;
use crate::failure::Result;

pub fn run(command: &Eval) -> Result<()> {
    match command {
        Eval::Samples(args) => samples::run(args),
        Eval::Bop(args) => bop::run(args),
    }
}
