//! Meshes from OBJ files.

use std::path::Path;

use mvtop_core::file;
use mvtop_core::mesh::Mesh;
use nalgebra::Point3;
use tobj::{LoadOptions, load_obj_buf};

use crate::{Error, Result};

/// Largest file that is read.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// Reads the vertices that faces name, and the faces, of all objects in the file; faces of more than
/// three vertices become fans of triangles, materials are not looked at.
///
/// - `unit`: what a unit of the file is to become; 0.001 gives BOP's models in metres
///
/// # Errors
/// [`Error::Geometry`] where the file cannot be read, [`Error::Data`] where it is no OBJ file with faces
/// or a face names a vertex that is not there.
pub(super) fn load_obj(path: &Path, unit: f64) -> Result<Mesh> {
    let refuse = |problem: String| {
        Error::Data(format!(
            "{}: expected an OBJ file with vertices and faces, got: {problem}",
            path.display()
        ))
    };
    let bytes = file::read(path, MAX_FILE_BYTES)?;
    let options = LoadOptions {
        triangulate: true,
        // They are no part of a shape, and make nothing to draw.
        ignore_points: true,
        ignore_lines: true,
        ..LoadOptions::default()
    };
    let no_materials = |_: &Path| Ok(Default::default());
    let (objects, _) = load_obj_buf(&mut &bytes[..], &options, no_materials)
        .map_err(|problem| refuse(problem.to_string()))?;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for object in objects {
        let first = vertices.len() as u32;
        let points = object.mesh.positions.chunks_exact(3);
        vertices.extend(points.map(|p| Point3::new(p[0], p[1], p[2]) * unit));
        let corners = object.mesh.indices.chunks_exact(3);
        triangles.extend(corners.map(|face| [face[0], face[1], face[2]].map(|v| first + v)));
    }
    if triangles.is_empty() {
        return Err(refuse("no face".into()));
    }
    Mesh::new(vertices, Vec::new(), triangles).map_err(|error| refuse(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<Mesh> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("obj_000001.obj");
        std::fs::write(&path, text).unwrap();
        load_obj(&path, 1e-3)
    }

    #[test]
    fn objects_of_a_file_are_one_mesh_in_metres() {
        // A square with texture and a normal, and a triangle that counts from the end.
        let mesh = load(
            "mtllib none.mtl\no lid\nv 0 0 0\nv 100.5 0 0\nv 100.5 200 0\nv 0 200 0\nvt 0 0\n\
             vn 0 0 1\nusemtl tin\nf 1/1/1 2/1/1 3/1/1 4/1/1\no tip\nv 0 0 300\nf -1 1 2\n",
        )
        .unwrap();
        let at = |x: f64, y: f64, z: f64| Point3::new(x, y, z) * 1e-3;
        let square = [[0, 1, 2], [0, 2, 3]];
        assert_eq!(mesh.triangles()[..2], square);
        assert_eq!(
            mesh.vertices()[..4],
            [
                at(0., 0., 0.),
                at(100.5, 0., 0.),
                at(100.5, 200., 0.),
                at(0., 200., 0.)
            ]
        );
        let tip = mesh.triangles()[2].map(|v| mesh.vertices()[v as usize]);
        assert_eq!(tip, [at(0., 0., 300.), at(0., 0., 0.), at(100.5, 0., 0.)]);
    }

    #[test]
    fn files_that_are_none_are_refused_in_one_sentence() {
        for text in [
            "",
            "v 0 0 0\nv 1 0 0\n",
            "v 0 0 0\nf 1 2 3\n",
            "v 0 0 0\nf 1 0 1\n",
            "v a b c\nf 1 1 1\n",
            "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        ] {
            let error = load(text).unwrap_err().to_string();
            let named = "obj_000001.obj: expected an OBJ file with vertices and faces, got: ";
            assert!(
                error.contains(named) && !error.contains('\n'),
                "{text}: {error}"
            );
        }
    }
}
