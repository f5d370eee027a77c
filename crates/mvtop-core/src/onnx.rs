//! Graphs in ONNX Runtime: the only module, with its children, that knows the `ort` crate.
//!
//! The ONNX Runtime library is loaded when the program runs, so that any recent one will do; it is
//! loaded once and stays until the process ends.

use self::bounds::{Bounds, Unfinished, bounded};
use crate::{Error, Result, cancel};
use derive_setters::Setters;
use ndarray::{ArrayD, ArrayView, ArrayViewD, CowArray, Dimension, IxDyn};
use ort::session::{RunOptions, SessionInputValue};
use ort::value::TensorRef;
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

mod bounds;
mod locate;
mod operator;
mod provider;
mod runtime;
mod trust;

pub use provider::Provider;
pub use runtime::{Runtime, check_threads};

/// How a graph is run.
#[derive(Debug, Clone, Default, PartialEq, Eq, Setters)]
#[setters(prefix = "with_")]
#[non_exhaustive]
pub struct SessionOptions {
    /// What runs it.
    pub provider: Provider,
    /// Threads inside one operation; 0 leaves the number to ONNX Runtime (one per physical core).
    pub threads: usize,
}

/// An input of a graph, in the memory layout that ONNX Runtime reads: borrowed when contiguous,
/// copied otherwise.
#[derive(Debug, Clone)]
pub enum Tensor<'a> {
    /// 32-bit floats.
    F32(CowArray<'a, f32, IxDyn>),
    /// 64-bit integers.
    I64(CowArray<'a, i64, IxDyn>),
}

impl<'a, D: Dimension> From<ArrayView<'a, f32, D>> for Tensor<'a> {
    fn from(array: ArrayView<'a, f32, D>) -> Self {
        Self::F32(contiguous(array.into_dyn()))
    }
}

impl<'a, D: Dimension> From<ArrayView<'a, i64, D>> for Tensor<'a> {
    fn from(array: ArrayView<'a, i64, D>) -> Self {
        Self::I64(contiguous(array.into_dyn()))
    }
}

fn contiguous<T: Clone>(array: ArrayViewD<'_, T>) -> CowArray<'_, T, IxDyn> {
    match array.is_standard_layout() {
        true => array.into(),
        false => array.as_standard_layout().into_owned().into(),
    }
}

impl Tensor<'_> {
    /// One that borrows nothing.
    fn into_owned(self) -> Tensor<'static> {
        match self {
            Self::F32(array) => Tensor::F32(array.into_owned().into()),
            Self::I64(array) => Tensor::I64(array.into_owned().into()),
        }
    }

    fn value(&self) -> ort::Result<SessionInputValue<'_>> {
        Ok(match self {
            Self::F32(array) => TensorRef::from_array_view(array)?.into(),
            Self::I64(array) => TensorRef::from_array_view(array)?.into(),
        })
    }
}

/// An input or output that a graph is expected to have.
pub(crate) struct Port {
    pub name: &'static str,
    /// `None` for any length.
    pub shape: Vec<Option<usize>>,
    /// Whether its numbers are 64-bit integers; 32-bit floats otherwise.
    pub whole: bool,
}

/// One loaded graph.
#[derive(Debug)]
pub struct Session {
    path: PathBuf,
    inputs: Vec<String>,
    outputs: Vec<String>,
    /// Lengths of the axes of each input; below 0 where the graph leaves one open.
    shapes: Vec<Vec<i64>>,
    // ONNX Runtime's `Run` is thread-safe but `ort` asks for `&mut`. Nothing runs on rayon while
    // this is held, so a rayon task may wait for it.
    session: Arc<Mutex<ort::session::Session>>,
    bounds: Bounds,
    run: AtomicU8,
}

/// Most numbers of one output: half a gigabyte.
const MOST_NUMBERS: usize = 1 << 27;

/// Of [`Session::run`]: not run yet, so that it is bounded; run within bounds; never came to an end.
const FRESH: u8 = 0;
const PROVEN: u8 = 1;
const STUCK: u8 = 2;

impl Session {
    fn new(path: &Path, session: ort::session::Session, bounds: Bounds) -> Self {
        let names =
            |outlets: &[ort::value::Outlet]| outlets.iter().map(|o| o.name().to_owned()).collect();
        let shape = |outlet: &ort::value::Outlet| match outlet.dtype() {
            ort::value::ValueType::Tensor { shape, .. } => shape.to_vec(),
            _ => Vec::new(),
        };
        Self {
            path: path.to_owned(),
            shapes: session.inputs().iter().map(shape).collect(),
            inputs: names(session.inputs()),
            outputs: names(session.outputs()),
            session: Arc::new(Mutex::new(session)),
            bounds,
            run: AtomicU8::new(FRESH),
        }
    }

    /// Names of the inputs that the graph declares.
    pub fn inputs(&self) -> &[String] {
        &self.inputs
    }

    /// Whether the graph leaves the lengths of these axes of an input open.
    pub fn leaves_open(&self, input: &str, axes: &[usize]) -> bool {
        let place = self.inputs.iter().position(|name| name == input);
        place.is_some_and(|place| {
            let shape = &self.shapes[place];
            axes.iter()
                .all(|&axis| shape.get(axis).is_some_and(|&length| length < 0))
        })
    }

    /// Names of the outputs that the graph declares.
    pub fn outputs(&self) -> &[String] {
        &self.outputs
    }

    /// Refuses a graph that is none of mvtop's, before it is run: an input that nobody gives, an
    /// output that is missing, and one of another type or shape.
    ///
    /// - `inputs`, `outputs`: name, type and shape; `None` for any length. A graph may have fewer
    ///   inputs
    ///
    /// # Errors
    /// [`Error::Network`].
    pub(crate) fn check(&self, inputs: &[Port], outputs: &[Port]) -> Result<()> {
        let session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        for outlet in session.inputs() {
            let Some(port) = inputs.iter().find(|port| port.name == outlet.name()) else {
                let known: Vec<&str> = inputs.iter().map(|port| port.name).collect();
                return Err(self.error(format!(
                    "input `{}`: expected one of {}; export the bundle again",
                    outlet.name(),
                    known.join(", ")
                )));
            };
            self.fits("input", port, outlet)?;
        }
        for port in outputs {
            let Some(outlet) = session.outputs().iter().find(|o| o.name() == port.name) else {
                return Err(self.error(format!(
                    "expected an output `{}`, got none; export the bundle again",
                    port.name
                )));
            };
            self.fits("output", port, outlet)?;
        }
        Ok(())
    }

    /// - `role`: `input` or `output`
    fn fits(&self, role: &str, port: &Port, outlet: &ort::value::Outlet) -> Result<()> {
        use ort::value::{TensorElementType, ValueType};
        let expected = match port.whole {
            true => TensorElementType::Int64,
            false => TensorElementType::Float32,
        };
        let fits = match outlet.dtype() {
            ValueType::Tensor { ty, shape, .. } => {
                // Below 0 where the graph leaves a length open; none at all where it is not known.
                let axis = |(got, expected): (&i64, &Option<usize>)| {
                    *got < 0 || expected.is_none_or(|length| length as i64 == *got)
                };
                let axes =
                    shape.len() == port.shape.len() && shape.iter().zip(&port.shape).all(axis);
                *ty == expected && (axes || shape.is_empty())
            }
            _ => false,
        };
        if fits {
            return Ok(());
        }
        let axis =
            |length: &Option<usize>| length.map_or("any".into(), |length| length.to_string());
        let shape: Vec<String> = port.shape.iter().map(axis).collect();
        Err(self.error(format!(
            "{role} `{}`: expected {expected} of shape [{}], got {}; export the bundle again",
            port.name,
            shape.join(", "),
            outlet.dtype()
        )))
    }

    /// Runs the graph; concurrent calls run one after the other.
    ///
    /// Tensors whose name the graph does not declare are left out, so that one caller can feed
    /// graphs that use fewer inputs.
    ///
    /// # Errors
    /// [`Error::Network`] when an input is missing, has a wrong type or shape, or a node fails.
    pub fn run(&self, inputs: &[(&str, Tensor<'_>)]) -> Result<Outputs> {
        let given = |name: &&String| inputs.iter().any(|(given, _)| given == name);
        if let Some(missing) = self.inputs.iter().find(|name| !given(name)) {
            return Err(self.error(format!("input `{missing}` was not given")));
        }
        let declared = |name: &str| self.inputs.iter().any(|declared| declared == name);
        let inputs = inputs.iter().filter(|(name, _)| declared(name));
        cancel::check()?;
        let cancel = cancel::current();
        let options = RunOptions::new().map_err(|e| self.error(e.to_string()))?;
        let options = Arc::new(options);
        let stop = {
            let options = options.clone();
            move || drop(options.terminate())
        };
        let arrays = match self.run.load(Ordering::Relaxed) {
            STUCK => return Err(self.error("has not come to an end before; load it anew".into())),
            FRESH => {
                let owned = |(name, tensor): &(&str, Tensor)| {
                    ((*name).to_owned(), tensor.clone().into_owned())
                };
                let inputs: Vec<(String, Tensor<'static>)> = inputs.map(owned).collect();
                let session = self.session.clone();
                let work = move || {
                    let inputs: Vec<_> = inputs.iter().map(|(n, t)| (n.as_str(), t)).collect();
                    run(&session, &options, &inputs)
                };
                let done = bounded(self.bounds, &cancel, stop, work);
                let done = done.map_err(|why| self.unfinished(why))?;
                if done.is_ok() {
                    self.run.store(PROVEN, Ordering::Relaxed);
                }
                done
            }
            _ => {
                let inputs: Vec<_> = inputs.map(|(name, tensor)| (*name, tensor)).collect();
                cancel.stopping(stop, || run(&self.session, &options, &inputs))
            }
        };
        cancel::check()?;
        Ok(Outputs {
            path: self.path.clone(),
            arrays: arrays.map_err(|problem| self.error(problem))?,
        })
    }

    fn unfinished(&self, why: Unfinished) -> Error {
        self.run.store(STUCK, Ordering::Relaxed);
        match why {
            Unfinished::Interrupted => {
                // It heeded that, and its next run is bounded again; else it still holds the lock.
                if self.session.try_lock().is_ok() {
                    self.run.store(FRESH, Ordering::Relaxed);
                }
                Error::Interrupted
            }
            Unfinished::TooLong => self.error(format!(
                "its first run took more than {} s, in which any network of mvtop's ends; use \
                 another bundle",
                self.bounds.seconds()
            )),
            Unfinished::Failed => self.error("its first run failed".into()),
        }
    }

    fn error(&self, problem: String) -> Error {
        Error::Network {
            path: self.path.clone(),
            problem,
        }
    }
}

/// All outputs of a graph by name, or what went wrong.
fn run(
    session: &Mutex<ort::session::Session>,
    options: &RunOptions,
    inputs: &[(&str, &Tensor)],
) -> Result<HashMap<String, ArrayD<f32>>, String> {
    let mut values = Vec::with_capacity(inputs.len());
    for (name, tensor) in inputs {
        let value = tensor.value();
        let value = value.map_err(|e| format!("input `{name}`: {e}"))?;
        values.push((Cow::Borrowed(*name), value));
    }
    let mut session = session.lock().unwrap_or_else(PoisonError::into_inner);
    let values = session.run_with_options(values, options);
    let values = values.map_err(|e| e.to_string())?;
    let mut arrays = HashMap::new();
    for (name, value) in values.iter() {
        let array = value
            .try_extract_array::<f32>()
            .map_err(|e| format!("output `{name}`: {e}"))?;
        let array = copied(&array).map_err(|problem| format!("output `{name}` {problem}"))?;
        arrays.insert(name.to_owned(), array);
    }
    Ok(arrays)
}

/// A copy of an output, refused where it is larger than any of mvtop's: memory that cannot be had would end
/// the process.
fn copied(array: &ArrayViewD<'_, f32>) -> std::result::Result<ArrayD<f32>, String> {
    let mut numbers = Vec::new();
    if array.len() > MOST_NUMBERS || numbers.try_reserve_exact(array.len()).is_err() {
        return Err(format!(
            "has {} numbers, expected at most {MOST_NUMBERS} and memory for them; use another bundle, or fewer \
             views",
            array.len()
        ));
    }
    numbers.extend(array.iter());
    ArrayD::from_shape_vec(array.raw_dim(), numbers).map_err(|e| e.to_string())
}

/// What a graph has computed.
#[derive(Debug, Clone)]
pub struct Outputs {
    path: PathBuf,
    arrays: HashMap<String, ArrayD<f32>>,
}

impl Outputs {
    /// Takes out the output `name`, which must have the dimension `D`, e.g. `take::<Ix3>("memory")`.
    ///
    /// # Errors
    /// [`Error::Network`] when there is no such output or it has another number of axes.
    pub fn take<D: Dimension>(&mut self, name: &str) -> Result<ndarray::Array<f32, D>> {
        let error = |problem| Error::Network {
            path: self.path.clone(),
            problem,
        };
        let Some(array) = self.arrays.remove(name) else {
            return Err(error(format!("the graph has no output `{name}`")));
        };
        let shape = array.shape().to_vec();
        array.into_dimensionality().map_err(|_| {
            let axes = D::NDIM.map_or("other".into(), |n| n.to_string());
            error(format!(
                "output `{name}`: expected {axes} axes, got shape {shape:?}"
            ))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_larger_than_any_of_mvtop_s_are_not_copied() {
        let numbers = ndarray::arr1(&[1.0, 2.0, 3.0]);
        assert_eq!(
            copied(&numbers.view().into_dyn()).unwrap(),
            numbers.clone().into_dyn()
        );
        // Of one number, seen as many.
        let number = ndarray::arr0(0.0);
        let many = number.broadcast((1 << 14, 1 << 14)).unwrap().into_dyn();
        let problem = copied(&many).unwrap_err();
        assert!(problem.contains("has 268435456 numbers"), "{problem}");
    }
}
