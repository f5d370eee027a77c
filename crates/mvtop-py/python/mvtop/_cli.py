"""The command `mvtop-cli`."""

import signal
import sys

from mvtop import _runtime, _shipped
from mvtop._mvtop import run_cli


def main() -> int:
    # Python only notes an interrupt, and looks at the note when Rust has come to its end.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run_cli(sys.argv, _shipped.FOLDER, _runtime.library())
