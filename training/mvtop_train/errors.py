"""What the user can mend, and how a command says it."""

import argparse
import contextlib
import functools
import os
import sys
import unicodedata

# Unicode's categories of characters by which text can show something else than it holds: control
# and format characters (hidden, or turning the direction of writing), halves of others, and
# separators of lines and paragraphs.
MISLEADING = ("Cc", "Cf", "Cs", "Zl", "Zp")


class UserError(Exception):
    """A sentence, or several: what was expected, what came, and the fix; a command prints each on a
    line and exits."""


def printable(sentence) -> str:
    """A sentence that is safe to print, whatever names of a stranger's files are in it: one line,
    with misleading characters as JSON escapes them."""
    words = " ".join(str(sentence).split())
    return "".join(_escaped(c) if misleads(c) else c for c in words)


def misleads(character: str) -> bool:
    """Whether text with it may show something else than it holds."""
    return unicodedata.category(character) in MISLEADING


def _escaped(character: str) -> str:
    """As JSON has it: in units of UTF-16."""
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[at : at + 4]}" for at in range(0, len(units), 4))


def command(main):
    """Decorates the `main` of a command: a `UserError` becomes a line on stderr, exit code 1; so
    do a file where a folder is to be, a path that cannot be used, and what is printed where nothing
    takes it."""

    @functools.wraps(main)
    def run(*args):
        try:
            with _printing():
                return main(*args)
        except UserError as error:
            sys.exit("\n".join(f"error: {printable(sentence)}" for sentence in error.args))
        except (FileExistsError, NotADirectoryError) as error:
            sys.exit(
                f"error: {printable(error.filename)}: expected a folder, got a file in its place; "
                "fix: name another folder"
            )
        except OSError as error:
            if error.filename is None:
                raise
            sys.exit(
                f"error: {printable(error.filename)}: {printable(error.strerror)}; fix: name "
                "another path, or let this user read and write it"
            )

    return run


class _Stdout:
    """A `UserError` where stdout takes no more of what is printed. A reader that has gone away, as
    in `| head`, is no failure: what is printed then is dropped."""

    def __init__(self, stream):
        self._stream = stream

    def __getattr__(self, name: str):
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._asked():
            self._stream.write(text)
        return len(text)

    def flush(self):
        with self._asked():
            self._stream.flush()

    @contextlib.contextmanager
    def _asked(self):
        try:
            yield
        except BrokenPipeError:
            self._drop()
        except OSError as error:
            self._drop()
            raise UserError(
                f"stdout: expected a stream that takes what is printed, got: {error.strerror}; "
                "fix: >/dev/null"
            ) from None

    def _drop(self):
        """Leaves nothing that Python would write at its end, to end in an error of its own."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


@contextlib.contextmanager
def _printing():
    """A `UserError` where stdout is closed, or takes no more of what is printed within."""
    if sys.stdout is None:  # the next file that is opened would be in its place
        raise UserError("stdout: expected a stream, got a closed one; fix: >/dev/null")
    stdout = _Stdout(sys.stdout)
    with contextlib.redirect_stdout(stdout):
        try:
            yield
        finally:
            stdout.flush()


@contextlib.contextmanager
def asking_mvtop(fix: str):
    """What mvtop refuses to read is a `UserError`, which ends in the fix; import mvtop within."""
    try:
        yield
    except ImportError:
        raise UserError(
            "mvtop: expected its wheel, got none installed; fix: pip install mvtop"
        ) from None
    except (OSError, ValueError) as error:
        raise UserError(f"{error}; fix: {fix}") from None


def argument_parser(doc: str, kind=argparse.ArgumentParser) -> argparse.ArgumentParser:
    """For a command whose module says `doc`, shown as it is written there."""
    return kind(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
