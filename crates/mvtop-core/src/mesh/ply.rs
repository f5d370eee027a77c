//! Meshes from PLY files, text or binary.
//!
//! Vertices and faces are all that is wanted of a format that can hold anything, so this reads it
//! itself; the crates for it bring a parser generator along.
//!
//! Source: <https://paulbourke.net/dataformats/ply/>.

use std::path::Path;

use nalgebra::Point3;

use super::Mesh;
use crate::{Error, Result, file};

/// Largest file that is read.
const MAX_FILE_BYTES: u64 = 1 << 30;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Text,
    LittleEndian,
    BigEndian,
}

/// Reads a number of some type.
type Read = fn(&mut Body) -> Parsed<f64>;

struct Property {
    name: String,
    /// Of the length in front of a list.
    list: Option<Read>,
    item: Read,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

/// What is left of the file, and how to read it.
struct Body<'a> {
    rest: &'a [u8],
    format: Format,
}

/// Reads vertices, their colors (`red`, `green`, `blue`) and faces; faces of more than three
/// vertices become fans of triangles.
///
/// - `unit`: what a unit of the file is to become; 0.001 gives BOP's models in metres
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read, [`Error::Data`] where it is no PLY file with
/// vertices or a face names a vertex that is not there.
pub fn load_ply(path: &Path, unit: f64) -> Result<Mesh> {
    load_ply_within(path, unit, MAX_FILE_BYTES)
}

/// [`load_ply`] of a file of at most so many bytes.
pub(crate) fn load_ply_within(path: &Path, unit: f64, most: u64) -> Result<Mesh> {
    let refuse = |problem: String| {
        Error::Data(format!(
            "{}: expected a PLY file with vertices and faces, got: {problem}",
            path.display()
        ))
    };
    let bytes = file::read(path, most)?;
    let Contents {
        vertices,
        colors,
        faces,
    } = parse(&bytes).map_err(&refuse)?;
    let mut triangles = Vec::new();
    for (i, face) in faces.iter().enumerate() {
        // Saturates: a number that is no index is none of a vertex either.
        let exact = face.iter().all(|&v| v.fract() == 0.0 && v >= 0.0);
        let indices: Vec<u32> = face.iter().map(|&v| v as u32).collect();
        match &indices[..] {
            _ if !exact => return Err(refuse(format!("face {i} of {face:?}"))),
            [first, rest @ ..] => {
                triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
            }
            [] => {}
        }
    }
    let vertices = vertices.into_iter().map(|v| Point3::from(v) * unit);
    Mesh::new(vertices.collect(), colors, triangles).map_err(|error| refuse(error.to_string()))
}

type Parsed<T> = Result<T, String>;

/// Numbers of a face's vertices, not checked yet.
type Face = Vec<f64>;

/// What a file holds of a mesh.
#[derive(Default)]
struct Contents {
    vertices: Vec<[f64; 3]>,
    /// Of each vertex, or empty.
    colors: Vec<[u8; 3]>,
    faces: Vec<Face>,
}

fn parse(bytes: &[u8]) -> Parsed<Contents> {
    let (elements, mut body) = header(bytes)?;
    let mut contents = Contents::default();
    for Element {
        name,
        count,
        properties,
    } in elements
    {
        let place = |wanted: &[&str]| {
            let is = |property: &Property| wanted.contains(&property.name.as_str());
            properties.iter().position(is)
        };
        let axes = [place(&["x"]), place(&["y"]), place(&["z"])];
        let channels = [place(&["red"]), place(&["green"]), place(&["blue"])];
        let indices = place(&["vertex_indices", "vertex_index"]);
        let mut values: Vec<Vec<f64>> = vec![Vec::new(); properties.len()];
        for row in 0..count {
            for (property, values) in properties.iter().zip(&mut values) {
                body.property(property, values)
                    .map_err(|problem| format!("{problem} in {name} {row}"))?;
            }
            match (name.as_str(), axes, indices) {
                ("vertex", [Some(x), Some(y), Some(z)], _) => {
                    let number = |i: usize| values[i].first().copied().unwrap_or(f64::NAN);
                    contents.vertices.push([x, y, z].map(number));
                    if let [Some(red), Some(green), Some(blue)] = channels {
                        let color = [red, green, blue].map(|i| number(i) as u8);
                        contents.colors.push(color);
                    }
                }
                ("face", _, Some(indices)) => {
                    contents.faces.push(std::mem::take(&mut values[indices]));
                }
                _ => {}
            }
        }
    }
    if contents.vertices.is_empty() {
        return Err("no vertex with x, y and z".into());
    }
    Ok(contents)
}

fn header(bytes: &[u8]) -> Parsed<(Vec<Element>, Body<'_>)> {
    let mut rest = bytes;
    let mut line = || {
        let end = rest.iter().position(|&byte| byte == b'\n')?;
        let (line, after) = rest.split_at(end);
        rest = &after[1..];
        std::str::from_utf8(line).ok().map(str::trim)
    };
    if line() != Some("ply") {
        return Err("a file that does not begin with `ply`".into());
    }
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let line = line().ok_or("a header without end_header")?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let wrong = || format!("the header line `{line}`");
        match words[..] {
            ["end_header"] => break,
            ["format", name, "1.0"] => {
                format = Some(match name {
                    "ascii" => Format::Text,
                    "binary_little_endian" => Format::LittleEndian,
                    "binary_big_endian" => Format::BigEndian,
                    _ => return Err(wrong()),
                });
            }
            ["element", name, count] => elements.push(Element {
                name: name.to_owned(),
                count: count.parse().map_err(|_| wrong())?,
                properties: Vec::new(),
            }),
            ["property", ref about @ .., name] => {
                let read = |name: &str| reader(name).ok_or_else(wrong);
                let (list, item) = match about {
                    ["list", length, item] => (Some(read(length)?), read(item)?),
                    [item] => (None, read(item)?),
                    _ => return Err(wrong()),
                };
                let element = elements.last_mut().ok_or_else(wrong)?;
                element.properties.push(Property {
                    name: name.to_owned(),
                    list,
                    item,
                });
            }
            ["comment" | "obj_info", ..] | [] => {}
            _ => return Err(wrong()),
        }
    }
    // Rows of nothing would take no bytes, however many there are.
    elements.retain(|element| !element.properties.is_empty());
    let format = format.ok_or("a header without format")?;
    Ok((elements, Body { rest, format }))
}

/// What reads a type of that name.
fn reader(name: &str) -> Option<Read> {
    Some(match name {
        "char" | "int8" => |body| body.number(|bytes| i8::from_le_bytes(bytes).into()),
        "uchar" | "uint8" => |body| body.number(|bytes| u8::from_le_bytes(bytes).into()),
        "short" | "int16" => |body| body.number(|bytes| i16::from_le_bytes(bytes).into()),
        "ushort" | "uint16" => |body| body.number(|bytes| u16::from_le_bytes(bytes).into()),
        "int" | "int32" => |body| body.number(|bytes| i32::from_le_bytes(bytes).into()),
        "uint" | "uint32" => |body| body.number(|bytes| u32::from_le_bytes(bytes).into()),
        "float" | "float32" => |body| body.number(|bytes| f32::from_le_bytes(bytes).into()),
        "double" | "float64" => |body| body.number(f64::from_le_bytes),
        _ => return None,
    })
}

impl Body<'_> {
    /// One number, or those of a list, in place of what is in `values`.
    fn property(&mut self, property: &Property, values: &mut Vec<f64>) -> Parsed<()> {
        values.clear();
        let length = match property.list {
            Some(length) => length(self)?,
            None => 1.0,
        };
        // A length that is too great ends with the file.
        for _ in 0..length as u64 {
            values.push((property.item)(self)?);
        }
        Ok(())
    }

    /// The next number, by what makes it of its bytes, little end first.
    fn number<const N: usize>(&mut self, from_bytes: fn([u8; N]) -> f64) -> Parsed<f64> {
        if self.format == Format::Text {
            let word = self.word().ok_or("the end of the file")?;
            return word.parse().map_err(|_| format!("`{word}` for a number"));
        }
        let (&bytes, rest) = self.rest.split_first_chunk().ok_or("the end of the file")?;
        self.rest = rest;
        let mut bytes: [u8; N] = bytes;
        if self.format == Format::BigEndian {
            bytes.reverse();
        }
        Ok(from_bytes(bytes))
    }

    fn word(&mut self) -> Option<String> {
        let rest = self.rest.trim_ascii_start();
        let end = rest.iter().position(u8::is_ascii_whitespace);
        let (word, rest) = rest.split_at(end.unwrap_or(rest.len()));
        self.rest = rest;
        (!word.is_empty()).then(|| String::from_utf8_lossy(word).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::NamedTempFile;

    fn file(bytes: &[u8]) -> NamedTempFile {
        let file = NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        file
    }

    fn header(format: &str, index: &str) -> String {
        format!(
            "ply\nformat {format} 1.0\ncomment by hand\nelement vertex 4\nproperty float x\n\
             property float y\nproperty float z\nproperty uchar red\nelement face 2\n\
             property list uchar {index}\nend_header\n"
        )
    }

    #[test]
    fn text_and_binary_hold_the_same_mesh() {
        let text = header("ascii", "int vertex_indices")
            + "0 0 0 9\n1000 0 0 9\n1000 500 0 9\n0 500 -2 9\n3 0 1 2\n4 0 1 2 3\n";
        let corners = [
            [0., 0., 0.],
            [1000., 0., 0.],
            [1000., 500., 0.],
            [0., 500., -2_f32],
        ];
        let mut little = header("binary_little_endian", "uint vertex_index").into_bytes();
        let mut big = header("binary_big_endian", "ushort vertex_indices").into_bytes();
        for corner in corners {
            little.extend(corner.iter().flat_map(|x| x.to_le_bytes()));
            big.extend(corner.iter().flat_map(|x| x.to_be_bytes()));
            little.push(9);
            big.push(9);
        }
        for face in [&[0_u16, 1, 2][..], &[0, 1, 2, 3]] {
            little.push(face.len() as u8);
            big.push(face.len() as u8);
            little.extend(face.iter().flat_map(|&v| u32::from(v).to_le_bytes()));
            big.extend(face.iter().flat_map(|v| v.to_be_bytes()));
        }
        for bytes in [text.into_bytes(), little, big] {
            let mesh = load_ply(file(&bytes).path(), 1e-3).unwrap();
            let expected = corners.map(|c| Point3::from(c.map(f64::from)) * 1e-3);
            assert_eq!(mesh.vertices(), expected);
            assert_eq!(mesh.triangles(), [[0, 1, 2], [0, 1, 2], [0, 2, 3]]);
        }
    }

    #[test]
    fn vertices_may_have_colors() {
        let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
            property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
            element face 1\nproperty list uchar int vertex_indices\nend_header\n\
            0 0 0 255 0 7\n1 0 0 1 2 3\n0 1 0 0 0 0\n3 0 1 2\n";
        let colored = file(text.as_bytes());
        let colors = load_ply(colored.path(), 1.0).unwrap().colors().to_vec();
        assert_eq!(colors, [[255, 0, 7], [1, 2, 3], [0, 0, 0]]);
        let plain = text.replace("property uchar green", "property uchar alpha");
        let plain = load_ply(file(plain.as_bytes()).path(), 1.0).unwrap();
        assert_eq!(plain.colors(), [[0; 3]; 0]);
    }

    #[test]
    fn other_files_are_refused_in_one_sentence() {
        let good = header("ascii", "int vertex_indices")
            + "0 0 0 9\n1 0 0 9\n1 5 0 9\n0 5 0 9\n3 0 1 2\n3 0 1 2\n";
        for (text, hint) in [
            (String::new(), ""),
            ("solid stl".into(), ""),
            (good.replace("3 0 1 2\n", "3 0 1 7\n"), "[0, 1, 7]"),
            (good.replace("3 0 1 2\n", "3 0 1 -2\n"), "-2"),
            (good.replace("0 5 0 9\n", ""), "end of the file"),
            (
                good.replace("1 5 0 9", "1 x 0 9"),
                "`x` for a number in vertex 2",
            ),
            (good.replace("end_header", ""), "header line"),
            (
                good.replace("property float z\n", ""),
                "no vertex with x, y and z",
            ),
            (good.replace("vertex 4", "vertex -4"), "`element vertex -4`"),
            (good.replace("1 5 0 9", "1 nan 0 9"), "vertex 2"),
        ] {
            let error = load_ply(file(text.as_bytes()).path(), 1.0)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains("expected a PLY file")
                    && error.contains(hint)
                    && !error.contains('\n'),
                "{error}"
            );
        }
        assert!(matches!(
            load_ply(Path::new("none.ply"), 1.0),
            Err(Error::Geometry(mvtop_geometry::Error::Read { .. }))
        ));
    }
}
