//! `mvtop::DeformableSampling`, the operator that networks use to sample feature maps.
//!
//! Inputs `value` `[B, N, H, D]`, `locations` `[B, Q, H, L, K, 2]` and `weights` `[B, Q, H, L, K]`,
//! all float; attribute `level_shapes`, integers `h0, w0, h1, w1, …`; output `[B, Q, H·D]`.
//! See [`crate::sampling`] for what it computes.

use crate::Error;
use crate::bundle::OPERATOR_DOMAIN;
use crate::sampling::{LevelShapes, Sampling};
use ndarray::{ArrayView, Dimension};
use ort::operator::{
    BoxedKernel, ComputeContext, KernelContext, Operator, OperatorDomain, OperatorInput,
    OperatorOutput, ShapeInferenceContext,
};
use ort::value::{DynValue, Shape, SymbolicDimensions, TensorElementType, ValueType};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// The operators of this crate.
pub(super) fn domain() -> ort::Result<OperatorDomain> {
    OperatorDomain::new(OPERATOR_DOMAIN)?.add(DeformableSampling)
}

struct DeformableSampling;

impl Operator for DeformableSampling {
    type Kernel<'attr> = BoxedKernel<'attr>;

    fn name(&self) -> &str {
        "DeformableSampling"
    }

    fn inputs(&self) -> impl IntoIterator<Item = OperatorInput> {
        [const { OperatorInput::required(TensorElementType::Float32) }; 3]
    }

    fn outputs(&self) -> impl IntoIterator<Item = OperatorOutput> {
        [OperatorOutput::required(TensorElementType::Float32)]
    }

    fn infer_shape(&self, context: &mut ShapeInferenceContext) -> ort::Result<()> {
        no_panic(|| {
            let output = output_type(&context.inputs());
            output.map_or(Ok(()), |output| context.set_output(0, &output))
        })
    }

    fn create_kernel<'attr>(
        &self,
        context: &KernelContext<'attr>,
    ) -> ort::Result<BoxedKernel<'attr>> {
        no_panic(|| {
            let sides: Vec<i64> = context
                .get("level_shapes")
                .ok_or_else(|| error("attribute `level_shapes` is missing"))?;
            let levels = levels_of(&sides)?;
            let kernel = move |context: &ComputeContext| no_panic(|| compute(&levels, context));
            Ok(Box::new(kernel) as BoxedKernel<'attr>)
        })
    }
}

fn compute(levels: &LevelShapes, context: &ComputeContext) -> ort::Result<()> {
    let missing = || error("an input is missing");
    let value = context.input(0)?.ok_or_else(missing)?;
    let locations = context.input(1)?.ok_or_else(missing)?;
    let weights = context.input(2)?.ok_or_else(missing)?;
    let (value, locations, weights) = (array(&value)?, array(&locations)?, array(&weights)?);
    let sampling =
        Sampling::of_arrays(levels, value, locations, weights).map_err(|cause| match cause {
            Error::Shape {
                name,
                expected,
                got,
            } => error(format!("{name} has shape {got:?}, expected {expected}")),
            cause => error(cause),
        })?;
    let mut out = context
        .output(0, sampling.output_shape().map(|length| length as i64))?
        .ok_or_else(|| error("the output is missing"))?;
    let (_, out) = out.try_extract_tensor_mut::<f32>()?;
    let blocks = sampling.blocks(out).map_err(error)?.into_iter();
    let blocks: Vec<_> = blocks.map(|block| Mutex::new(Some(block))).collect();
    // ONNX Runtime's own threads, never rayon's: a rayon task that waits for this network would
    // otherwise take up the very thread that the network waits for.
    let panicked = AtomicBool::new(false);
    context.par_for(blocks.len(), 0, |i| {
        let run = || {
            let mut block = blocks[i].lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(block) = block.take() {
                sampling.sample(block);
            }
        };
        if catch_unwind(AssertUnwindSafe(run)).is_err() {
            panicked.store(true, Ordering::Relaxed);
        }
    })?;
    match panicked.into_inner() {
        true => Err(error("panicked")),
        false => Ok(()),
    }
}

fn array<D: Dimension>(input: &DynValue) -> ort::Result<ArrayView<'_, f32, D>> {
    let array = input.try_extract_array::<f32>()?;
    array.into_dimensionality().map_err(error)
}

fn levels_of(sides: &[i64]) -> ort::Result<LevelShapes> {
    let side = |&side: &i64| usize::try_from(side).ok();
    let shape = |pair: &[i64]| Some((side(pair.first()?)?, side(pair.get(1)?)?));
    let shapes: Option<Vec<_>> = sides.chunks(2).map(shape).collect();
    let shapes = shapes.ok_or_else(|| {
        error(format!(
            "attribute `level_shapes` is {sides:?}, expected pairs of height and width"
        ))
    })?;
    LevelShapes::new(&shapes).map_err(error)
}

/// The output's type where every axis is known, by number or by name: ONNX Runtime would take the
/// -1 of an axis without a name for its length.
fn output_type(inputs: &[ValueType]) -> Option<ValueType> {
    let axis = |input: usize, axis: usize| match inputs.get(input)? {
        ValueType::Tensor {
            shape,
            dimension_symbols,
            ..
        } => {
            let (length, symbol) = (*shape.get(axis)?, dimension_symbols.get(axis)?.clone());
            (length >= 0 || !symbol.is_empty()).then_some((length, symbol))
        }
        _ => None,
    };
    let (heads, head_dim) = (axis(0, 2)?.0, axis(0, 3)?.0);
    if heads < 0 || head_dim < 0 {
        return None;
    }
    let channels = (heads.checked_mul(head_dim)?, String::new());
    let axes = [axis(1, 0)?, axis(1, 1)?, channels];
    Some(ValueType::Tensor {
        ty: TensorElementType::Float32,
        shape: Shape::new(axes.iter().map(|axis| axis.0)),
        dimension_symbols: SymbolicDimensions::new(axes.map(|axis| axis.1)),
    })
}

/// ONNX Runtime calls this module through C, where a panic would end the process.
fn no_panic<T>(run: impl FnOnce() -> ort::Result<T>) -> ort::Result<T> {
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| Err(error("panicked")))
}

fn error(problem: impl std::fmt::Display) -> ort::Error {
    ort::Error::new(format!("DeformableSampling: {problem}"))
}
