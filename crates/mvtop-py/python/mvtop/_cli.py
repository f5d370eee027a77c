"""The command `mvtop-cli`."""

import os
import signal
import sys

from mvtop import _runtime, _shipped
from mvtop._mvtop import run_cli


def main() -> int:
    # Python only notes an interrupt, and looks at the note when Rust has come to its end.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if library := _runtime.library():
        os.environ["ORT_DYLIB_PATH"] = str(library)
    return run_cli(sys.argv, _shipped.FOLDER)
