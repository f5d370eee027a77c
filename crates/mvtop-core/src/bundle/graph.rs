//! Whether a graph, an ONNX file, may be run: a bundle may be a stranger's.

mod message;
mod operators;
mod protobuf;

use self::protobuf::{Field, next_field};

/// Messages of ONNX's format that operators or weights can be in.
#[derive(Clone, Copy)]
enum MessageKind {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    SparseTensor,
}

impl MessageKind {
    /// The message in a field, by its number; `None` where no operators or weights can be.
    ///
    /// Source: <https://github.com/onnx/onnx/blob/main/onnx/onnx.proto>.
    fn field(self, number: u64) -> Option<Self> {
        Some(match (self, number) {
            (Self::Model, 7) => Self::Graph,
            (Self::Graph, 1) => Self::Node,
            (Self::Node, 5) => Self::Attribute,
            (Self::Graph, 5) | (Self::Attribute, 5 | 10) | (Self::SparseTensor, 1 | 2) => {
                Self::Tensor
            }
            (Self::Graph, 15) | (Self::Attribute, 22 | 23) => Self::SparseTensor,
            _ => return None,
        })
    }

    /// Whether a field holds more graphs or functions: what loops has its body there.
    fn holds_more(self, number: u64) -> bool {
        matches!(
            (self, number),
            (Self::Model, 20 | 25) | (Self::Attribute, 6 | 11)
        )
    }
}

/// Where a tensor says that its numbers lie elsewhere.
const EXTERNAL_DATA: u64 = 13;
const DATA_LOCATION: u64 = 14;

/// What a file is that cannot be read to its end.
const BROKEN: &str = "is no ONNX file that can be read to its end; export it again";
/// Of this crate's operators, in a graph.
pub(crate) const OPERATOR_DOMAIN: &str = "mvtop";

/// Refuses a graph that may run without end or end the process, one that has weights in other files, and
/// one that cannot be read to its end: what is not read here may still be read by ONNX Runtime. The
/// text is the problem.
pub(super) fn check(onnx: &[u8]) -> Result<(), String> {
    let elsewhere = "has weights in other files, which no checksum covers; export it with its \
                     weights inside";
    let mut open = vec![(MessageKind::Model, onnx)];
    while let Some((message, mut bytes)) = open.pop() {
        while !bytes.is_empty() {
            let next = next_field(bytes);
            let (number, field, rest) = next.ok_or(BROKEN)?;
            bytes = rest;
            if message.holds_more(number) {
                return Err(
                    "has a graph within a graph, or a function, expected neither, as \
                            these may run without end; export it again"
                        .into(),
                );
            }
            match (message, number, field) {
                (MessageKind::Tensor, EXTERNAL_DATA, _) => return Err(elsewhere.into()),
                (MessageKind::Tensor, DATA_LOCATION, Field::Number(place)) if place != 0 => {
                    return Err(elsewhere.into());
                }
                (_, _, Field::Bytes(inner)) => {
                    open.extend(message.field(number).map(|message| (message, inner)));
                }
                _ => {}
            }
        }
    }
    operators::check(onnx)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(number: u8, inner: &[u8]) -> Vec<u8> {
        // Numbers from 16 on take two bytes.
        let tag = match number {
            0..16 => vec![number << 3 | 2],
            _ => vec![(number << 3 | 2) | 0x80, number >> 4],
        };
        [&tag[..], &[inner.len() as u8], inner].concat()
    }

    /// A model of one node, an addition.
    fn model(node: &[u8]) -> Vec<u8> {
        let node = [message(4, b"Add"), node.to_vec()].concat();
        [vec![8, 10], message(7, &message(1, &node))].concat()
    }

    #[test]
    fn weights_in_other_files_are_found_wherever_a_graph_may_have_them() {
        let elsewhere = [14 << 3, 1]; // data_location: EXTERNAL
        let named = message(13, &message(1, b"location"));
        let here = message(9, &[0; 4]); // raw_data
        for (tensor, expected) in [(&elsewhere[..], true), (&named, true), (&here, false)] {
            let constant = message(5, &message(5, tensor)); // a node's attribute
            let sparse = message(5, &message(22, &message(1, tensor)));
            let weight = [vec![8, 10], message(7, &message(5, tensor))].concat();
            for onnx in [weight, model(&constant), model(&sparse)] {
                let refused = check(&onnx).is_err_and(|text| text.contains("in other files"));
                assert_eq!(refused, expected, "{onnx:?}");
            }
        }
    }

    #[test]
    fn what_may_run_without_end_is_refused() {
        let branch = message(5, &message(6, &[])); // a node's attribute that is a graph
        let branches = message(5, &message(11, &[]));
        let function = message(25, &[]);
        for onnx in [model(&branch), model(&branches), function, message(20, &[])] {
            let problem = check(&onnx).unwrap_err();
            assert!(problem.contains("a graph within a graph"), "{problem}");
        }
    }

    #[test]
    fn what_cannot_be_read_to_its_end_is_refused() {
        let elsewhere = message(7, &message(5, &[14 << 3, 1]));
        let group = [&[1 << 3 | 3, 1 << 3 | 4][..], &elsewhere].concat();
        let within = message(7, &[1 << 3 | 3, 1 << 3 | 4]);
        for bytes in [
            &b"features"[..],
            &group,
            &within,
            &[0xFF; 30],
            &[7 << 3 | 2, 0xFF, 0xFF, 0xFF, 0xFF, 1],
            // Field 7, its tag with bit 32, in more bytes than it takes, or with a length that is.
            &[7 << 3 | 2 | 0x80, 0x80, 0x80, 0x80, 0x10, 0],
            &[7 << 3 | 2 | 0x80, 0, 0],
            &[7 << 3 | 2, 0x80, 0],
            &[2, 0], // field 0
        ] {
            let problem = check(bytes).unwrap_err();
            assert!(problem.contains("read to its end"), "{bytes:?}: {problem}");
        }
    }
}
