"""Bounds on the memory and the time that reading a stranger's file takes."""

import contextlib
import re
import signal
import threading
from pathlib import Path

STATUS = Path("/proc/self/status")  # Linux
# Seconds of processor time from one error to the next: libraries swallow some, also in loops.
AGAIN = 0.01


@contextlib.contextmanager
def memory(more: int):
    """Within, a `MemoryError` where more than so many bytes are asked for beyond those that the
    process has. Only Linux says how many these are; elsewhere nothing is bounded."""
    if not STATUS.exists():
        yield
        return
    import resource  # not everywhere

    before = resource.getrlimit(resource.RLIMIT_DATA)
    known = [limit for limit in before if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min([_bytes() + more, *known]), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _bytes() -> int:
    return int(re.search(r"^VmData:\s*(\d+) kB$", STATUS.read_text(), re.MULTILINE)[1]) << 10


@contextlib.contextmanager
def processor_time(seconds: float):
    """Within, a `TimeoutError` once the process has used so many seconds of processor time.

    A signal brings it, which a process's main thread alone can get: there commands and their
    workers read. In other threads, and on Windows, nothing is bounded.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or not hasattr(signal, "setitimer"):
        yield
        return
    over = False

    def end(*_):
        nonlocal over
        over = True
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds, AGAIN)
    try:
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
    finally:  # twice, as the error may come in the line above
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        if over:  # whatever a library made of the error
            raise TimeoutError from None
