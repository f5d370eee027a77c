//! What is counted, as Prometheus reads it.

use std::sync::atomic::AtomicU64;
use std::time::Duration;

use mvtop_core::Prediction;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Registry, Unit};

type Labels = [(&'static str, String); 1];
type Counters = Family<Labels, Counter>;
type Histograms = Family<Labels, Histogram, fn() -> Histogram>;

/// Upper bounds of the times of stages and requests, seconds.
const SECONDS: [f64; 14] = [
    0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0,
];
/// Upper bounds of confidences.
const CONFIDENCES: [f64; 11] = [0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95];

/// Counters and histograms of the service.
pub struct Metrics {
    registry: Registry,
    requests: Counters,
    stages: Histograms,
    took: Histogram,
    confidences: Histograms,
    objects: Counters,
    warnings: Counters,
    recorded: Counters,
    queue: Gauge<f64, AtomicU64>,
    streams: Gauge<f64, AtomicU64>,
    ready: Gauge<f64, AtomicU64>,
}

/// Counts a request when it is dropped, also where the client goes away meanwhile.
pub struct Counted<'a> {
    metrics: &'a Metrics,
    /// `ok`, `abandoned` or the code of a problem.
    pub outcome: &'static str,
}

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        let outcome = label("outcome", self.outcome);
        self.metrics.requests.get_or_create(&outcome).inc();
    }
}

fn seconds() -> Histogram {
    Histogram::new(SECONDS)
}

fn confidence() -> Histogram {
    Histogram::new(CONFIDENCES)
}

fn label(name: &'static str, value: impl Into<String>) -> Labels {
    [(name, value.into())]
}

impl Metrics {
    pub fn new() -> Self {
        let mut registry = Registry::with_prefix("mvtop");
        let requests = Counters::default();
        let stages: Histograms = Family::new_with_constructor(seconds);
        let took = seconds();
        let confidences: Histograms = Family::new_with_constructor(confidence);
        let (objects, warnings, recorded) = (
            Counters::default(),
            Counters::default(),
            Counters::default(),
        );
        let (queue, streams, ready) = (Gauge::default(), Gauge::default(), Gauge::default());
        let sort = "Requests for poses by outcome: ok or the code of an error";
        registry.register("requests", sort, requests.clone());
        let sort = "Times of the stages of predictions";
        registry.register_with_unit("stage", sort, Unit::Seconds, stages.clone());
        let sort = "Times from arrival to answer";
        registry.register_with_unit("request", sort, Unit::Seconds, took.clone());
        let sort = "Confidences of the poses that were given";
        registry.register("confidence", sort, confidences.clone());
        registry.register("objects", "Objects that were given", objects.clone());
        registry.register("warnings", "Warnings of predictions", warnings.clone());
        let sort = "Exposures that were kept in the folder of --record, or could not be";
        registry.register("recorded", sort, recorded.clone());
        let sort = "Exposures that are worked on or wait";
        registry.register("queue_length", sort, queue.clone());
        registry.register("streams", "Streams that are remembered", streams.clone());
        registry.register(
            "ready",
            "1 once models are loaded and tested",
            ready.clone(),
        );
        Self {
            registry,
            requests,
            stages,
            took,
            confidences,
            objects,
            warnings,
            recorded,
            queue,
            streams,
            ready,
        }
    }

    /// A request that has begun, to be counted when it ends.
    pub fn request(&self) -> Counted<'_> {
        Counted {
            metrics: self,
            outcome: "abandoned",
        }
    }

    /// Counts an exposure that was to be kept.
    pub fn recorded(&self, kept: bool) {
        let outcome = if kept { "kept" } else { "dropped" };
        self.recorded
            .get_or_create(&label("outcome", outcome))
            .inc();
    }

    /// Counts what was found.
    ///
    /// - `took`: from the arrival of the request
    pub fn found(&self, prediction: &Prediction, took: Duration) {
        self.took.observe(took.as_secs_f64());
        let t = &prediction.timings;
        for (stage, ms) in [
            ("prepare", t.prepare),
            ("features", t.features),
            ("detect", t.detect),
            ("crop", t.crop),
            ("propose", t.propose),
            ("refine", t.refine),
            ("check", t.check),
            ("total", t.total),
        ] {
            self.stages
                .get_or_create(&label("stage", stage))
                .observe(ms / 1e3);
        }
        for object in &prediction.objects {
            let class = label("class", object.class.clone());
            self.objects.get_or_create(&class).inc();
            if let Some(confidence) = object.confidence {
                self.confidences.get_or_create(&class).observe(confidence);
            }
        }
        for warning in &prediction.warnings {
            let code = serde_json::to_value(warning.code).unwrap_or_default();
            let code = code.as_str().unwrap_or_default();
            self.warnings.get_or_create(&label("code", code)).inc();
        }
    }

    /// The text that Prometheus reads.
    pub fn text(&self, queue_length: usize, streams: usize, ready: bool) -> String {
        self.queue.set(queue_length as f64);
        self.streams.set(streams as f64);
        self.ready.set(f64::from(u8::from(ready)));
        let mut text = String::new();
        // Writing to a text does not fail.
        let _ = encode(&mut text, &self.registry);
        text
    }
}
