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
            f"rendering: expected off-screen OpenGL, got {type(error).__name__}: {error}; "
            "fix: apt-get install libegl1 libgl1-mesa-dri libopengl0 (Debian, Ubuntu), or dnf "
            "install mesa-libEGL mesa-dri-drivers libglvnd-opengl (Fedora)"
        ) from None
