//! A model bundle: a folder with `model.json`, the networks and what they need.
