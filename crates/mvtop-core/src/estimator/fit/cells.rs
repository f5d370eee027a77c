//! What the cells of close-ups show of an object.

use nalgebra::{Isometry3, Point3, Vector3};
use ndarray::{ArrayView3, ArrayView4, Axis};

use crate::estimator::picture::{Group, Picture, Pictures, TRUST, cell_center};
use crate::symmetry::Symmetry;

/// Cells that are trusted less say nothing.
const FAINTEST: f64 = 0.05;

/// A place of the object, and the line on which it is seen.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Which of the views shows it.
    pub view: usize,
    /// Number of the cell there, row by row.
    pub cell: usize,
    /// Object frame, metres, after one of the view's symmetries, see [`Evidence::turns`].
    pub place: Point3<f64>,
    /// Where the line of sight begins, world frame, metres.
    pub origin: Point3<f64>,
    /// Unit vector, world frame.
    pub direction: Vector3<f64>,
    /// About how far away the object is, metres; known once its position is.
    pub distance: f64,
    /// How far it can be trusted, 0 to 1.
    pub weight: f64,
}

/// What all views show of an object.
#[derive(Debug, Clone)]
pub struct Evidence<'a> {
    pub cells: Vec<Seen>,
    /// World frame to the frame of each view.
    pub views: Vec<Isometry3<f64>>,
    pub symmetry: &'a Symmetry,
    pub diameter: f64,
}

impl<'a> Evidence<'a> {
    /// Of the first object of the group, whose pictures these are.
    ///
    /// - `codes`: of all pictures, see [`Pictures::coordinates`]
    /// - `extent`: their unit, metres
    pub fn new(
        pictures: &Pictures,
        codes: ArrayView4<f32>,
        group: &Group,
        extent: f64,
        symmetry: &'a Symmetry,
        diameter: f64,
    ) -> Self {
        let list = &pictures.list[group.pictures.clone()];
        let mut cells = Vec::new();
        for (view, (picture, index)) in list.iter().zip(group.pictures.clone()).enumerate() {
            let codes = codes.index_axis(Axis(0), index);
            cells.extend(trusted(view, picture, codes, extent));
        }
        let views = list.iter().map(|p| p.camera.world_from_cam().inverse());
        Self {
            cells,
            views: views.collect(),
            symmetry,
            diameter,
        }
    }

    /// Of each view, the symmetry that takes the places it tells to where they are, were this the
    /// object's pose: a view knows nothing of the others and means, of all poses that look alike,
    /// the one most upright in its own frame. Nothing for objects without symmetries.
    pub fn turns(&self, world_from_obj: &Isometry3<f64>) -> Vec<Isometry3<f64>> {
        if self.symmetry.is_none() {
            return Vec::new();
        }
        let turn = |view_from_world: &Isometry3<f64>| {
            let pose = view_from_world * world_from_obj;
            pose.inv_mul(&self.symmetry.canonical(&pose))
        };
        self.views.iter().map(turn).collect()
    }

    /// The cell's place, after these [`Self::turns`].
    pub fn place(turns: &[Isometry3<f64>], seen: &Seen) -> Point3<f64> {
        turns
            .get(seen.view)
            .map_or(seen.place, |turn| turn * seen.place)
    }

    /// The same of about `count` of the cells.
    pub fn thinned(&self, count: usize) -> Self {
        let step = self.cells.len().div_ceil(count).max(1);
        Self {
            cells: self.cells.iter().step_by(step).copied().collect(),
            ..self.clone()
        }
    }
}

/// What the cells of a close-up show, but of those that are not to be trusted.
fn trusted<'a>(
    view: usize,
    picture: &'a Picture,
    codes: ArrayView3<'a, f32>,
    extent: f64,
) -> impl Iterator<Item = Seen> + 'a {
    let (_, rows, columns) = codes.dim();
    let center = move |n: usize| cell_center(n, columns, picture.camera.width());
    let world_from_cam = picture.camera.world_from_cam();
    let cells = (0..rows).flat_map(move |row| (0..columns).map(move |column| (row, column)));
    cells.filter_map(move |(row, column)| {
        let [x, y, z, trust] = [0, 1, 2, TRUST].map(|axis| f64::from(codes[(axis, row, column)]));
        // A comparison that numbers which are none fail as well.
        let told = trust >= FAINTEST && [x, y, z].iter().all(|x| x.is_finite());
        let pixel = [center(column), center(row)].into();
        let ray = told
            .then(|| picture.camera.intrinsics().unproject(&pixel))
            .flatten()?;
        Some(Seen {
            view,
            cell: row * columns + column,
            place: Point3::new(x, y, z) * extent,
            origin: world_from_cam.translation.vector.into(),
            direction: (world_from_cam.rotation * ray).normalize(),
            distance: 0.0,
            weight: trust,
        })
    })
}
