//! The operators of a graph: those that mvtop exports, in uses that cannot end the process.
//!
//! ONNX Runtime checks shapes and types, but divides integers as they come: by 0, or the least integer by
//! -1, the processor ends the process. So integers may only be divided by positive constants.

use std::collections::HashMap;

use super::OPERATOR_DOMAIN;
use super::message::Message;
use super::protobuf::{Field, varint};

/// Of ONNX's standard operators, those that `mvtop-train export` writes with any settings, and others as
/// plain. More are unknown to end, some do not for every input.
const STANDARD: [&str; 82] = [
    "Abs",
    "Add",
    "And",
    "ArgMax",
    "AveragePool",
    "BatchNormalization",
    "Cast",
    "Ceil",
    "Clip",
    "Concat",
    "Constant",
    "ConstantOfShape",
    "Conv",
    "Cos",
    "DepthToSpace",
    "DequantizeLinear",
    "Div",
    "Einsum",
    "Equal",
    "Erf",
    "Exp",
    "Expand",
    "Flatten",
    "Floor",
    "Gather",
    "GatherElements",
    "Gemm",
    "GlobalAveragePool",
    "Greater",
    "GreaterOrEqual",
    "GridSample",
    "HardSigmoid",
    "HardSwish",
    "Identity",
    "LayerNormalization",
    "LeakyRelu",
    "Less",
    "LessOrEqual",
    "Log",
    "LogSoftmax",
    "MatMul",
    "Max",
    "MaxPool",
    "Min",
    "Mod",
    "Mul",
    "Neg",
    "Not",
    "Or",
    "Pad",
    "Pow",
    "PRelu",
    "QuantizeLinear",
    "Range",
    "Reciprocal",
    "ReduceL2",
    "ReduceMax",
    "ReduceMean",
    "ReduceMin",
    "ReduceProd",
    "ReduceSum",
    "Relu",
    "Reshape",
    "Resize",
    "Round",
    "Shape",
    "Sigmoid",
    "Sign",
    "Sin",
    "Slice",
    "Softmax",
    "Softplus",
    "Split",
    "Sqrt",
    "Squeeze",
    "Sub",
    "Sum",
    "Tanh",
    "Tile",
    "Transpose",
    "Unsqueeze",
    "Where",
];
/// Attributes of whole numbers that ONNX Runtime divides by.
const DIVISORS: [&str; 6] = [
    "blocksize",
    "dilations",
    "group",
    "kernel_shape",
    "num_outputs",
    "strides",
];
/// This crate's.
const OWN: &str = "DeformableSampling";

// Field numbers of <https://github.com/onnx/onnx/blob/main/onnx/onnx.proto>.
const MODEL_GRAPH: u64 = 7;
const GRAPH_NODE: u64 = 1;
const GRAPH_INITIALIZER: u64 = 5;
const GRAPH_INPUT: u64 = 11;
const NODE_INPUT: u64 = 1;
const NODE_OUTPUT: u64 = 2;
const NODE_OPERATOR: u64 = 4;
const NODE_ATTRIBUTE: u64 = 5;
const NODE_DOMAIN: u64 = 7;
const ATTRIBUTE_NAME: u64 = 1;
const ATTRIBUTE_INTEGER: u64 = 3;
const ATTRIBUTE_TENSOR: u64 = 5;
const ATTRIBUTE_INTEGERS: u64 = 8;
const TENSOR_TYPE: u64 = 2;
const TENSOR_INT64: u64 = 7;
const TENSOR_NAME: u64 = 8;
const TENSOR_RAW: u64 = 9;
const INT64: u64 = 7;
/// Numbers of a constant that is looked at, at most.
const MOST_NUMBERS: usize = 64;

/// What is known of a value.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// No integers, and no strings.
    Real,
    Integer,
    /// A constant of 64-bit integers above 0.
    Positive,
}

/// Refuses other operators than the known ones, and integers divided by anything but positive
/// constants. The text is the problem.
///
/// - `onnx`: a model, read to its end before
pub fn check(onnx: &[u8]) -> Result<(), String> {
    let graph = Message::new(Message::new(onnx)?.one(MODEL_GRAPH)?)?;
    let mut known: HashMap<&[u8], Kind> = HashMap::new();
    for value in graph.all(GRAPH_INPUT) {
        // ValueInfo: name, and type of type of tensor.
        let value = Message::new(value)?;
        let tensor = Message::new(Message::new(value.one(2)?)?.one(1)?)?;
        let kind = kind_of_type(tensor.number(1)?.unwrap_or(INT64));
        known.insert(value.one(1)?, kind);
    }
    for tensor in graph.all(GRAPH_INITIALIZER) {
        let tensor = Message::new(tensor)?;
        known.insert(tensor.one(TENSOR_NAME)?, kind_of_tensor(&tensor)?);
    }
    for node in graph.all(GRAPH_NODE) {
        let node = Message::new(node)?;
        let operator = operator(&node)?;
        check_divisors(&node)?;
        let mut inputs = Vec::new();
        for name in node.all(NODE_INPUT) {
            // An input that is left out has no name.
            let kind = match name {
                [] => Some(Kind::Real),
                name => known.get(name).copied(),
            };
            inputs.push(kind.ok_or("has operators out of their order; export it again")?);
        }
        let divides = ["Div", "Mod"].contains(&operator);
        if divides && inputs.first() != Some(&Kind::Real) && inputs.get(1) != Some(&Kind::Positive)
        {
            return Err(format!(
                "divides integers ({operator}), expected that by positive constants alone, as a \
                 division by 0 ends the process; export it again"
            ));
        }
        let kind = kind_of_output(operator, &node, &inputs)?;
        // What comes beside the first output may be indices, but for parts of a whole.
        let others = match operator {
            "Split" => kind,
            _ => Kind::Integer,
        };
        let kinds = std::iter::once(kind).chain(std::iter::repeat(others));
        known.extend(node.all(NODE_OUTPUT).zip(kinds));
    }
    Ok(())
}

/// Its name, where it is a known one.
fn operator(node: &Message) -> Result<&'static str, String> {
    let (domain, name) = (node.one(NODE_DOMAIN)?, node.one(NODE_OPERATOR)?);
    let own = domain == OPERATOR_DOMAIN.as_bytes();
    let standard = [&b""[..], b"ai.onnx"].contains(&domain);
    let mut standard = STANDARD.iter().filter(|_| standard);
    match standard.find(|known| known.as_bytes() == name) {
        Some(known) => Ok(known),
        None if own && name == OWN.as_bytes() => Ok(OWN),
        None => Err(format!(
            "has an operator `{}` of `{}`, expected those that `mvtop-train export` writes; export \
             the bundle again",
            String::from_utf8_lossy(name),
            String::from_utf8_lossy(domain)
        )),
    }
}

/// Refuses numbers below 1 where they are divided by.
fn check_divisors(node: &Message) -> Result<(), String> {
    for attribute in node.all(NODE_ATTRIBUTE) {
        let attribute = Message::new(attribute)?;
        let name = attribute.one(ATTRIBUTE_NAME)?;
        let mut divisors = DIVISORS.iter();
        let Some(name) = divisors.find(|divisor| divisor.as_bytes() == name) else {
            continue;
        };
        let numbers = numbers_of(&attribute);
        if numbers.is_empty() || positive(numbers) != Kind::Positive {
            return Err(format!(
                "has a `{name}` below 1, expected 1 or more, as a division by 0 ends the process; \
                 export it again"
            ));
        }
    }
    Ok(())
}

/// The whole numbers of an attribute; `None` for what is none.
fn numbers_of(attribute: &Message) -> Vec<Option<u64>> {
    let mut numbers = Vec::new();
    for (field, value) in attribute.fields() {
        match (*field, value) {
            (ATTRIBUTE_INTEGER | ATTRIBUTE_INTEGERS, Field::Number(number)) => {
                numbers.push(Some(*number));
            }
            (ATTRIBUTE_INTEGERS, Field::Bytes(packed)) => numbers.extend(varints(packed)),
            _ => {}
        }
    }
    numbers
}

/// The numbers of a packed field, one more than [`MOST_NUMBERS`] at most; `None` for what is broken.
fn varints(mut packed: &[u8]) -> Vec<Option<u64>> {
    let mut numbers = Vec::new();
    while !packed.is_empty() && numbers.len() <= MOST_NUMBERS {
        let next = varint(packed);
        packed = next.map_or(&[], |(_, rest)| rest);
        numbers.push(next.map(|(number, _)| number));
    }
    numbers
}

/// What an operator gives first, of what it is given; types are those of ONNX's operators.
fn kind_of_output(operator: &str, node: &Message, inputs: &[Kind]) -> Result<Kind, String> {
    let input = |n: usize| inputs.get(n).copied().unwrap_or(Kind::Integer);
    let computed = |kind: Kind| match kind {
        Kind::Positive => Kind::Integer,
        kind => kind,
    };
    let attribute = |name: &str| {
        let all = node.all(NODE_ATTRIBUTE).map(Message::new);
        let all = all.collect::<Result<Vec<_>, _>>()?;
        let is = |one: &Message| one.all(ATTRIBUTE_NAME).any(|it| it == name.as_bytes());
        let mut named = all.into_iter().filter(is);
        match (named.next(), named.next()) {
            (Some(_), Some(_)) => Err(format!("has the attribute `{name}` twice; export it again")),
            (one, _) => Ok(one),
        }
    };
    Ok(match operator {
        "Shape" | "ArgMax" | "QuantizeLinear" => Kind::Integer,
        "And" | "DequantizeLinear" | "Equal" | "Greater" | "GreaterOrEqual" | "Less"
        | "LessOrEqual" | "Not" | "Or" => Kind::Real,
        "Identity" => input(0),
        "Where" => computed(input(1)),
        "Cast" => {
            let to = attribute("to")?.map(|to| to.number(ATTRIBUTE_INTEGER));
            kind_of_type(to.transpose()?.flatten().unwrap_or(INT64))
        }
        "Constant" => {
            let of = |name| attribute(name);
            match (of("value")?, of("value_int")?, of("value_ints")?) {
                (Some(value), None, None) => {
                    kind_of_tensor(&Message::new(value.one(ATTRIBUTE_TENSOR)?)?)?
                }
                (None, Some(value), None) => positive([value.number(ATTRIBUTE_INTEGER)?]),
                (None, None, Some(values)) if values.has(ATTRIBUTE_INTEGERS) => Kind::Integer,
                (None, None, None) => Kind::Real, // of floats or text
                _ => Kind::Integer,
            }
        }
        "ConstantOfShape" => match attribute("value")? {
            Some(value) => {
                let tensor = Message::new(value.one(ATTRIBUTE_TENSOR)?)?;
                computed(kind_of_tensor(&tensor)?)
            }
            None => Kind::Real,
        },
        _ => computed(input(0)),
    })
}

/// By the number of an element's type.
fn kind_of_type(number: u64) -> Kind {
    // float, string, bool, float16, double, bfloat16
    match [1, 8, 9, 10, 11, 16].contains(&number) {
        true => Kind::Real,
        false => Kind::Integer,
    }
}

fn kind_of_tensor(tensor: &Message) -> Result<Kind, String> {
    let number = tensor.number(TENSOR_TYPE)?.unwrap_or(INT64);
    let kind = kind_of_type(number);
    if number != INT64 {
        return Ok(kind);
    }
    let raw = tensor.one(TENSOR_RAW)?;
    if tensor.has(TENSOR_RAW) == tensor.has(TENSOR_INT64) || raw.len() > 8 * MOST_NUMBERS {
        return Ok(kind);
    }
    if tensor.has(TENSOR_RAW) {
        let numbers = raw.as_chunks::<8>().0.iter();
        return Ok(positive(
            numbers.map(|bytes| Some(u64::from_le_bytes(*bytes))),
        ));
    }
    let numbers = varints(tensor.one(TENSOR_INT64)?);
    Ok(match numbers.len() <= MOST_NUMBERS {
        true => positive(numbers),
        false => kind,
    })
}

/// - `numbers`: 64-bit integers in two's complement
fn positive(numbers: impl IntoIterator<Item = Option<u64>>) -> Kind {
    let mut numbers = numbers.into_iter();
    let above = |number: Option<u64>| number.is_some_and(|number| number.cast_signed() > 0);
    match numbers.all(above) {
        true => Kind::Positive,
        false => Kind::Integer,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(number: u8, inner: &[u8]) -> Vec<u8> {
        [&[number << 3 | 2, inner.len() as u8], inner].concat()
    }

    fn node(operator: &str, inputs: &[&str], output: &str, attributes: &[Vec<u8>]) -> Vec<u8> {
        let inputs = inputs.iter().flat_map(|name| message(1, name.as_bytes()));
        let mut node: Vec<u8> = inputs.collect();
        node.extend(message(2, output.as_bytes()));
        node.extend(message(4, operator.as_bytes()));
        node.extend(attributes.iter().flat_map(|one| message(5, one)));
        message(1, &node)
    }

    /// A node that gives an integer of 64 bits.
    fn integer(value: i64, output: &str) -> Vec<u8> {
        let tensor = [vec![2 << 3, 7], message(9, &value.to_le_bytes())].concat();
        let attribute = [message(1, b"value"), message(5, &tensor)].concat();
        node("Constant", &[], output, &[attribute])
    }

    fn cast(input: &str, to: u8, output: &str) -> Vec<u8> {
        let attribute = [message(1, b"to"), vec![3 << 3, to]].concat();
        node("Cast", &[input], output, &[attribute])
    }

    /// A model with an input `x` of floats and these nodes.
    fn checked(nodes: &[Vec<u8>]) -> Result<(), String> {
        let tensor = message(1, &message(1, &[1 << 3, 1])[..]);
        let input = [message(1, b"x"), message(2, &tensor[..])].concat();
        let graph = [message(11, &input), nodes.concat()].concat();
        let length = match graph.len() {
            short @ 0..128 => vec![short as u8],
            long => vec![long as u8 & 0x7F | 0x80, (long >> 7) as u8],
        };
        check(&[&[7 << 3 | 2], &length[..], &graph].concat())
    }

    #[test]
    fn reals_are_divided_by_anything_and_integers_by_positive_constants() {
        let divided = |operator, by: Vec<u8>, of: Vec<u8>| {
            checked(&[of, by, node(operator, &["of", "by"], "y", &[])])
        };
        let real = || cast("x", 1, "of");
        let whole = || cast("x", 7, "of");
        for operator in ["Div", "Mod"] {
            assert_eq!(
                divided(operator, node("Exp", &["x"], "by", &[]), real()),
                Ok(())
            );
            assert_eq!(divided(operator, integer(3, "by"), whole()), Ok(()));
            let shape = || node("Shape", &["x"], "of", &[]);
            assert_eq!(divided(operator, integer(3, "by"), shape()), Ok(()));
            for by in [integer(0, "by"), integer(-1, "by"), cast("x", 7, "by")] {
                for of in [whole(), shape(), integer(8, "of")] {
                    let problem = divided(operator, by.clone(), of).unwrap_err();
                    assert!(problem.contains("divides integers"), "{problem}");
                }
            }
            let copied = node("Identity", &["three"], "by", &[]);
            let nodes = [integer(3, "three"), copied, whole()];
            let division = node(operator, &["of", "by"], "y", &[]);
            assert_eq!(checked(&[nodes.concat(), division]), Ok(()));
            // What is computed of a positive constant may be anything.
            let less = node("Sub", &["three", "three"], "by", &[]);
            let nodes = [integer(3, "three"), less, whole()];
            let division = node(operator, &["of", "by"], "y", &[]);
            assert!(checked(&[nodes.concat(), division]).is_err());
        }
    }

    #[test]
    fn attributes_that_are_divided_by_are_above_0() {
        let of = |attribute: Vec<u8>| checked(&[node("Conv", &["x"], "y", &[attribute])]);
        let one = |name: &[u8], number: u8| of([message(1, name), vec![3 << 3, number]].concat());
        let packed = |numbers: &[u8]| of([message(1, b"strides"), message(8, numbers)].concat());
        assert_eq!(one(b"group", 1), Ok(()));
        assert_eq!(packed(&[2, 2]), Ok(()));
        let absent = of(message(1, b"group"));
        let listed = of([message(1, b"dilations"), vec![8 << 3, 1, 8 << 3, 0]].concat());
        for refused in [
            one(b"group", 0),
            packed(&[1, 0]),
            packed(&[]),
            absent,
            listed,
        ] {
            let problem = refused.unwrap_err();
            assert!(problem.contains("below 1"), "{problem}");
        }
        // Others may be anything.
        assert_eq!(one(b"axis", 0), Ok(()));
    }

    #[test]
    fn what_mvtop_does_not_export_is_refused() {
        let of = |operator, domain: &str| {
            let node = [message(4, operator), message(7, domain.as_bytes())].concat();
            checked(&[message(1, &node)])
        };
        assert_eq!(of(b"Relu", ""), Ok(()));
        assert_eq!(of(b"Relu", "ai.onnx"), Ok(()));
        assert_eq!(of(b"DeformableSampling", "mvtop"), Ok(()));
        for (operator, domain) in [
            (&b"Unique"[..], ""), // which aborts on nothing
            (b"Relu", "com.microsoft"),
            (b"DeformableSampling", ""),
            (b"Relu", "mvtop"),
            (b"BeamSearch", "com.microsoft"),
        ] {
            let problem = of(operator, domain).unwrap_err();
            assert!(problem.contains("has an operator"), "{problem}");
        }
    }

    #[test]
    fn graphs_that_readers_may_read_differently_are_refused() {
        let early = node("Relu", &["later"], "y", &[]);
        let problem = checked(&[early, node("Exp", &["x"], "later", &[])]).unwrap_err();
        assert!(problem.contains("out of their order"), "{problem}");
        let graph = message(7, &[]);
        let problem = check(&[graph.clone(), graph].concat()).unwrap_err();
        assert!(problem.contains("twice"), "{problem}");
        let to = [message(1, b"to"), vec![3 << 3, 1]].concat();
        let problem = checked(&[node("Cast", &["x"], "y", &[to.clone(), to])]).unwrap_err();
        assert!(problem.contains("`to` twice"), "{problem}");
    }
}
