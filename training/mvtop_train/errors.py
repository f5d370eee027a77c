"""What the user can mend, and how a command says it."""

import argparse
import contextlib
import functools
import sys


class UserError(Exception):
    """One sentence: what was expected, what came, and the fix; a command prints it and exits."""


def command(main):
    """Decorates the `main` of a command: a `UserError` becomes one line on stderr, exit code 1; so
    does a file where a folder is to be."""

    @functools.wraps(main)
    def run(*args):
        try:
            return main(*args)
        except UserError as error:
            sys.exit(f"error: {error}")
        except (FileExistsError, NotADirectoryError) as error:
            sys.exit(
                f"error: {error.filename}: expected a folder, got a file in its place; "
                "fix: name another folder"
            )

    return run


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
