//! Progress bars and warnings, on stderr; bars where that is a terminal.

use indicatif::{ProgressBar, ProgressStyle};
use mvtop_core::error::printable;
use mvtop_eval::runner::Observer;

use crate::write;

/// - `of`: what is counted, indicatif's `{pos}/{len} samples`
pub fn bar(length: u64, of: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(&format!("{{bar:40}} {of}, {{eta}} left"))
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length).with_style(style)
}

/// Shows how an evaluation goes on.
pub struct Progress {
    /// What is counted: `samples`.
    of: &'static str,
    bar: ProgressBar,
}

impl Progress {
    pub fn new(of: &'static str) -> Self {
        let bar = ProgressBar::hidden();
        Self { of, bar }
    }
}

impl Observer for Progress {
    fn begin(&mut self, total: usize, done: usize) {
        self.bar = bar(total as u64, &format!("{{pos}}/{{len}} {}", self.of));
        self.bar.inc(done as u64);
        self.bar.reset_eta();
    }

    fn advance(&mut self) {
        self.bar.inc(1);
    }

    fn end(&mut self) {
        self.bar.finish_and_clear();
    }

    fn warn(&mut self, sentence: &str) {
        let line = format!("warning: {}", printable(sentence));
        self.bar.suspend(|| write::complain(&line));
    }
}
