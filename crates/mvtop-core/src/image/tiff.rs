//! How many pages a TIFF file has, of which a reader would take the first.
//!
//! Source: TIFF, revision 6.0, sections 2 and 8: directories are a chain; `NewSubfileType` with its lowest bit
//! set is a smaller copy of another page, as cameras add.

/// Most pages that are counted.
const MOST: usize = 1000;
const NEW_SUBFILE_TYPE: u64 = 254;

/// Pages that are no smaller copies; `None` for what is no TIFF, or a broken one.
pub fn pages(bytes: &[u8]) -> Option<usize> {
    let little = match bytes.get(..4)? {
        [b'I', b'I', 42, 0] => true,
        [b'M', b'M', 0, 42] => false,
        _ => return None,
    };
    let number = |at: usize, length: usize| -> Option<u64> {
        let part = bytes.get(at..at.checked_add(length)?)?;
        let add = |sum: u64, byte: &u8| sum << 8 | u64::from(*byte);
        Some(match little {
            true => part.iter().rev().fold(0, add),
            false => part.iter().fold(0, add),
        })
    };
    let mut at = usize::try_from(number(4, 4)?).ok()?;
    let mut count = 0;
    for _ in 0..MOST {
        if at == 0 {
            break;
        }
        let entries = usize::try_from(number(at, 2)?).ok()?;
        let first = at.checked_add(2)?;
        let is_copy = (0..entries).any(|entry| {
            let entry = first + 12 * entry;
            // Its type may be of 2 or of 4 bytes, at the beginning of the value.
            let value = match number(entry + 2, 2) {
                Some(3) => number(entry + 8, 2),
                _ => number(entry + 8, 4),
            };
            number(entry, 2) == Some(NEW_SUBFILE_TYPE) && value.is_some_and(|value| value & 1 == 1)
        });
        count += usize::from(!is_copy);
        at = usize::try_from(number(first.checked_add(12 * entries)?, 4)?).ok()?;
    }
    Some(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directories of one entry each: `NewSubfileType`.
    fn tiff(kinds: &[u32]) -> Vec<u8> {
        let mut bytes = b"II\x2a\0\x08\0\0\0".to_vec();
        for (i, kind) in kinds.iter().enumerate() {
            bytes.extend(1u16.to_le_bytes());
            bytes.extend(254u16.to_le_bytes());
            bytes.extend(4u16.to_le_bytes());
            bytes.extend(1u32.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            let next = match i + 1 < kinds.len() {
                true => 8 + 18 * (i as u32 + 1),
                false => 0,
            };
            bytes.extend(next.to_le_bytes());
        }
        bytes
    }

    #[test]
    fn pages_count_but_smaller_copies_do_not() {
        assert_eq!(pages(&tiff(&[0])), Some(1));
        assert_eq!(pages(&tiff(&[0, 1])), Some(1));
        assert_eq!(pages(&tiff(&[0, 2, 0])), Some(3));
        assert_eq!(pages(b"no TIFF"), None);
        let whole = tiff(&[0, 0]);
        for length in 0..whole.len() {
            pages(&whole[..length]);
        }
    }
}
