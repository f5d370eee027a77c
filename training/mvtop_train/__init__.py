"""Training side of mvtop: data, network, training, export and parity fixtures."""

import os
import sys

from . import children

# Read when ONNX Runtime is loaded, which else writes files and asks for a host:
# docs/explanation/security.md.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
# Both are read when MuJoCo or the GL library load, so they come before any of its imports.
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "1")  # software rendering: one core per process
# Read when PyTorch is loaded. Threads that wait for long do not keep the cores from what prepares
# batches; as a step has thousands of short waits, they do not sleep at once either.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "10000")
# Read when tqdm is imported: progress in a file, which nobody watches, is told now and then.
if sys.stderr is None or not sys.stderr.isatty():
    os.environ.setdefault("TQDM_MININTERVAL", "20")
# Read by every Python that this process starts.
os.environ |= children.environment()
