//! Whether a graph reads other files: weights may lie beside an ONNX file, where no checksum covers
//! them.

/// Messages of ONNX's format that weights can be in, at any depth.
#[derive(Clone, Copy)]
enum Message {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    SparseTensor,
    Function,
    Training,
}

impl Message {
    /// The message in a field, by its number; `None` where no weights can be.
    ///
    /// Source: <https://github.com/onnx/onnx/blob/main/onnx/onnx.proto>.
    fn field(self, number: u64) -> Option<Self> {
        Some(match (self, number) {
            (Self::Model, 7) | (Self::Attribute, 6 | 11) | (Self::Training, 1 | 2) => Self::Graph,
            (Self::Model, 20) => Self::Training,
            (Self::Model, 25) => Self::Function,
            (Self::Graph, 1) | (Self::Function, 7) => Self::Node,
            (Self::Function, 11) | (Self::Node, 5) => Self::Attribute,
            (Self::Graph, 5) | (Self::Attribute, 5 | 10) | (Self::SparseTensor, 1 | 2) => {
                Self::Tensor
            }
            (Self::Graph, 15) | (Self::Attribute, 22 | 23) => Self::SparseTensor,
            _ => return None,
        })
    }
}

/// Where a tensor says that its numbers lie elsewhere.
const EXTERNAL_DATA: u64 = 13;
const DATA_LOCATION: u64 = 14;

/// Refuses a graph, an ONNX file, that has weights in other files, and one that cannot be read to its
/// end: what is not read here may still be read by ONNX Runtime. The text is the problem.
pub(super) fn check(onnx: &[u8]) -> Result<(), String> {
    match reads_other_files(onnx) {
        Some(false) => Ok(()),
        Some(true) => Err(
            "has weights in other files, which no checksum covers; export it with its \
                           weights inside"
                .into(),
        ),
        None => Err("is no ONNX file that can be read to its end; export it again".into()),
    }
}

/// `None` where a message is broken, or holds a field that no version of ONNX has (a group).
fn reads_other_files(onnx: &[u8]) -> Option<bool> {
    // A list instead of recursion: how deep messages lie in each other is the file's choice.
    let mut open = vec![(Message::Model, onnx)];
    while let Some((message, mut bytes)) = open.pop() {
        while !bytes.is_empty() {
            let (number, field, rest) = next_field(bytes)?;
            bytes = rest;
            match (message, number, field) {
                (Message::Tensor, EXTERNAL_DATA, _) => return Some(true),
                (Message::Tensor, DATA_LOCATION, Field::Number(place)) if place != 0 => {
                    return Some(true);
                }
                (_, _, Field::Bytes(inner)) => {
                    open.extend(message.field(number).map(|message| (message, inner)));
                }
                _ => {}
            }
        }
    }
    Some(false)
}

enum Field<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    Other,
}

/// Number and contents of the next field of a protobuf message, and what follows; `None` where it
/// is broken.
///
/// Source: <https://protobuf.dev/programming-guides/encoding>.
fn next_field(bytes: &[u8]) -> Option<(u64, Field<'_>, &[u8])> {
    let (tag, rest) = varint(bytes)?;
    let (field, rest) = match tag & 7 {
        0 => varint(rest).map(|(number, rest)| (Field::Number(number), rest))?,
        1 => (Field::Other, rest.get(8..)?),
        2 => {
            let (length, rest) = varint(rest)?;
            let (inner, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
            (Field::Bytes(inner), rest)
        }
        5 => (Field::Other, rest.get(4..)?),
        _ => return None,
    };
    Some((tag >> 3, field, rest))
}

fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut number = 0;
    for (i, byte) in bytes.iter().enumerate().take(10) {
        number |= u64::from(byte & 0x7F) << (7 * i);
        if byte & 0x80 == 0 {
            return Some((number, &bytes[i + 1..]));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(number: u8, inner: &[u8]) -> Vec<u8> {
        [&[number << 3 | 2, inner.len() as u8][..], inner].concat()
    }

    #[test]
    fn weights_in_other_files_are_found_wherever_a_graph_may_have_them() {
        let elsewhere = [14 << 3, 1]; // data_location: EXTERNAL
        let named = message(13, &message(1, b"location"));
        let here = message(9, &[0; 4]); // raw_data
        for (tensor, expected) in [(&elsewhere[..], true), (&named, true), (&here, false)] {
            let constant = message(5, &message(5, tensor)); // a node's attribute
            let within = message(5, &message(6, &message(5, tensor))); // of a branch
            for graph in [
                message(5, tensor),
                message(1, &constant),
                message(1, &within),
            ] {
                let model = [vec![8, 10], message(7, &graph)].concat();
                assert_eq!(reads_other_files(&model), Some(expected), "{model:?}");
            }
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
        ] {
            assert!(
                check(bytes).unwrap_err().contains("read to its end"),
                "{bytes:?}"
            );
        }
    }
}
