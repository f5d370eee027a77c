//! `doctor`: what was found, and what to do.

use std::path::Path;

use mvtop_core::Estimator;
use mvtop_core::bundle::Bundle;
use mvtop_core::onnx::Doctor;

use crate::args::NetworkArgs;
use crate::failure::{Failure, Result};
use crate::model_dir;
use crate::write::print;

pub fn run(args: &NetworkArgs) -> Result<()> {
    print(&format!("mvtop-cli {}\n", env!("CARGO_PKG_VERSION")))?;
    let runtime = Doctor::examine(args.ort_lib.as_deref());
    print(&format!("{runtime}\n"))?;

    let model = model_dir::find(args.model.as_deref()).and_then(|dir| {
        print(&format!("Model  {}", dir.display()))?;
        check_bundle(&dir)?;
        if runtime.problem.is_none() {
            Estimator::load(&dir, &args.options())?;
            print(&format!("  networks   load and run on `{}`", args.provider))?;
        }
        Ok(())
    });
    match &model {
        Ok(()) => print("all well")?,
        Err(problem) => print(&format!("problem: {problem}"))?,
    }

    match (runtime.problem, model) {
        (None, Ok(())) => Ok(()),
        (Some(problem), Ok(())) => Err(Failure(problem)),
        (None, Err(problem)) => Err(problem),
        (Some(runtime), Err(model)) => Err(Failure(format!("{runtime}; also, {model}"))),
    }
}

fn check_bundle(dir: &Path) -> Result<()> {
    let bundle = Bundle::load(dir)?;
    let classes: Vec<&str> = bundle
        .classes
        .iter()
        .map(|class| class.name.as_str())
        .collect();
    let kind = if bundle.portable {
        "standard operators only"
    } else {
        "mvtop's operator"
    };
    print(&format!("  preset     {} ({kind})", bundle.preset))?;
    print(&format!("  classes    {}", classes.join(", ")))?;
    print(&format!(
        "  input      {}x{} px",
        bundle.input.width, bundle.input.height
    ))?;
    print("  checksums  match")
}
