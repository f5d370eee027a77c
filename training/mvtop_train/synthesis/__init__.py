"""Scenes that are simulated and rendered (MuJoCo), written as data sets and samples."""
