//! What is asked of images; `python/mvtop/_request.py` writes it as JSON.

use std::collections::BTreeMap;

use mvtop_core::Request;
use mvtop_core::annotations::GivenBoxes;
use pyo3::prelude::*;

use crate::error::python;

/// An object's class, and its boxes by camera id.
pub type Boxes = (String, BTreeMap<String, [f64; 4]>);

/// Refuses JSON that is no request.
#[pyfunction]
pub fn check_request(text: &str) -> PyResult<()> {
    Request::from_json(text).map(drop).map_err(python)
}

/// A request; what is given beside it replaces what it says.
pub fn asked(
    request: Option<&str>,
    reference: Option<String>,
    boxes: Option<Vec<Boxes>>,
    min_views: Option<usize>,
    refine: Option<bool>,
) -> PyResult<Request> {
    let request = request.map(Request::from_json).transpose();
    let request = request.map_err(python)?.unwrap_or_default();
    let given = |(class, boxes): Boxes| GivenBoxes {
        class,
        boxes: boxes.into_iter().map(|(id, b)| (id, b.into())).collect(),
    };
    let boxes = boxes.map(|all| all.into_iter().map(given).collect());
    Ok(Request {
        reference: reference.or(request.reference),
        boxes: boxes.or(request.boxes),
        min_views: min_views.or(request.min_views),
        refine: refine.or(request.refine),
        ..request
    })
}
