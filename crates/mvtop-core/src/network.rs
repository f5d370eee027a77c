//! The network's two halves as the estimator sees them: images to features, queries to poses.

use ndarray::{Array1, Array2, Array3, Array4, ArrayView3};

use crate::bundle::Bundle;
use crate::onnx::{self, Runtime, SessionOptions};
use crate::{Error, Result};

/// What runs the network. [`crate::Estimator`] needs no more of it than this.
pub trait Network: Send + Sync {
    /// The backbone and detector, once for all whole images together; the encoder, too, where poses
    /// are decoded from these.
    ///
    /// - `images`: `[V, 3, Hn, Wn]`, normalised
    /// - `camera_rays`: `[V, N, 3]`, from [`crate::rays::camera_rays`]
    fn features(&self, images: Array4<f32>, camera_rays: Array3<f32>) -> Result<Features>;

    /// The backbone and encoder, once for all close-ups together, of bundles that have them.
    ///
    /// - `pictures`: `[P, 3, size, size]`, from [`crate::closeup::CloseUp::picture`]
    /// - `camera_rays`: `[P, N, 3]`, from [`crate::closeup::CloseUp::camera_rays`]
    /// - returns: memory, `[P, N, C]`
    fn closeups(&self, pictures: Array4<f32>, camera_rays: Array3<f32>) -> Result<Array3<f32>>;

    /// The pose decoder, for objects that share an anchor: the view that comes first.
    ///
    /// - `memory`: `[V, N, C]`
    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded>;

    /// What executes the dense layers, for example `cpu`.
    fn provider(&self) -> &str;
}

/// What is known of the views before any object is.
#[derive(Debug, Clone)]
pub struct Features {
    /// `[V, N, C]`; `None` where poses are decoded from close-ups
    pub memory: Option<Array3<f32>>,
    /// `[V, classes, h, w]`, 0 to 1, per cell of the finest level
    pub det_scores: Array4<f32>,
    /// `[V, 4, h, w]`, x0 y0 x1 y1, px of the network's input
    pub det_boxes: Array4<f32>,
}

/// Objects to decode and where each view sees them; everything in the frame of view 0.
#[derive(Debug, Clone)]
pub struct Queries {
    /// `[V, N, R]`, from [`crate::rays::encode`]
    pub rays: Array3<f32>,
    /// `[V, Q, 2]`, box centers over the network's input, 0 to 1; 0.5 where not detected
    pub centers: Array3<f32>,
    /// `[V, Q, 2]`, half the boxes' sides over the input's; 0 where not detected
    pub half_sizes: Array3<f32>,
    /// `[V, Q, 12]`, from [`crate::rays::box_rays`]; 0 where not detected
    pub box_rays: Array3<f32>,
    /// `[V, Q]`, 1 where detected, else 0
    pub valid: Array2<f32>,
    /// `[Q]`, indices into the bundle's classes
    pub class_index: Array1<i64>,
}

/// Poses in the frame of view 0.
#[derive(Debug, Clone)]
pub struct Decoded {
    /// `[Q, 6]`, for [`crate::pose::rotation_from_6d`]
    pub rotation_6d: Array2<f32>,
    /// `[Q, 3]`, metres
    pub translation: Array2<f32>,
    /// `[Q, 2]`, expected rotation error in degrees, standard deviation of the translation in metres
    pub sigma: Array2<f32>,
}

impl Features {
    /// Refuses maps that belong to other views or classes.
    pub(crate) fn check(&self, views: usize, classes: usize) -> Result<()> {
        let (scores, boxes) = (self.det_scores.shape(), self.det_boxes.shape());
        let cells = &scores[2..];
        if let Some(memory) = &self.memory {
            let memory = memory.shape();
            expect("memory", memory, &[views, memory[1], memory[2]])?;
        }
        expect("det_scores", scores, &[views, classes, cells[0], cells[1]])?;
        expect("det_boxes", boxes, &[views, 4, cells[0], cells[1]])
    }
}

impl Decoded {
    /// Refuses poses of another number of objects.
    pub(crate) fn check(&self, queries: usize) -> Result<()> {
        expect("rotation_6d", self.rotation_6d.shape(), &[queries, 6])?;
        expect("translation", self.translation.shape(), &[queries, 3])?;
        expect("sigma", self.sigma.shape(), &[queries, 2])
    }
}

fn expect(name: &'static str, got: &[usize], expected: &[usize]) -> Result<()> {
    if got == expected {
        return Ok(());
    }
    Err(Error::Shape {
        name,
        expected: format!("{expected:?}"),
        got: got.to_vec(),
    })
}

/// The graphs of a bundle in ONNX Runtime.
pub struct OnnxNetwork {
    features: onnx::Network,
    closeup: Option<onnx::Network>,
    decoder: onnx::Network,
    provider: String,
}

impl OnnxNetwork {
    /// # Errors
    /// Those of [`Runtime::session`].
    pub fn load(runtime: &Runtime, bundle: &Bundle, options: &SessionOptions) -> Result<Self> {
        Ok(Self {
            features: runtime.session(&bundle.features, options)?,
            closeup: match &bundle.closeup {
                Some(closeup) => Some(runtime.session(&closeup.graph, options)?),
                None => None,
            },
            decoder: runtime.session(&bundle.decoder, options)?,
            provider: options.provider.to_string(),
        })
    }
}

impl Network for OnnxNetwork {
    fn features(&self, images: Array4<f32>, camera_rays: Array3<f32>) -> Result<Features> {
        let mut outputs = self.features.run(&[
            ("images", images.view().into()),
            ("camera_rays", camera_rays.view().into()),
        ])?;
        Ok(Features {
            memory: match self.closeup {
                Some(_) => None,
                None => Some(outputs.take("memory")?),
            },
            det_scores: outputs.take("det_scores")?,
            det_boxes: outputs.take("det_boxes")?,
        })
    }

    fn closeups(&self, pictures: Array4<f32>, camera_rays: Array3<f32>) -> Result<Array3<f32>> {
        let Some(closeup) = &self.closeup else {
            return Err(Error::Input(
                "the bundle has no network for close-ups".into(),
            ));
        };
        let mut outputs = closeup.run(&[
            ("images", pictures.view().into()),
            ("camera_rays", camera_rays.view().into()),
        ])?;
        outputs.take("memory")
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        let mut outputs = self.decoder.run(&[
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
        })
    }

    fn provider(&self) -> &str {
        &self.provider
    }
}
