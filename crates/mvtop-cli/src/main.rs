use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(mvtop_cli::run(std::env::args_os()))
}
