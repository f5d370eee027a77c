//! The vertices of a PLY mesh.

use nalgebra::Vector3;

/// Reads the vertices' `x`, `y`, `z` from an ASCII or little-endian PLY file whose first element is
/// the vertices, as all exporters write it. At least one vertex, all finite.
pub fn vertices(bytes: &[u8]) -> Result<Vec<Vector3<f64>>, String> {
    let (header, body) = header(bytes).ok_or("expected a PLY mesh, got another file")?;
    let mut binary = false;
    let mut count = 0;
    // Name and type of each property of a vertex.
    let mut properties: Vec<(&str, &str)> = Vec::new();
    let mut elements = 0;
    for line in header.lines() {
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["format", format, _] => match format {
                "ascii" => binary = false,
                "binary_little_endian" => binary = true,
                _ => {
                    return Err(format!(
                        "expected ASCII or binary_little_endian, got {format}; export it again"
                    ));
                }
            },
            ["element", name, number] => {
                elements += 1;
                if elements == 1 {
                    count = number.parse().unwrap_or(0);
                    if name != "vertex" || count == 0 {
                        return Err(format!(
                            "expected vertices as the first element, got {number} of {name}"
                        ));
                    }
                }
            }
            ["property", kind, name] if elements == 1 => properties.push((name, kind)),
            ["property", "list", ..] if elements == 1 => {
                return Err("expected numbers as properties of a vertex, got a list".into());
            }
            _ => {}
        }
    }
    let place = |axis: &str| {
        let at = properties.iter().position(|(name, _)| *name == axis);
        at.ok_or_else(|| format!("expected a property {axis} of the vertices, got none"))
    };
    let axes = [place("x")?, place("y")?, place("z")?];
    let points = if binary {
        from_binary(body, count, &properties, axes)?
    } else {
        from_text(body, count, axes)
    };
    match points {
        Some(points) if points.iter().flatten().all(|c| c.is_finite()) => {
            Ok(points.into_iter().map(Vector3::from).collect())
        }
        _ => Err(format!(
            "expected {count} vertices of finite numbers, got fewer or others; the file is cut \
             short or broken"
        )),
    }
}

fn header(bytes: &[u8]) -> Option<(&str, &[u8])> {
    const END: &[u8] = b"end_header";
    let end = bytes.windows(END.len()).position(|part| part == END)?;
    let line_end = end + bytes[end..].iter().position(|&byte| byte == b'\n')?;
    let header = std::str::from_utf8(&bytes[..end]).ok()?;
    header
        .starts_with("ply")
        .then_some((header, &bytes[line_end + 1..]))
}

fn from_text(body: &[u8], count: usize, axes: [usize; 3]) -> Option<Vec<[f64; 3]>> {
    let text = String::from_utf8_lossy(body);
    let point = |line: &str| {
        let numbers: Vec<&str> = line.split_whitespace().collect();
        let [x, y, z] = axes.map(|at| numbers.get(at)?.parse().ok());
        Some([x?, y?, z?])
    };
    let points: Vec<_> = text
        .lines()
        .filter(|line| !line.trim().is_empty())
        .take(count)
        .map(point)
        .collect::<Option<_>>()?;
    (points.len() == count).then_some(points)
}

fn from_binary(
    body: &[u8],
    count: usize,
    properties: &[(&str, &str)],
    axes: [usize; 3],
) -> Result<Option<Vec<[f64; 3]>>, String> {
    let mut offsets = Vec::new();
    let mut stride = 0;
    for (name, kind) in properties {
        offsets.push(stride);
        stride += match *kind {
            "char" | "uchar" | "int8" | "uint8" => 1,
            "short" | "ushort" | "int16" | "uint16" => 2,
            "int" | "uint" | "int32" | "uint32" | "float" | "float32" => 4,
            "double" | "float64" => 8,
            _ => return Err(format!("expected a number as property {name}, got {kind}")),
        };
    }
    let coordinate = |vertex: &[u8], at: usize| {
        let bytes = &vertex[offsets[at]..];
        match properties[at].1 {
            "float" | "float32" => Some(f32::from_le_bytes(*bytes.first_chunk()?).into()),
            "double" | "float64" => Some(f64::from_le_bytes(*bytes.first_chunk()?)),
            _ => None,
        }
    };
    let point = |vertex: &[u8]| {
        let [x, y, z] = axes.map(|at| coordinate(vertex, at));
        Some([x?, y?, z?])
    };
    let points: Option<Vec<_>> = body.chunks_exact(stride).take(count).map(point).collect();
    Ok(points.filter(|points| points.len() == count))
}
