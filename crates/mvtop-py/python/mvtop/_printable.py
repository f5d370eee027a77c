"""Text that is safe to print, whatever names of a stranger's files are in it.

As `printable` and `harmless` of the Rust crate `mvtop-core` have it.
"""

import re

# Control characters but the end of a line, by which a terminal can be made to show something else,
# and those that turn the direction of writing.
_MISLEADING = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def printable(sentence: object) -> str:
    """One line, with misleading characters as JSON escapes them."""
    return harmless(" ".join(str(sentence).split()))


def harmless(text: str) -> str:
    """Lines, with misleading characters as JSON escapes them."""
    return _MISLEADING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
