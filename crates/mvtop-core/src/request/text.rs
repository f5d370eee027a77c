//! Single settings of a request as text: of a query, a line or an option.

use std::str::FromStr;

use super::{Request, WorldBox, refuse};
use crate::{Error, Result};

/// The settings that [`Request::set`] knows.
pub const SETTINGS: [&str; 10] = [
    "reference",
    "min_views",
    "refine",
    "classes",
    "most",
    "region",
    "frame",
    "min_confidence",
    "grasps",
    "why",
];

impl Request {
    /// Sets one thing by its name.
    ///
    /// Lists are parted by commas; `region` is the least corner and then the greatest one, six numbers
    /// in metres. Boxes, polygons, priors, planes and `T_base_world` have no such form.
    ///
    /// # Errors
    /// [`Error::Input`] for another name or a value that is none.
    ///
    /// ```
    /// let mut request = mvtop_core::request::Request::default();
    /// request.set("region", "-0.2,-0.2,0,0.2,0.2,0.5")?;
    /// assert_eq!(request.region.unwrap().max_m, [0.2, 0.2, 0.5]);
    /// # Ok::<(), mvtop_core::Error>(())
    /// ```
    pub fn set(&mut self, name: &str, value: &str) -> Result<()> {
        match name {
            "reference" => self.reference = Some(value.to_owned()),
            "min_views" => self.min_views = Some(parsed(name, value, "a whole number")?),
            "refine" => self.refine = Some(parsed(name, value, "true or false")?),
            "classes" => self.classes = Some(list(value).map(str::to_owned).collect()),
            "most" => self.most = Some(parsed(name, value, "a whole number")?),
            "region" => self.region = Some(region(value)?),
            "frame" => self.frame = Some(value.to_owned()),
            "min_confidence" => {
                self.min_confidence = Some(parsed(name, value, "a probability from 0 to 1")?);
            }
            "grasps" => self.grasps = parsed(name, value, "true or false")?,
            "why" => self.why = parsed(name, value, "true or false")?,
            _ => {
                return Err(refuse(&format!(
                    "`{name}`: no such setting, expected one of: {}",
                    SETTINGS.join(", ")
                )));
            }
        }
        Ok(())
    }
}

/// Parts between commas, without those that are empty.
fn list(text: &str) -> impl Iterator<Item = &str> {
    text.split(',')
        .map(str::trim)
        .filter(|part| !part.is_empty())
}

fn parsed<T: FromStr>(name: &str, value: &str, expected: &str) -> Result<T> {
    let wrong = |_| refuse(&format!("{name}: expected {expected}, got `{value}`"));
    value.parse().map_err(wrong)
}

fn region(text: &str) -> Result<WorldBox> {
    let wrong = || -> Error {
        refuse(&format!(
            "region: expected x,y,z of the least corner and x,y,z of the greatest one in metres, got `{text}`"
        ))
    };
    let numbers: Option<Vec<f64>> = list(text).map(|number| number.parse().ok()).collect();
    let numbers: [f64; 6] = numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(wrong)?;
    let [x0, y0, z0, x1, y1, z1] = numbers;
    Ok(WorldBox {
        min_m: [x0, y0, z0],
        max_m: [x1, y1, z1],
    })
}
