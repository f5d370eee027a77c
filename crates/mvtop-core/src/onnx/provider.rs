//! Execution providers: the parts of ONNX Runtime that run a graph on some hardware.

use crate::{Error, Result};
use ort::ep::{self, ArbitrarilyConfigurableExecutionProvider, ExecutionProvider};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// What runs the graphs. Nodes that a provider cannot take stay on the processor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Provider {
    /// ONNX Runtime's own kernels, in every library.
    #[default]
    Cpu,
    /// NVIDIA GPUs (`pip install onnxruntime-gpu`).
    Cuda,
    /// NVIDIA GPUs by TensorRT (`pip install onnxruntime-gpu`).
    Tensorrt,
    /// Intel processors (`pip install onnxruntime-openvino`), for what images are shown to; the decoder
    /// stays on ONNX Runtime's own kernels, as 1.24 does not take one that mvtop's operator cuts in
    /// pieces.
    Openvino,
    /// The same, computing in bfloat16: faster where the processor has it, and less exact. A decoder in
    /// it would place objects 3 mm off.
    OpenvinoBf16,
    /// Apple processors, in the macOS library.
    Coreml,
    /// Arm and x86 processors, in libraries built with it.
    Xnnpack,
}

impl Provider {
    /// Every provider, the default first.
    pub const ALL: [Self; 7] = [
        Self::Cpu,
        Self::Cuda,
        Self::Tensorrt,
        Self::Openvino,
        Self::OpenvinoBf16,
        Self::Coreml,
        Self::Xnnpack,
    ];

    /// The name that [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Cuda => "cuda",
            Self::Tensorrt => "tensorrt",
            Self::Openvino => "openvino",
            Self::OpenvinoBf16 => "openvino-bf16",
            Self::Coreml => "coreml",
            Self::Xnnpack => "xnnpack",
        }
    }

    /// Whether the loaded library was built with this provider. Its hardware or its own libraries
    /// may still be missing, which only shows when a network is loaded.
    pub(super) fn is_built_in(self) -> bool {
        let available = match self {
            Self::Cpu => return true,
            Self::Cuda => ep::CUDA::is_available(),
            Self::Tensorrt => ep::TensorRT::is_available(),
            Self::Openvino | Self::OpenvinoBf16 => ep::OpenVINO::is_available(),
            Self::Coreml => ep::CoreML::is_available(),
            Self::Xnnpack => ep::XNNPACK::is_available(),
        };
        available.unwrap_or(false)
    }

    /// What runs the decoder where this runs the other graphs.
    pub(crate) fn of_decoder(self) -> Self {
        match self {
            Self::Openvino | Self::OpenvinoBf16 => Self::Cpu,
            other => other,
        }
    }

    /// What graphs it takes, if not all; to be said with the end of what it says itself, which is pages
    /// long.
    pub(super) fn takes(self) -> Option<&'static str> {
        match self {
            Self::Openvino | Self::OpenvinoBf16 => Some(
                "OpenVINO wants graphs that state the shape of what mvtop's operator gives, which bundles \
                 in integers did not before 25 November 2026; export it again, or use `cpu`",
            ),
            _ => None,
        }
    }

    /// The registration for a session; none for the processor, which is always there.
    pub(super) fn registration(self, threads: usize) -> Option<ep::ExecutionProviderDispatch> {
        let registration = match self {
            Self::Cpu => return None,
            Self::Cuda => ep::CUDA::default().build(),
            Self::Tensorrt => ep::TensorRT::default().build(),
            Self::Openvino => openvino("f32", threads),
            Self::OpenvinoBf16 => openvino("bf16", threads),
            Self::Coreml => ep::CoreML::default().build(),
            Self::Xnnpack => ep::XNNPACK::default().build(),
        };
        // Otherwise a provider that fails to start would leave everything to the processor.
        Some(registration.error_on_failure())
    }
}

fn openvino(precision: &str, threads: usize) -> ep::ExecutionProviderDispatch {
    let mut settings =
        serde_json::json!({ "INFERENCE_PRECISION_HINT": precision, "ENABLE_CPU_PINNING": "NO" });
    if threads > 0 {
        settings["INFERENCE_NUM_THREADS"] = threads.to_string().into();
    }
    ep::OpenVINO::default()
        .with_device_type("CPU")
        .with_arbitrary_config("load_config", serde_json::json!({ "CPU": settings }))
        .build()
}

impl fmt::Display for Provider {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Provider {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|p| p.name() == name);
        found.ok_or_else(|| Error::Provider {
            provider: name.to_owned(),
            problem: format!("expected one of {}", Self::ALL.map(Self::name).join(", ")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_provider_is_read_back_from_its_name() {
        for provider in Provider::ALL {
            assert_eq!(provider.name().parse::<Provider>().unwrap(), provider);
            let json = serde_json::to_string(&provider).unwrap();
            assert_eq!(json, format!("\"{provider}\""));
        }
    }

    #[test]
    fn decoders_are_run_by_what_takes_our_operator() {
        let elsewhere = [Provider::Openvino, Provider::OpenvinoBf16];
        for provider in Provider::ALL {
            let expected = match elsewhere.contains(&provider) {
                true => Provider::Cpu,
                false => provider,
            };
            assert_eq!(provider.of_decoder(), expected);
        }
    }

    #[test]
    fn an_unknown_provider_is_refused_with_the_known_ones() {
        let error = "gpu".parse::<Provider>().unwrap_err().to_string();
        assert!(
            error.contains("`gpu`") && error.contains("openvino-bf16"),
            "{error}"
        );
    }
}
