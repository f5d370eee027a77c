//! `mvtop::DeformableSampling`, the operator that networks use to sample feature maps.
//!
//! Inputs `value` `[B, N, H, D]`, `locations` `[B, Q, H, L, K, 2]` and `weights` `[B, Q, H, L, K]`,
//! all float; attribute `level_shapes`, integers `h0, w0, h1, w1, …`; output `[B, Q, H·D]`.
//! See [`crate::sampling`] for what it computes.

use crate::sampling::{Dims, LevelShapes, Sampling};
use ort::operator::{
    BoxedKernel, ComputeContext, KernelContext, Operator, OperatorDomain, OperatorInput,
    OperatorOutput, ShapeInferenceContext,
};
use ort::value::{Shape, SymbolicDimensions, TensorElementType, ValueType};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// The operators of this crate.
pub(super) fn domain() -> ort::Result<OperatorDomain> {
    OperatorDomain::new("mvtop")?.add(DeformableSampling)
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
            let inputs = context.inputs();
            match output_type(&inputs) {
                Some(output) => context.set_output(0, &output),
                None => Ok(()),
            }
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
    let (value_shape, value) = value.try_extract_tensor::<f32>()?;
    let (locations_shape, locations) = locations.try_extract_tensor::<f32>()?;
    let (weights_shape, weights) = weights.try_extract_tensor::<f32>()?;
    let (&[batch, cells, heads, head_dim], &[_, queries, _, _, points]) =
        (&value_shape[..], &weights_shape[..])
    else {
        return Err(error(format!(
            "expected value [B, N, H, D] and weights [B, Q, H, L, K], got {value_shape:?} and \
             {weights_shape:?}"
        )));
    };
    let taps = [batch, queries, heads, levels.len() as i64, points];
    let expect = |name, got: &[i64], expected: &[i64]| match got == expected {
        true => Ok(()),
        false => Err(error(format!(
            "{name} has shape {got:?}, expected {expected:?}"
        ))),
    };
    expect(
        "value",
        value_shape,
        &[batch, levels.cells() as i64, heads, head_dim],
    )?;
    expect("weights", weights_shape, &taps)?;
    expect("locations", locations_shape, &[&taps[..], &[2]].concat())?;
    debug_assert_eq!(cells, levels.cells() as i64);

    let axis = |length: i64| usize::try_from(length).map_err(|_| error("an axis is negative"));
    let dims = Dims {
        batch: axis(batch)?,
        heads: axis(heads)?,
        head_dim: axis(head_dim)?,
        queries: axis(queries)?,
        points: axis(points)?,
    };
    let sampling = Sampling::new(levels, dims, value, locations, weights).map_err(error)?;
    let mut out = context
        .output(0, [batch, queries, heads * head_dim])?
        .ok_or_else(|| error("the output is missing"))?;
    let (_, out) = out.try_extract_tensor_mut::<f32>()?;
    let blocks: Vec<_> = sampling
        .blocks(out)
        .map_err(error)?
        .into_iter()
        .map(|b| Mutex::new(Some(b)))
        .collect();
    // ONNX Runtime's own threads, never rayon's: a rayon task that waits for this network would
    // otherwise take up the very thread that the network waits for.
    let panicked = AtomicBool::new(false);
    context.par_for(blocks.len(), 0, |i| {
        let run = || {
            let block = blocks[i]
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .take();
            if let Some(block) = block {
                sampling.sample(block);
            }
        };
        if catch_unwind(AssertUnwindSafe(run)).is_err() {
            panicked.store(true, Ordering::Relaxed);
        }
    })?;
    if panicked.into_inner() {
        Err(error("panicked"))
    } else {
        Ok(())
    }
}

fn levels_of(sides: &[i64]) -> ort::Result<LevelShapes> {
    let shapes: Option<Vec<_>> = sides
        .chunks(2)
        .map(|s| {
            Some((
                usize::try_from(s[0]).ok()?,
                usize::try_from(*s.get(1)?).ok()?,
            ))
        })
        .collect();
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
