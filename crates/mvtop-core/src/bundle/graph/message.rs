//! A protobuf message of which each field is asked for by its number.

use super::BROKEN;
use super::protobuf::{Field, fields};

/// A message, read once: fields that may come once only are refused twice, as readers differ in which
/// counts.
pub struct Message<'a>(Vec<(u64, Field<'a>)>);

impl<'a> Message<'a> {
    pub fn new(bytes: &'a [u8]) -> Result<Self, String> {
        let fields = fields(bytes);
        fields.map(Self).ok_or_else(|| BROKEN.to_owned())
    }

    pub fn fields(&self) -> impl Iterator<Item = &(u64, Field<'a>)> {
        self.0.iter()
    }

    pub fn all(&self, number: u64) -> impl Iterator<Item = &'a [u8]> {
        let of = self.0.iter().filter(move |(field, _)| *field == number);
        of.filter_map(|(_, field)| match field {
            Field::Bytes(bytes) => Some(*bytes),
            _ => None,
        })
    }

    /// The only one; empty where there is none.
    pub fn one(&self, number: u64) -> Result<&'a [u8], String> {
        self.once(number)?;
        Ok(self.all(number).next().unwrap_or_default())
    }

    pub fn number(&self, number: u64) -> Result<Option<u64>, String> {
        self.once(number)?;
        Ok(self.0.iter().find_map(|(field, value)| match value {
            Field::Number(value) if *field == number => Some(*value),
            _ => None,
        }))
    }

    pub fn has(&self, number: u64) -> bool {
        self.0.iter().any(|(field, _)| *field == number)
    }

    fn once(&self, number: u64) -> Result<(), String> {
        match self.0.iter().filter(|(field, _)| *field == number).count() {
            0 | 1 => Ok(()),
            _ => Err("has a field twice that may be there once; export it again".into()),
        }
    }
}
