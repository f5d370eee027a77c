//! Multi-view 6-DoF object pose estimation from calibrated RGB cameras.
