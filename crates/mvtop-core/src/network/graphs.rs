//! The network as the graphs of a bundle, run by ONNX Runtime.

use ndarray::{Array3, Array4, ArrayView3, ArrayView4};

use super::{Decoded, DetectorMaps, Hypotheses, Network, Queries, without};
use crate::bundle::Bundle;
use crate::onnx::{Outputs, Port, Runtime, Session, SessionOptions};
use crate::{Result, cancel};

/// The graphs of a bundle in ONNX Runtime.
pub(crate) struct OnnxNetwork {
    /// On whole images.
    features: Session,
    closeup: Session,
    /// `None` where `closeup` gives object coordinates.
    decoder: Option<Session>,
    /// Whether `decoder` gives several poses of each object.
    hypotheses: bool,
    provider: String,
}

impl OnnxNetwork {
    /// # Errors
    /// Those of [`Runtime::session`], and [`Error::Network`] where a graph does not fit the bundle.
    pub fn load(runtime: &Runtime, bundle: &Bundle, options: &SessionOptions) -> Result<Self> {
        let of_decoder = SessionOptions {
            provider: options.provider.of_decoder(),
            ..options.clone()
        };
        let cancel = cancel::current();
        let session = |graph, options| cancel.scope(|| runtime.session(graph, options));
        // The decoder takes as long as the other two.
        let (decoder, (features, closeup)) = rayon::join(
            || {
                bundle
                    .decoder
                    .as_ref()
                    .map(|graph| session(graph, &of_decoder))
            },
            || {
                rayon::join(
                    || session(&bundle.features, options),
                    || session(&bundle.closeups.graph, options),
                )
            },
        );
        let decoder = decoder.transpose()?;
        let outputs = decoder.iter().flat_map(Session::outputs);
        let network = Self {
            hypotheses: outputs.into_iter().any(|x| x == "hypotheses_score"),
            features: features?,
            closeup: closeup?,
            decoder,
            provider: options.provider.to_string(),
        };
        network.check(bundle)?;
        Ok(network)
    }

    /// Refuses graphs with other inputs and outputs than the bundle says.
    fn check(&self, bundle: &Bundle) -> Result<()> {
        let any = None;
        let (width, height) = (bundle.input.width as usize, bundle.input.height as usize);
        let images = [any, Some(3), Some(height), Some(width)];
        let rays = [any, any, Some(3)];
        let scores = [any, Some(bundle.classes.len()), any, any];
        let boxes = [any, Some(4), any, any];
        let memory = [any; 3];
        let encoded = [any, any, Some(bundle.los_encoding.width())];
        let port = |name, shape: &[Option<usize>]| Port {
            name,
            shape: shape.to_vec(),
            whole: false,
        };
        let pictures =
            |shape: &[Option<usize>]| [port("images", shape), port("camera_rays", &rays)];
        let maps = [port("det_scores", &scores), port("det_boxes", &boxes)];
        self.features.check(&pictures(&images)[..1], &maps)?;
        let side = Some(bundle.closeups.size as usize);
        let pictures = pictures(&[any, Some(3), side, side]);
        let Some(decoder) = &self.decoder else {
            let coordinates = port("coordinates", &boxes);
            return self.closeup.check(&pictures[..1], &[coordinates]);
        };
        self.closeup.check(&pictures, &[port("memory", &memory)])?;
        let [pair, dozen] = [2, 12].map(|length| [any, any, Some(length)]);
        let inputs = [
            port("memory", &memory),
            port("rays", &encoded),
            port("centers", &pair),
            port("half_sizes", &pair),
            port("box_rays", &dozen),
            port("valid", &[any, any]),
            Port {
                name: "class_index",
                shape: vec![any],
                whole: true,
            },
        ];
        let outputs = [
            port("rotation_6d", &[any, Some(6)]),
            port("translation", &[any, Some(3)]),
            port("sigma", &[any, Some(2)]),
        ];
        decoder.check(&inputs, &outputs)
    }
}

impl Network for OnnxNetwork {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        let mut outputs = self.features.run(&[("images", images.into())])?;
        DetectorMaps::take(&mut outputs)
    }

    fn encode(
        &self,
        pictures: ArrayView4<f32>,
        camera_rays: ArrayView3<f32>,
    ) -> Result<Array3<f32>> {
        let inputs = [
            ("images", pictures.into()),
            ("camera_rays", camera_rays.into()),
        ];
        self.closeup.run(&inputs)?.take("memory")
    }

    fn coordinates(&self, pictures: ArrayView4<f32>) -> Result<Array4<f32>> {
        let inputs = [("images", pictures.into())];
        self.closeup.run(&inputs)?.take("coordinates")
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        let decoder = self.decoder.as_ref().ok_or_else(|| without("decoder"))?;
        let mut outputs = decoder.run(&[
            ("memory", memory.into()),
            ("rays", queries.rays.view().into()),
            ("centers", queries.centers.view().into()),
            ("half_sizes", queries.half_sizes.view().into()),
            ("box_rays", queries.box_rays.view().into()),
            ("valid", queries.valid.view().into()),
            ("class_index", queries.class_index.view().into()),
        ])?;
        Ok(Decoded {
            rotation_6d: outputs.take("rotation_6d")?,
            translation: outputs.take("translation")?,
            sigma: outputs.take("sigma")?,
            hypotheses: self
                .hypotheses
                .then(|| Hypotheses::take(&mut outputs))
                .transpose()?,
        })
    }

    fn takes_any_size(&self) -> bool {
        self.features.leaves_open("images", &[2, 3])
    }

    fn provider(&self) -> &str {
        &self.provider
    }
}

impl DetectorMaps {
    fn take(outputs: &mut Outputs) -> Result<Self> {
        Ok(Self {
            scores: outputs.take("det_scores")?,
            boxes: outputs.take("det_boxes")?,
        })
    }
}

impl Hypotheses {
    fn take(outputs: &mut Outputs) -> Result<Self> {
        Ok(Self {
            rotation_6d: outputs.take("hypotheses_rotation_6d")?,
            translation: outputs.take("hypotheses_translation")?,
            sigma: outputs.take("hypotheses_sigma")?,
            score: outputs.take("hypotheses_score")?,
        })
    }
}
