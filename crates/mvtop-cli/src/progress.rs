//! Progress bars, on stderr where that is a terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// - `of`: what is counted, indicatif's `{pos}/{len} samples`
pub fn bar(length: u64, of: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(&format!("{{bar:40}} {of}, {{eta}} left"))
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length).with_style(style)
}
