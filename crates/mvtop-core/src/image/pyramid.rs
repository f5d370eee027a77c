//! An image at full, half, quarter size and so on.

use std::sync::OnceLock;

use image::RgbImage;

/// Smaller images, each half as large as the one before.
const SMALLER: usize = 5;

/// An image and smaller ones of it, each made when it is first read.
///
/// A pixel of a smaller image is the mean of four of the next larger one. So whoever shows a large
/// image small reads about as many pixels as it shows.
#[derive(Debug)]
pub struct Pyramid<'a> {
    image: &'a RgbImage,
    smaller: [OnceLock<RgbImage>; SMALLER],
}

impl<'a> Pyramid<'a> {
    /// The pyramid of an image; nothing is computed yet.
    pub fn new(image: &'a RgbImage) -> Self {
        Self {
            image,
            smaller: Default::default(),
        }
    }

    /// The image at full size.
    pub fn image(&self) -> &'a RgbImage {
        self.image
    }

    /// The image, `halved` times.
    fn level(&self, halved: usize) -> &RgbImage {
        match halved.checked_sub(1) {
            None => self.image,
            // Without threads: it runs within a lock, in which no other task may begin.
            Some(before) => self.smaller[before].get_or_init(|| half(self.level(before))),
        }
    }

    /// The largest image in which fewer than `most` px lie where the full one has `step`, and how often
    /// it is halved; the smallest one where there is none.
    pub(crate) fn of_step(&self, step: f64, most: f64) -> (&RgbImage, usize) {
        let shorter = self.image.width().min(self.image.height());
        let smallest = SMALLER.min(shorter.checked_ilog2().unwrap_or(0) as usize);
        let is_small = |halved: &usize| step < most * f64::from(1_u32 << halved);
        let halved = (0..smallest).find(is_small).unwrap_or(smallest);
        (self.level(halved), halved)
    }

    /// The smallest of the images that is twice as large as `size` or larger, and shows all that the
    /// full one does.
    pub(crate) fn of_size(&self, size: [u32; 2]) -> &RgbImage {
        let shows = |halved: &usize| {
            let sides: [u32; 2] = self.image.dimensions().into();
            let mut axes = sides.into_iter().zip(size);
            axes.all(|(side, size)| side % (1 << halved) == 0 && side >> halved >= 2 * size)
        };
        self.level((1..=SMALLER).take_while(shows).last().unwrap_or(0))
    }
}

/// The image at half its size; an odd last column or row is left out.
///
/// Twice as fast as `fast_image_resize`, which is not made for this one ratio.
fn half(image: &RgbImage) -> RgbImage {
    let mut smaller = RgbImage::new(image.width() / 2, image.height() / 2);
    let [row, smaller_row] = [image.width(), smaller.width()].map(|width| 3 * width as usize);
    let pairs = image.as_raw().chunks_exact(2 * row);
    for (pair, means) in pairs.zip(smaller.chunks_exact_mut(smaller_row)) {
        let (above, below) = pair.split_at(row);
        let twos = above.chunks_exact(6).zip(below.chunks_exact(6));
        for ((above, below), mean) in twos.zip(means.chunks_exact_mut(3)) {
            for channel in 0..3 {
                let four =
                    [above, below].map(|two| u16::from(two[channel]) + u16::from(two[channel + 3]));
                mean[channel] = ((four[0] + four[1] + 2) / 4) as u8;
            }
        }
    }
    smaller
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    #[test]
    fn smaller_pixels_are_means_of_four() {
        let image = RgbImage::from_fn(11, 7, |u, v| Rgb([u * 20, v * 30, u ^ v].map(|x| x as u8)));
        let pyramid = Pyramid::new(&image);
        let (same, halved) = pyramid.of_step(1.99, 2.0);
        assert_eq!((same.dimensions(), halved), ((11, 7), 0));
        let (smaller, halved) = pyramid.of_step(2.0, 2.0);
        assert_eq!((smaller.dimensions(), halved), ((5, 3), 1));
        for (u, v, got) in smaller.enumerate_pixels() {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
            for channel in 0..3 {
                let pixel = |(du, dv)| image.get_pixel(2 * u + du, 2 * v + dv)[channel];
                let mean = four.map(|at| f64::from(pixel(at))).iter().sum::<f64>() / 4.0;
                assert!((f64::from(got[channel]) - mean).abs() <= 0.5, "{u} {v}");
            }
        }
        let (smallest, halved) = pyramid.of_step(1e9, 2.0);
        assert_eq!((smallest.dimensions(), halved), ((2, 1), 2));
        assert_eq!(pyramid.of_size([2, 2]).dimensions(), (11, 7));
        let even = RgbImage::new(48, 24);
        let even = Pyramid::new(&even);
        let chosen = [[6, 3], [7, 3], [12, 6], [13, 6]].map(|size| even.of_size(size).width());
        assert_eq!(chosen, [12, 24, 24, 48]);
    }
}
