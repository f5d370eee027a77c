//! Normalised cross-correlation (NCC) of the surface's colors with the images. It measures the angle
//! of a round part about its axis, which no edge shows.

use nalgebra::{Isometry3, Matrix6, Point2, Point3, Vector2};

use super::config::TextureConfig;
use super::crop_pixels::{ColorDescriptor, box_blur, descriptor};
use super::revolution_axis::RevolutionAxis;
use super::view_state::ViewState;
use crate::bundle::SurfacePoint;

/// Subsampling of the pixels in the first pass, along each axis.
const SUBSAMPLING: usize = 2;
/// Least number of visible points of a correlation.
const MIN_POINTS: usize = 30;

/// Texture of a part.
pub struct Texture {
    /// Object frame, metres.
    points: Vec<Point3<f64>>,
    /// Descriptor of each point: blurred, and sharp.
    descriptors: [Vec<ColorDescriptor>; 2],
    /// Whether each channel varies over the part.
    active: [bool; 3],
    /// `None` of a part that is not round.
    axis: Option<RevolutionAxis>,
    diameter: f64,
}

/// A view with blurred descriptors.
struct BlurredView<'a> {
    view: &'a ViewState<'a>,
    /// One for each square of `every` pixels a side.
    descriptors: Vec<ColorDescriptor>,
    every: usize,
}

impl Texture {
    /// `None` if the colors do not vary over the part.
    ///
    /// - `center`: middle of its box, object frame, metres
    /// - `diameter`: largest distance between two points, metres
    pub fn new(
        points: &[SurfacePoint],
        center: Point3<f64>,
        diameter: f64,
        config: &TextureConfig,
    ) -> Option<Self> {
        let descriptor = |point: &SurfacePoint| descriptor(point.color.map(f32::from));
        let (points, sharp): (Vec<_>, Vec<_>) = points
            .iter()
            .filter_map(|point| Some((Point3::from(point.position), descriptor(point)?)))
            .unzip();
        let axis = RevolutionAxis::fit(&points, center, config.max_unevenness * diameter);
        let radius = (config.blur[0] * diameter).powi(2);
        let blurred = |point: &Point3<f64>| {
            let near = points.iter().zip(&sharp);
            let near = near.filter(|(other, _)| (*other - point).norm_squared() <= radius);
            mean(near.map(|(_, descriptor)| descriptor))
        };
        let blurred: Vec<ColorDescriptor> = points.iter().map(blurred).collect();
        let middle = mean(blurred.iter());
        let active = [0, 1, 2].map(|i| {
            let squares = blurred.iter().map(|one| (one[i] - middle[i]).powi(2));
            (squares.sum::<f32>() / blurred.len().max(1) as f32).sqrt() > config.contrast[i]
        });
        active.contains(&true).then_some(Self {
            points,
            descriptors: [blurred, sharp],
            active,
            axis,
            diameter,
        })
    }

    /// Whether the part is round.
    #[cfg(test)]
    pub fn is_round(&self) -> bool {
        self.axis.is_some()
    }

    /// The pose of a round part, rotated about its axis to the largest correlation, with the
    /// information about the angle: inverse covariance of rotation (radians) and translation, world
    /// frame. `None` if the correlation has no distinct maximum.
    ///
    /// - `views`: with the mesh rendered at the pose
    pub fn aligned(
        &self,
        views: &[ViewState],
        pose: &Isometry3<f64>,
    ) -> Option<(Isometry3<f64>, Matrix6<f64>)> {
        let (axis, config) = (self.axis?, &views.first()?.refiner.config.texture);
        let mut at = 0.0;
        for (pass, every) in [SUBSAMPLING, 1].into_iter().enumerate() {
            let blur = config.blur[pass] * self.diameter;
            let blurred = views.iter().map(|view| BlurredView::new(view, every, blur));
            let blurred: Vec<BlurredView> = blurred.collect();
            let [reach, step] = config.search_deg[pass];
            let count = (reach / step).round() as i32;
            let angle = |n: i32| at + (f64::from(n) * step).to_radians();
            let ncc = |n: i32| {
                let pose = pose * axis.rotation(angle(n));
                self.correlation(pass, &blurred, &pose, Vector2::zeros())
            };
            let all: Vec<f64> = (-count..=count).map(ncc).collect::<Option<_>>()?;
            let best = (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b]))?;
            if best == 0 || best + 1 == all.len() || all[best] < config.min_correlation {
                return None;
            }
            // Maximum of the parabola through the best angle and its neighbours.
            let [before, here, after] = [all[best - 1], all[best], all[best + 1]];
            let bend = before - 2.0 * here + after;
            let beside = match bend < 0.0 {
                true => 0.5 * (before - after) / bend,
                false => 0.0,
            };
            at = angle(best as i32 - count) + (beside * step).to_radians();
        }
        let pose = pose * axis.rotation(at);
        let along = pose * axis.along.into_inner();
        let sigma = config.search_deg[1][0].to_radians() / 2.0;
        let mut information = Matrix6::zeros();
        information
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(along * along.transpose() * sigma.powi(-2)));
        Some((pose, information))
    }

    /// Correlation with a view, and its gain over the mean correlation of the same points displaced
    /// up, down, left and right in the image; `None` if too few of them are visible.
    ///
    /// - `view`: with the mesh rendered at the pose
    pub fn evidence(&self, view: &ViewState, pose: &Isometry3<f64>) -> [Option<f64>; 2] {
        let config = &view.refiner.config;
        let blurred = BlurredView::new(view, SUBSAMPLING, config.texture.blur[0] * self.diameter);
        let views = [blurred];
        let ncc = |shift| self.correlation(0, &views, pose, shift);
        let camera = &view.closeup.camera;
        let center = camera.world_from_cam().inv_mul(pose) * view.refiner.mesh.center;
        let diameter_px = self.diameter * camera.intrinsics().fx() / center.z;
        let by = config.texture.displacement * diameter_px;
        let beside = [[by, 0.0], [-by, 0.0], [0.0, by], [0.0, -by]].map(Vector2::from);
        let beside: Vec<f64> = beside.into_iter().filter_map(ncc).collect();
        let here = ncc(Vector2::zeros());
        let gain = here.filter(|_| !beside.is_empty());
        let gain = gain.map(|here| here - beside.iter().sum::<f64>() / beside.len() as f64);
        [here, gain]
    }

    /// Mean correlation over active channels and views, by their visible points; `None` if no view
    /// shows enough of them.
    ///
    /// - `pass`: 0 for blurred, 1 for sharp descriptors of the points
    /// - `shift`: displacement of the points in the crops, px
    fn correlation(
        &self,
        pass: usize,
        views: &[BlurredView],
        pose: &Isometry3<f64>,
        shift: Vector2<f64>,
    ) -> Option<f64> {
        let (mut sum, mut all) = (0.0, 0.0);
        for view in views {
            let pairs = self.pairs(pass, view, pose, shift);
            if pairs.len() < MIN_POINTS {
                continue;
            }
            for i in (0..3).filter(|&i| self.active[i]) {
                sum += pairs.len() as f64 * pearson(&pairs, i);
                all += pairs.len() as f64;
            }
        }
        (all > 0.0).then(|| sum / all)
    }

    /// Descriptors of each visible point: on the surface, and in the image.
    fn pairs(
        &self,
        pass: usize,
        blurred: &BlurredView,
        pose: &Isometry3<f64>,
        shift: Vector2<f64>,
    ) -> Vec<[ColorDescriptor; 2]> {
        let ViewState {
            closeup,
            raster,
            refiner,
            ..
        } = blurred.view;
        let camera = &closeup.camera;
        let tolerance = refiner.config.occlusion_tolerance[2] * self.diameter;
        let cam_from_obj = camera.world_from_cam().inv_mul(pose);
        let pair = |(point, descriptor): (&Point3<f64>, &ColorDescriptor)| {
            let point = cam_from_obj * point;
            let pixel = camera.intrinsics().project(&point)?;
            let visible = point.z < raster.depth(raster.index(pixel)?) + tolerance;
            let seen = blurred.at(pixel + shift)?;
            (visible && seen[0].is_finite()).then_some([*descriptor, seen])
        };
        let points = self.points.iter().zip(&self.descriptors[pass]);
        points.filter_map(pair).collect()
    }
}

impl<'a> BlurredView<'a> {
    /// - `every`: subsampling along each axis
    /// - `blur`: on the object, metres
    fn new(view: &'a ViewState<'a>, every: usize, blur: f64) -> Self {
        let camera = &view.closeup.camera;
        let size = (camera.width() as usize).div_ceil(every);
        let half = blur * camera.intrinsics().fx() / view.raster.nearest() / every as f64;
        let half = (half.round() as usize).min(size / 4);
        let descriptors = view.pixels.descriptors(every);
        Self {
            view,
            descriptors: box_blur(&descriptors, size, half),
            every,
        }
    }

    /// Descriptor around a place; `None` outside the crop.
    fn at(&self, pixel: Point2<f64>) -> Option<ColorDescriptor> {
        let (index, size) = (self.view.raster.index(pixel)?, self.view.raster.size);
        let [row, column] = [index / size, index % size].map(|x| x / self.every);
        Some(self.descriptors[row * size.div_ceil(self.every) + column])
    }
}

fn mean<'a>(descriptors: impl Iterator<Item = &'a ColorDescriptor>) -> ColorDescriptor {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for one in descriptors {
        sum.iter_mut().zip(one).for_each(|(sum, x)| *sum += x);
        count += 1.0;
    }
    sum.map(|x| x / count)
}

/// Pearson's correlation in one channel; 0 without contrast.
fn pearson(pairs: &[[ColorDescriptor; 2]], i: usize) -> f64 {
    let count = pairs.len() as f64;
    let mut sums = [0.0; 5];
    for [a, b] in pairs {
        let (a, b) = (f64::from(a[i]), f64::from(b[i]));
        let terms = [a, b, a * a, b * b, a * b];
        sums.iter_mut().zip(terms).for_each(|(sum, x)| *sum += x);
    }
    let [a, b, aa, bb, ab] = sums.map(|sum| sum / count);
    let spread = ((aa - a * a).max(0.0) * (bb - b * b).max(0.0)).sqrt();
    if spread > 1e-9 {
        (ab - a * b) / spread
    } else {
        0.0
    }
}
