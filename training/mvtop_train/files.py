"""How the user's files are read: whole, bounded, and never from what may not end."""

import json
from pathlib import Path

from .errors import UserError


def read_text(path: Path, fix: str, most: int = 1 << 28) -> str:
    """The text of a file in UTF-8, with or without a byte order mark.

    fix   ends the error
    most  bytes at most
    """
    path = Path(path)
    try:
        # Asked before it is opened: to open a pipe waits for who writes to it.
        if path.exists() and not path.is_file():
            what = "a directory" if path.is_dir() else "a pipe or device"
            raise UserError(f"{path}: expected a file, it is {what}; fix: {fix}")
        with open(path, "rb") as file:
            content = file.read(most + 1)
        if len(content) > most:
            raise UserError(f"{path}: expected {most} bytes at most, it is larger; fix: {fix}")
        return content.decode("utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: {(error.strerror or str(error)).lower()}; fix: {fix}") from None
    except ValueError as error:
        raise UserError(f"{path}: expected text in UTF-8, got: {error}; fix: the file") from None


def is_bounded(path: Path, most: int) -> bool:
    """Whether a path is of a file, no device or pipe, of so many bytes at most."""
    path = Path(path)
    return path.is_file() and path.stat().st_size <= most


def read_json(path: Path, fix: str):
    """What a file of JSON holds; a key that comes twice is refused."""
    try:
        return json.loads(read_text(path, fix), object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected JSON, got: {error}; fix: {fix}") from None


def _unique(pairs: list[tuple]) -> dict:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice!r} twice in one object")
    return fields


def write_text(path: Path, text: str):
    """Writes so that a kill leaves the old file or the new one; folders above it are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
