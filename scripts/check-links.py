#!/usr/bin/env python3
"""Whether the links of all Markdown files of the repository lead to files and headings that exist.

    scripts/check-links.py [FILE ...]

Links to other hosts are not followed. A heading's anchor is made as GitHub makes it. Prints one
line for each broken link, and ends with exit code 1 if there is any.
"""

import functools
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^ *(```|~~~).*?^ *\1 *$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"(`+)(?!`).+?(?<!`)\1(?!`)", re.DOTALL)
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
DEFINITION = re.compile(r"^\[[^\]]+\]:\s*<?(\S+?)>?\s*$", re.MULTILINE)
HTML = re.compile(r"<(?:a|img)\b[^>]*?\b(?:href|src)=\"([^\"]+)\"")
HEADING = re.compile(r"^#{1,6}\s+(.+?)\s*#*$", re.MULTILINE)
NAMED = re.compile(r"<a\s+(?:id|name)=\"([^\"]+)\"")
OTHER_HOST = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)


def without_code(text: str) -> str:
    """The text with code blanked; line numbers stay."""
    for code in (FENCE, CODE):
        text = code.sub(lambda found: "\n" * found[0].count("\n"), text)
    return text


def anchor(heading: str) -> str:
    """As GitHub makes it: of `A `code` and [a link](x)!` it is `a-code-and-a-link`."""
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
    return re.sub(r"[^\w\- ]", "", text.replace("`", "")).strip().replace(" ", "-")


@functools.cache
def anchors(path: Path) -> frozenset[str]:
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    found, counts = set(NAMED.findall(text)), {}
    for heading in HEADING.findall(text):
        name = anchor(heading)
        counts[name] = counts.get(name, -1) + 1
        found.add(f"{name}-{counts[name]}" if counts[name] else name)
    return frozenset(found)


def wrong(path: Path, target: str) -> str | None:
    """What is wrong with a link of a file, if anything."""
    if OTHER_HOST.match(target) or target.startswith("//"):
        return None
    file, _, fragment = unquote(target).partition("#")
    start = ROOT / file.lstrip("/") if file.startswith("/") else path.parent / file
    place = (start if file else path).resolve()
    if not place.exists():
        return "no such file"
    if not place.is_relative_to(ROOT):
        return "outside of the repository"
    if fragment and place.suffix == ".md" and fragment not in anchors(place):
        return "no such heading"
    return None


def broken(path: Path) -> list[str]:
    text = without_code(path.read_text(encoding="utf-8"))
    found = []
    for links in (LINK, DEFINITION, HTML):
        for link in links.finditer(text):
            if why := wrong(path, link[1]):
                line = text.count("\n", 0, link.start(1)) + 1
                found.append(f"{path.relative_to(ROOT)}:{line}: {link[1]}: {why}")
    return found


def main() -> int:
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "*.md"]
    if sys.argv[1:]:
        paths = [Path(name).resolve() for name in sys.argv[1:]]
    else:
        names = subprocess.run(listed, cwd=ROOT, capture_output=True, check=True, text=True).stdout
        paths = [ROOT / name for name in sorted(names.split("\0")) if name]
    paths = [path for path in paths if path.exists()]  # removed, and not committed yet
    lines = [line for path in paths for line in broken(path)]
    print("\n".join([*lines, f"{len(paths)} Markdown files, {len(lines)} broken links"]))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
