"""A bound on the memory that reading a stranger's file takes."""

import contextlib
import re
from pathlib import Path

STATUS = Path("/proc/self/status")  # Linux


@contextlib.contextmanager
def at_most(more: int):
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
