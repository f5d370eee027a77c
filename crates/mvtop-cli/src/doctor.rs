//! `doctor`: what was found, and what to do.

use std::path::Path;

use mvtop_core::Error;
use mvtop_core::bundle::Bundle;
use mvtop_core::onnx::{Provider, Runtime};

use crate::failure::{Failure, Result};
use crate::model_dir::Found;
use crate::options::NetworkArgs;
use crate::write::print;

pub fn run(args: &NetworkArgs) -> Result<()> {
    print(&format!("mvtop-cli {}\n", env!("CARGO_PKG_VERSION")))?;
    let runtime = Runtime::locate(args.library());
    let packaged = args.runtime.ort_lib.is_none() && args.library().is_some();
    let by = packaged.then_some("the installed package onnxruntime");
    print(&format!("{}\n", on_runtime(&runtime, by)))?;

    let found = args.found();
    let model = found.and_then(|Found { folder: dir, by }| {
        print(&format!("Model  {}\n  found in   {by}", dir.display()))?;
        check_bundle(&dir)?;
        if runtime.is_ok() {
            let estimator = args.load(&dir)?;
            print(&format!("  networks   load on `{}`", args.runtime.provider))?;
            print(match estimator.self_test()? {
                true => "  self-test  answers as when it was exported",
                false => "  self-test  none in this bundle; export it again to have one",
            })?;
        }
        Ok(())
    });
    match &model {
        Ok(()) => print("all well")?,
        Err(problem) => print(&format!("problem: {problem}"))?,
    }

    match (runtime, model) {
        (Ok(_), model) => model,
        (Err(problem), Ok(())) => Err(problem.into()),
        (Err(runtime), Err(model)) => Err(Failure(format!("{runtime}; also, {model}"))),
    }
}

/// What there is to say about ONNX Runtime on this machine.
///
/// - `by`: what found it, where it was not searched for
fn on_runtime(runtime: &mvtop_core::Result<Runtime>, by: Option<&str>) -> String {
    let mut lines = Vec::new();
    let attempts = match runtime {
        Ok(runtime) => {
            let providers = runtime.providers().into_iter().map(Provider::name);
            let providers: Vec<&str> = providers.collect();
            lines.push(format!("ONNX Runtime  {}", runtime.library().display()));
            let found_in = by.unwrap_or_else(|| runtime.found_in());
            lines.push(format!("  found in    {found_in}"));
            if let Some(version) = runtime.version() {
                lines.push(format!("  version     {version}"));
            }
            lines.push(format!("  build       {}", runtime.build()));
            lines.push(format!("  providers   {}", providers.join(", ")));
            runtime.attempts()
        }
        Err(error) => {
            lines.push("ONNX Runtime  not found".to_owned());
            match error {
                Error::RuntimeMissing { attempts } => attempts,
                _ => &[][..],
            }
        }
    };
    let passed_over = |attempt| format!("  passed over  {attempt}");
    lines.extend(attempts.iter().map(passed_over));
    lines.push(match runtime {
        Ok(_) => "all well".to_owned(),
        Err(problem) => format!("problem: {problem}"),
    });
    lines.join("\n")
}

fn check_bundle(dir: &Path) -> Result<()> {
    let bundle = Bundle::load(dir)?;
    let classes: Vec<&str> = bundle.classes.iter().map(|c| c.name.as_str()).collect();
    let kind = match bundle.portable {
        true => "standard operators only",
        false => "mvtop's operator",
    };
    let (preset, classes) = (&bundle.preset, classes.join(", "));
    let (width, height) = (bundle.input.width, bundle.input.height);
    print(&format!(
        "  preset     {preset} ({kind})\n  classes    {classes}\n  input      {width}x{height} px\n  \
         checksums  match"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn library_that_cannot_be_loaded_is_named_with_what_is_wrong() {
        let runtime = Runtime::locate(Some(Path::new("/no/such/libonnxruntime.so")));
        let text = on_runtime(&runtime, None);
        assert!(
            text.contains("not found") && text.contains("problem: "),
            "{text}"
        );
        assert!(text.contains("/no/such/libonnxruntime.so"), "{text}");
    }
}
