//! What is told of an evaluation while it runs.

use mvtop_core::Prediction;

/// Is told how an evaluation goes on. `()` listens to nothing.
pub trait Observer {
    /// It begins.
    ///
    /// - `total`: samples or groups
    /// - `done`: of these, how many were done before
    fn begin(&mut self, _total: usize, _done: usize) {}

    /// One more sample or group is done.
    fn advance(&mut self) {}

    /// All are done.
    fn end(&mut self) {}

    /// What makes results doubtful, one sentence.
    fn warn(&mut self, _sentence: &str) {}
}

impl Observer for () {}

/// The warnings of a prediction.
///
/// - `of`: what was predicted
pub(crate) fn warn(observer: &mut dyn Observer, prediction: &Prediction, of: &str) {
    for warning in &prediction.warnings {
        observer.warn(&format!("{of}: {}", warning.message));
    }
}
