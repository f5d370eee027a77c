//! `cameras.txt` and `images.txt`.

use super::{Cameras, Image, Shared};
use crate::Checked;

/// Lines that say something, with their numbers.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text
        .lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()));
    lines.filter(|(_, line)| !line.starts_with('#'))
}

fn number<T: std::str::FromStr>(line: usize, what: &str, word: Option<&str>) -> Checked<T> {
    let word = word.unwrap_or_default();
    word.parse()
        .map_err(|_| format!("line {line}: expected {what}, got {word:?}"))
}

fn real(line: usize, what: &str, word: Option<&str>) -> Checked<f64> {
    let value: f64 = number(line, what, word)?;
    match value.is_finite() {
        true => Ok(value),
        false => Err(format!("line {line}: expected {what}, got {value}")),
    }
}

pub fn cameras(text: &str) -> Checked<Cameras> {
    let mut cameras = Cameras::new();
    for (line, text) in lines(text).filter(|(_, text)| !text.is_empty()) {
        let mut words = text.split_whitespace();
        let id = number(line, "CAMERA_ID", words.next())?;
        let model = words.next().unwrap_or_default().to_owned();
        let size = [
            number(line, "WIDTH", words.next())?,
            number(line, "HEIGHT", words.next())?,
        ];
        let params = words
            .map(|word| real(line, "PARAMS", Some(word)))
            .collect::<Checked<_>>()?;
        if cameras
            .insert(
                id,
                Shared {
                    model,
                    size,
                    params,
                },
            )
            .is_some()
        {
            return Err(format!("line {line}: the camera {id} is there twice"));
        }
    }
    Ok(cameras)
}

/// Whether a line is of points of an image: two numbers and a whole one of each.
fn lists_points(text: &str) -> bool {
    let words: Vec<&str> = text.split_whitespace().collect();
    let is_point = |point: &[&str]| match point {
        [x, y, id] => {
            x.parse::<f64>().is_ok() && y.parse::<f64>().is_ok() && id.parse::<i64>().is_ok()
        }
        _ => false,
    };
    words.chunks(3).all(is_point)
}

/// Every second line lists points, and may be empty.
pub fn images(text: &str) -> Checked<Vec<Image>> {
    let mut images = Vec::new();
    let mut lines = lines(text);
    while let Some((line, text)) = lines.next() {
        if text.is_empty() {
            continue;
        }
        let mut words = text.splitn(10, ' ');
        let _: u32 = number(line, "IMAGE_ID", words.next())?;
        let mut next = |what: &str| real(line, what, words.next());
        let q_wxyz = [next("QW")?, next("QX")?, next("QY")?, next("QZ")?];
        let t = [next("TX")?, next("TY")?, next("TZ")?];
        let camera = number(line, "CAMERA_ID", words.next())?;
        let name = words.next().unwrap_or_default().to_owned();
        images.push(Image {
            name,
            camera,
            q_wxyz,
            t,
        });
        if let Some((line, text)) = lines.next()
            && !lists_points(text)
        {
            return Err(format!(
                "line {line}: expected the points of image {} (X Y POINT3D_ID of each), got {:?}; write an empty line \
                 where it has none",
                images.len(),
                text.chars().take(40).collect::<String>()
            ));
        }
    }
    Ok(images)
}
