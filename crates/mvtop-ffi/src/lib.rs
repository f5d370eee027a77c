//! C interface to the sampling kernel.
