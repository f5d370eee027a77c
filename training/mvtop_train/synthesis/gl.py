"""Off-screen OpenGL, for which MuJoCo asks when it is imported: here only when asked for."""

import contextlib
import sys

from ..errors import UserError


def open_gl():
    """One GL context per process; says what to install where there is none."""
    if "torch" in sys.modules:
        # Software GL and Triton, which torch loads when it likes, each bring an LLVM; the process
        # crashes if Triton's comes second.
        with contextlib.suppress(ImportError):
            import triton  # noqa: F401
    try:
        import mujoco

        return mujoco.GLContext(640, 480)
    except Exception as error:
        raise UserError(
            f"no off-screen OpenGL ({type(error).__name__}: {error}); "
            "fix: apt-get install libegl1 libgl1-mesa-dri, or set MUJOCO_GL=osmesa"
        ) from None
