"""Training side of mvtop: data, network, training, export and parity fixtures."""

import os

# Both are read when MuJoCo or the GL library load, so they come before any of its imports.
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "1")  # software rendering: one core per process
