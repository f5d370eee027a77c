//! One file per format, each with a rig that is worked out by hand.

mod alicevision;
mod anipose;
mod camodocal;
mod depthai;
mod easymocap;
mod hand_eye;
mod kalibr;
mod matlab;
mod mccalib;
mod metashape;
mod multical;
mod nerf;
mod open3d;
mod opencv_xml;
mod openmvg;
pub mod samples;
mod scalars;
mod zed;

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];
const MINUS_Y: [f64; 3] = [0.0, -1.0, 0.0];
