"""The command `mvtop-cli`."""

import signal
import sys

from mvtop import _runtime, _shipped
from mvtop._mvtop import run_cli

OWN = ("calibrate", "board", "hand-eye")
"""The parts of `rig` that are this package's own."""


def main() -> int:
    # Python only notes an interrupt, and looks at the note when Rust has come to its end.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if sys.stdout is None:  # else the next file that is opened would be in its place
        if sys.stderr is not None:
            print("error: stdout is closed, expected a stream; fix: >/dev/null", file=sys.stderr)
        return 2
    if sys.argv[1:2] == ["rig"] and sys.argv[2:3] and sys.argv[2] in OWN:
        from mvtop.calibration import commands

        return commands.main(sys.argv[2:])
    return run_cli(sys.argv, _shipped.FOLDER, _runtime.library())
