//! A network that does not compute again what it has computed of a picture.

use std::sync::{Mutex, PoisonError};

use ndarray::{
    Array2, Array3, Array4, ArrayD, ArrayView3, ArrayView4, ArrayViewD, Axis, Dimension, stack,
};

use super::{Decoded, DetectorMaps, Network, Queries};
use crate::{Error, Result};

/// What a network said of the pictures that it was last shown.
#[derive(Default)]
pub struct Answers {
    detector: Mutex<Vec<Answer>>,
    encoder: Mutex<Vec<Answer>>,
    coordinates: Mutex<Vec<Answer>>,
}

/// What a graph said of one picture.
struct Answer {
    /// `[3, H, W]`
    picture: Array3<f32>,
    /// `[N, 3]`; none where the graph takes none.
    rays: Array2<f32>,
    outputs: Vec<ArrayD<f32>>,
    /// Since [`Answers::forget_unused`] was last called.
    used: bool,
}

/// `network`, which is asked only for pictures that differ in any number from those in `answers`:
/// so nothing can be out of date.
///
/// Of each picture it says the same whatever others are run with it, so all that is left to rounding
/// is how ONNX Runtime divides work among threads.
pub struct Cached<'a> {
    pub network: &'a dyn Network,
    pub answers: &'a Answers,
}

impl Answers {
    /// Forgets the pictures that were not asked for since it was last called.
    pub fn forget_unused(&self) {
        for table in [&self.detector, &self.encoder, &self.coordinates] {
            let mut table = table.lock().unwrap_or_else(PoisonError::into_inner);
            table.retain_mut(|answer| std::mem::take(&mut answer.used));
        }
    }
}

/// The outputs of a graph, each `[P, ...]`, which `run` computes of the pictures not in `table`.
///
/// - `pictures`: `[P, 3, H, W]`
/// - `rays`: `[P, N, 3]`
fn looked_up(
    table: &Mutex<Vec<Answer>>,
    pictures: ArrayView4<f32>,
    rays: ArrayView3<f32>,
    run: impl FnOnce(ArrayView4<f32>, ArrayView3<f32>) -> Result<Vec<ArrayD<f32>>>,
) -> Result<Vec<ArrayD<f32>>> {
    let mut table = table.lock().unwrap_or_else(PoisonError::into_inner);
    let asked = || pictures.outer_iter().zip(rays.outer_iter());
    let mut places: Vec<Option<usize>> = asked()
        .map(|(picture, rays)| {
            let same = |answer: &Answer| answer.picture == picture && answer.rays == rays;
            table.iter().position(same)
        })
        .collect();
    let new: Vec<usize> = (0..places.len()).filter(|&p| places[p].is_none()).collect();
    if !new.is_empty() || places.is_empty() {
        let (pictures, rays) = (pictures.select(Axis(0), &new), rays.select(Axis(0), &new));
        let outputs = run(pictures.view(), rays.view())?;
        let unlike = |output: &&ArrayD<f32>| output.shape().first() != Some(&new.len());
        if let Some(output) = outputs.iter().find(unlike) {
            return Err(Error::Shape {
                name: "output of the network",
                expected: format!("{} pictures", new.len()),
                got: output.shape().to_vec(),
            });
        }
        if places.is_empty() {
            return Ok(outputs);
        }
        for (row, &place) in new.iter().enumerate() {
            places[place] = Some(table.len());
            let of_picture = |output: &ArrayD<f32>| output.index_axis(Axis(0), row).to_owned();
            table.push(Answer {
                picture: pictures.index_axis(Axis(0), row).to_owned(),
                rays: rays.index_axis(Axis(0), row).to_owned(),
                outputs: outputs.iter().map(of_picture).collect(),
                used: true,
            });
        }
    }
    let places: Vec<usize> = places.into_iter().flatten().collect();
    for &place in &places {
        table[place].used = true;
    }
    let output = |n: usize| {
        let rows: Vec<ArrayViewD<f32>> = places
            .iter()
            .map(|&place| table[place].outputs[n].view())
            .collect();
        stack(Axis(0), &rows).map_err(|cause| Error::Shape {
            name: "output of the network",
            expected: format!("alike for all pictures ({cause})"),
            got: rows[0].shape().to_vec(),
        })
    };
    (0..table[places[0]].outputs.len()).map(output).collect()
}

/// The next output, with its number of axes.
fn next<D: Dimension>(
    outputs: &mut impl Iterator<Item = ArrayD<f32>>,
) -> Result<ndarray::Array<f32, D>> {
    let output = outputs.next().unwrap_or_default();
    let got = output.shape().to_vec();
    output.into_dimensionality().map_err(|cause| Error::Shape {
        name: "output of the network",
        expected: cause.to_string(),
        got,
    })
}

impl Network for Cached<'_> {
    fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
        let no_rays = Array3::zeros((images.dim().0, 0, 3));
        let run = |images: ArrayView4<f32>, _: ArrayView3<f32>| {
            let maps = self.network.detect(images)?;
            Ok(vec![maps.scores.into_dyn(), maps.boxes.into_dyn()])
        };
        let outputs = looked_up(&self.answers.detector, images, no_rays.view(), run)?;
        let mut outputs = outputs.into_iter();
        Ok(DetectorMaps {
            scores: next(&mut outputs)?,
            boxes: next(&mut outputs)?,
        })
    }

    fn encode(
        &self,
        pictures: ArrayView4<f32>,
        camera_rays: ArrayView3<f32>,
    ) -> Result<Array3<f32>> {
        let run = |pictures: ArrayView4<f32>, rays: ArrayView3<f32>| {
            Ok(vec![self.network.encode(pictures, rays)?.into_dyn()])
        };
        let outputs = looked_up(&self.answers.encoder, pictures, camera_rays, run)?;
        next(&mut outputs.into_iter())
    }

    fn coordinates(&self, pictures: ArrayView4<f32>) -> Result<Array4<f32>> {
        let no_rays = Array3::zeros((pictures.dim().0, 0, 3));
        let run = |pictures: ArrayView4<f32>, _: ArrayView3<f32>| {
            Ok(vec![self.network.coordinates(pictures)?.into_dyn()])
        };
        let table = &self.answers.coordinates;
        let outputs = looked_up(table, pictures, no_rays.view(), run)?;
        next(&mut outputs.into_iter())
    }

    fn decode(&self, memory: ArrayView3<f32>, queries: &Queries) -> Result<Decoded> {
        self.network.decode(memory, queries)
    }

    fn takes_any_size(&self) -> bool {
        self.network.takes_any_size()
    }

    fn provider(&self) -> &str {
        self.network.provider()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use ndarray::{Array4, s};

    use super::*;

    /// Says of a picture what is in its first pixel, and counts the pictures it was shown.
    #[derive(Default)]
    struct Counting(AtomicUsize);

    impl Network for Counting {
        fn detect(&self, images: ArrayView4<f32>) -> Result<DetectorMaps> {
            self.0.fetch_add(images.dim().0, Ordering::Relaxed);
            Ok(DetectorMaps {
                scores: images.slice(s![.., ..1, ..1, ..1]).to_owned(),
                boxes: images.to_owned(),
            })
        }

        fn encode(
            &self,
            pictures: ArrayView4<f32>,
            camera_rays: ArrayView3<f32>,
        ) -> Result<Array3<f32>> {
            self.0.fetch_add(pictures.dim().0, Ordering::Relaxed);
            Ok(&camera_rays + &pictures.slice(s![.., ..1, 0, ..1]))
        }

        fn coordinates(&self, pictures: ArrayView4<f32>) -> Result<Array4<f32>> {
            self.0.fetch_add(pictures.dim().0, Ordering::Relaxed);
            Ok(pictures.to_owned())
        }

        fn provider(&self) -> &str {
            "counting"
        }
    }

    fn pictures(values: &[f32]) -> Array4<f32> {
        Array4::from_shape_fn((values.len(), 3, 2, 2), |(p, ..)| values[p])
    }

    #[test]
    fn only_new_pictures_are_shown_and_answers_keep_their_order() {
        let (network, answers) = (Counting::default(), Answers::default());
        let cached = Cached {
            network: &network,
            answers: &answers,
        };
        let shown = |values: &[f32]| {
            let before = network.0.load(Ordering::Relaxed);
            let maps = cached.detect(pictures(values).view()).unwrap();
            assert_eq!(maps.boxes, pictures(values));
            assert_eq!(maps.scores.iter().copied().collect::<Vec<_>>(), values);
            network.0.load(Ordering::Relaxed) - before
        };
        assert_eq!(shown(&[1.0, 2.0]), 2);
        assert_eq!(shown(&[3.0, 1.0, 2.0]), 1);
        assert_eq!(shown(&[2.0, 3.0]), 0);
        answers.forget_unused();
        assert_eq!(shown(&[2.0]), 0);
        answers.forget_unused();
        // Not asked for since.
        assert_eq!(shown(&[1.0, 2.0, 3.0]), 2);
    }

    #[test]
    fn coordinates_of_a_known_picture_are_not_computed_again() {
        let (network, answers) = (Counting::default(), Answers::default());
        let cached = Cached {
            network: &network,
            answers: &answers,
        };
        for (values, count) in [(&[1.0, 2.0], 2), (&[2.0, 1.0], 2), (&[3.0, 2.0], 3)] {
            let given = pictures(values);
            assert_eq!(cached.coordinates(given.view()).unwrap(), given);
            assert_eq!(network.0.load(Ordering::Relaxed), count);
        }
    }

    #[test]
    fn a_picture_with_other_rays_is_another() {
        let (network, answers) = (Counting::default(), Answers::default());
        let cached = Cached {
            network: &network,
            answers: &answers,
        };
        let picture = pictures(&[1.0]);
        for (rays, count) in [(0.0, 1), (0.0, 1), (0.5, 2)] {
            let rays = Array3::from_elem((1, 4, 3), rays);
            let expected = &rays + 1.0;
            let encoded = cached.encode(picture.view(), rays.view()).unwrap();
            assert_eq!(encoded, expected);
            assert_eq!(network.0.load(Ordering::Relaxed), count);
        }
    }
}
