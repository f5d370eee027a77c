"""Text that is safe to print, whatever names of a stranger's files are in it.

As `printable` and `harmless` of the Rust crate `mvtop-core` have it.
"""

import unicodedata

# Unicode's categories of characters by which text can show something else than it holds: control
# and format characters (hidden, or turning the direction of writing), halves of others, and
# separators of lines and paragraphs.
_MISLEADING = ("Cc", "Cf", "Cs", "Zl", "Zp")


def printable(sentence: object) -> str:
    """One line, with misleading characters as JSON escapes them."""
    return harmless(" ".join(str(sentence).split()))


def refused(sentence: str) -> ValueError:
    """What to raise of a sentence with values in it, which may come from outside."""
    return ValueError(printable(sentence))


def harmless(text: str) -> str:
    """Lines, with misleading characters as JSON escapes them."""
    return "".join(_escaped(c) if c != "\n" and _misleads(c) else c for c in text)


def _misleads(character: str) -> bool:
    return unicodedata.category(character) in _MISLEADING


def _escaped(character: str) -> str:
    """As JSON has it: in units of UTF-16."""
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[at : at + 4]}" for at in range(0, len(units), 4))
