//! `cameras.bin` and `images.bin`, little-endian.

use super::{Cameras, Image, MODELS, Shared};
use crate::Checked;

/// What is left of a file.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Checked<[u8; N]> {
        let (head, rest) = self
            .0
            .split_first_chunk::<N>()
            .ok_or("the file ends too early; copy it again")?;
        self.0 = rest;
        Ok(*head)
    }

    fn u32(&mut self) -> Checked<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Checked<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Checked<f64> {
        let number = f64::from_le_bytes(self.take()?);
        match number.is_finite() {
            true => Ok(number),
            false => Err(format!("expected finite numbers, got {number}")),
        }
    }

    fn f64s<const N: usize>(&mut self) -> Checked<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        Ok(numbers)
    }

    /// Up to a zero byte.
    fn name(&mut self) -> Checked<String> {
        let end = self.0.iter().position(|&byte| byte == 0);
        let end = end.ok_or("the file ends within an image's name; copy it again")?;
        let name = String::from_utf8_lossy(&self.0[..end]).into_owned();
        self.0 = &self.0[end + 1..];
        Ok(name)
    }

    fn skip(&mut self, count: u64, size: u64) -> Checked<()> {
        let bytes = count
            .checked_mul(size)
            .and_then(|bytes| usize::try_from(bytes).ok());
        let rest = bytes.and_then(|bytes| self.0.get(bytes..));
        self.0 = rest.ok_or("the file ends within an image's points; copy it again")?;
        Ok(())
    }

    fn end(&self) -> Checked<()> {
        match self.0.len() {
            0 => Ok(()),
            more => Err(format!(
                "{more} bytes too many; expected COLMAP's binary format"
            )),
        }
    }
}

pub fn cameras(bytes: &[u8]) -> Checked<Cameras> {
    let mut bytes = Bytes(bytes);
    let mut cameras = Cameras::new();
    for _ in 0..bytes.u64()? {
        let id = bytes.u32()?;
        let number = bytes.u32()?;
        let model = usize::try_from(number)
            .ok()
            .and_then(|number| MODELS.get(number));
        let (model, count) =
            model.ok_or_else(|| format!("camera {id}: the model {number} is not known"))?;
        let [width, height] = [bytes.u64()?, bytes.u64()?];
        let side = |side: u64| {
            u32::try_from(side).map_err(|_| format!("camera {id}: an image of {width}x{height} px"))
        };
        let size = [side(width)?, side(height)?];
        let params = (0..*count).map(|_| bytes.f64()).collect::<Checked<_>>()?;
        cameras.insert(
            id,
            Shared {
                model: (*model).to_owned(),
                size,
                params,
            },
        );
    }
    bytes.end()?;
    Ok(cameras)
}

pub fn images(bytes: &[u8]) -> Checked<Vec<Image>> {
    let mut bytes = Bytes(bytes);
    let mut images = Vec::new();
    for _ in 0..bytes.u64()? {
        bytes.u32()?;
        let (q_wxyz, t) = (bytes.f64s()?, bytes.f64s()?);
        let camera = bytes.u32()?;
        let name = bytes.name()?;
        let points = bytes.u64()?;
        bytes.skip(points, 24)?;
        images.push(Image {
            name,
            camera,
            q_wxyz,
            t,
        });
    }
    bytes.end()?;
    Ok(images)
}
