use std::process::ExitCode;

fn main() -> ExitCode {
    if closed::STDOUT.load(std::sync::atomic::Ordering::Relaxed) {
        eprintln!("error: stdout is closed, expected a stream; fix: >/dev/null");
        return ExitCode::from(2);
    }
    ExitCode::from(mvtop_cli::run(std::env::args_os()))
}

/// Whether stdout was closed when the process started: Rust's runtime opens `/dev/null` in its place, and
/// what is written there would be lost without a word.
mod closed {
    use std::sync::atomic::{AtomicBool, Ordering};

    pub static STDOUT: AtomicBool = AtomicBool::new(false);

    /// Called by the C library before Rust's runtime starts.
    #[cfg(target_os = "linux")]
    #[used]
    // SAFETY: the section holds functions of this kind.
    #[unsafe(link_section = ".init_array")]
    static LOOK: extern "C" fn() = look;

    #[cfg(target_os = "linux")]
    extern "C" fn look() {
        // SAFETY: it only asks for the flags of a descriptor.
        let flags = unsafe { libc::fcntl(libc::STDOUT_FILENO, libc::F_GETFD) };
        STDOUT.store(flags == -1, Ordering::Relaxed);
    }
}
