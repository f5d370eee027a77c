//! Fields of protobuf messages, read as strictly as no reader can take them otherwise.

pub enum Field<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    Other,
}

/// Number and contents of the next field of a protobuf message, and what follows; `None` where it
/// is broken, or where readers differ: some take the lower 32 bits of a longer tag or length.
///
/// Source: <https://protobuf.dev/programming-guides/encoding>.
pub fn next_field(bytes: &[u8]) -> Option<(u64, Field<'_>, &[u8])> {
    let (tag, rest) = short_varint(bytes)?;
    let (field, rest) = match tag & 7 {
        0 => varint(rest).map(|(number, rest)| (Field::Number(number), rest))?,
        1 => (Field::Other, rest.get(8..)?),
        2 => {
            let (length, rest) = short_varint(rest)?;
            let (inner, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
            (Field::Bytes(inner), rest)
        }
        5 => (Field::Other, rest.get(4..)?),
        _ => return None,
    };
    let number = tag >> 3;
    (number > 0).then_some((number, field, rest))
}

/// One of at most 32 bits, in as few bytes as it takes.
fn short_varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let (number, rest) = varint(bytes)?;
    let last = bytes[bytes.len() - rest.len() - 1];
    let shortest = last != 0 || rest.len() + 1 == bytes.len();
    (number <= u64::from(u32::MAX) && shortest).then_some((number, rest))
}

pub fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut number = 0;
    for (i, byte) in bytes.iter().enumerate().take(10) {
        number |= u64::from(byte & 0x7F) << (7 * i);
        if byte & 0x80 == 0 {
            return Some((number, &bytes[i + 1..]));
        }
    }
    None
}

/// The fields of a message; `None` where it is broken.
pub fn fields(mut bytes: &[u8]) -> Option<Vec<(u64, Field<'_>)>> {
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let (number, field, rest) = next_field(bytes)?;
        fields.push((number, field));
        bytes = rest;
    }
    Some(fields)
}
