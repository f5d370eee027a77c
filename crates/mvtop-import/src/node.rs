//! A value of a file and its place, for errors that name it.

use serde_json::Value;

use crate::Checked;

/// Rows of a 4x4 matrix.
pub type Rows4 = [[f64; 4]; 4];

/// Keys of a matrix that is an object.
const OF_MATRIX: [&str; 8] = [
    "rows", "cols", "dt", "data", "type_id", "sizes", "shape", "dtype",
];

/// A value and where it is.
#[derive(Clone)]
pub struct Node<'a> {
    pub value: &'a Value,
    /// As `cam.yaml: cam0`.
    pub place: String,
}

impl<'a> Node<'a> {
    pub fn new(value: &'a Value, place: &str) -> Self {
        let place = place.to_owned();
        Self { value, place }
    }

    /// The value of the first of these keys that is there.
    pub fn find(&self, keys: &[&str]) -> Option<Node<'a>> {
        let key = keys.iter().find(|key| self.value.get(**key).is_some())?;
        let place = format!("{}: `{key}`", self.place);
        let value = self.value.get(*key)?;
        Some(Node { value, place })
    }

    /// The same; the first key is the one that an error asks for.
    pub fn get(&self, keys: &[&str]) -> Checked<Node<'a>> {
        let key = keys.first().copied().unwrap_or_default();
        self.find(keys)
            .ok_or_else(|| format!("{}: the key `{key}` is missing", self.place))
    }

    pub fn has(&self, key: &str) -> bool {
        self.value.get(key).is_some()
    }

    pub fn wrong(&self, expected: &str) -> String {
        let got = show(self.value);
        format!("{}: expected {expected}, got {got}", self.place)
    }

    pub fn number(&self) -> Checked<f64> {
        self.value
            .as_f64()
            .ok_or_else(|| self.wrong("a finite number"))
    }

    pub fn text(&self) -> Checked<&'a str> {
        self.value.as_str().ok_or_else(|| self.wrong("text"))
    }

    /// Entries of what must be an object.
    pub fn object(&self) -> Checked<Vec<(&'a str, Node<'a>)>> {
        match self.value.is_object() {
            true => Ok(self.entries()),
            false => Err(self.wrong("an object")),
        }
    }

    /// Entries of an object, in its order.
    pub fn entries(&self) -> Vec<(&'a str, Node<'a>)> {
        let map = self.value.as_object().into_iter().flatten();
        map.map(|(key, value)| {
            let place = format!("{}: {key}", self.place);
            (key.as_str(), Node { value, place })
        })
        .collect()
    }

    pub fn list(&self) -> Checked<Vec<Node<'a>>> {
        let list = self.value.as_array().ok_or_else(|| self.wrong("a list"))?;
        let items = list.iter().enumerate().map(|(i, value)| Node {
            value,
            place: format!("{}, number {}", self.place, i + 1),
        });
        Ok(items.collect())
    }

    /// The numbers of a vector or matrix, row by row: a list, a list of lists, or an object with them
    /// as `data`.
    pub fn numbers(&self) -> Checked<Vec<f64>> {
        let wrong = || self.wrong("a list of finite numbers");
        let mut numbers = Vec::new();
        let data = self.value.get("data").unwrap_or(self.value);
        for value in data.as_array().ok_or_else(wrong)? {
            match value.as_array() {
                None => numbers.push(value.as_f64().ok_or_else(wrong)?),
                Some(row) => {
                    for number in row {
                        numbers.push(number.as_f64().ok_or_else(wrong)?);
                    }
                }
            }
        }
        if let Some((key, _)) = self
            .entries()
            .iter()
            .find(|(key, _)| !OF_MATRIX.contains(key))
        {
            return Err(format!(
                "{}: the key `{key}` of a matrix is not known and may state its order; give rows, cols, dt and data \
                 alone, row by row",
                self.place
            ));
        }
        let side = |key: &str| self.value.get(key).and_then(Value::as_u64);
        let channels = channels(self.value);
        match (
            side("rows"),
            side("cols").and_then(|cols| cols.checked_mul(channels)),
        ) {
            (Some(rows), Some(cols)) if rows.checked_mul(cols) != Some(numbers.len() as u64) => {
                Err(format!(
                    "{}: expected {rows} x {cols} numbers, as `rows` and `cols` say, got {}",
                    self.place,
                    numbers.len()
                ))
            }
            _ => Ok(numbers),
        }
    }

    /// That many numbers.
    pub fn vector<const N: usize>(&self) -> Checked<[f64; N]> {
        let numbers = self.numbers()?;
        let count = numbers.len();
        let vector = numbers.try_into();
        vector.map_err(|_| format!("{}: expected {N} numbers, got {count}", self.place))
    }

    /// A whole number of pixels.
    pub fn pixels(&self) -> Checked<u32> {
        let number = self.number()?;
        match number.fract() == 0.0 && (1.0..=1e9).contains(&number) {
            true => Ok(number as u32),
            false => Err(self.wrong("a whole number of pixels")),
        }
    }

    /// Width and height as a list.
    pub fn size(&self) -> Checked<[u32; 2]> {
        let [width, height] = self.vector::<2>()?;
        let pixels =
            |side: f64| (side.fract() == 0.0 && (1.0..=1e9).contains(&side)).then_some(side);
        match (pixels(width), pixels(height)) {
            (Some(width), Some(height)) => Ok([width as u32, height as u32]),
            _ => Err(self.wrong("width and height in whole pixels")),
        }
    }

    /// The rows of a 4x4 matrix, or of a 3x4 one that lacks its last row.
    pub fn matrix4(&self) -> Checked<Rows4> {
        let mut numbers = self.numbers()?;
        if numbers.len() == 12 {
            numbers.extend([0.0, 0.0, 0.0, 1.0]);
        }
        let numbers: [f64; 16] = numbers.try_into().map_err(|got: Vec<f64>| {
            let count = got.len();
            format!("{}: expected a 4x4 matrix, got {count} numbers", self.place)
        })?;
        Ok(std::array::from_fn(|row| {
            std::array::from_fn(|column| numbers[4 * row + column])
        }))
    }
}

/// Channels of OpenCV's matrix: 3 of `dt: "3d"`.
fn channels(matrix: &Value) -> u64 {
    let dt = matrix.get("dt").and_then(Value::as_str).unwrap_or_default();
    let digits = dt.trim_end_matches(|c: char| !c.is_ascii_digit());
    digits.parse().unwrap_or(1)
}

/// How many items a vector or matrix has; `None` for what is neither.
pub fn count_of_numbers(value: &Value) -> Option<usize> {
    let rows = value.get("data").unwrap_or(value).as_array()?;
    Some(
        rows.iter()
            .map(|row| row.as_array().map_or(1, Vec::len))
            .sum(),
    )
}

/// The value as JSON, shortened for a sentence.
pub fn show(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}
