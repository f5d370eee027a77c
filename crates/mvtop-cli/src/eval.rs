//! `eval`: errors of the poses over many images whose truth is known.

pub mod args;
mod bop;
mod bounds;
mod noise;
mod outcome;
mod right;
mod sample;
mod samples;
mod summary;

use self::args::Eval;
pub use self::bop::evaluate as bop_answer;
use crate::failure::Result;

pub fn run(command: &Eval) -> Result<()> {
    match command {
        Eval::Samples(args) => samples::run(args),
        Eval::Bop(args) => bop::run(args),
    }
}
