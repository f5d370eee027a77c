"""From weights to the bundle that Rust runs, and the numbers that both must agree on."""
