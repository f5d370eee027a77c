"""What the user can mend, and how a command says it."""

import argparse
import functools
import sys


class UserError(Exception):
    """One sentence: what was expected, what came, and the fix; a command prints it and exits."""


def command(main):
    """Decorates the `main` of a command: a `UserError` becomes one line on stderr, exit code 1."""

    @functools.wraps(main)
    def run(*args):
        try:
            return main(*args)
        except UserError as error:
            sys.exit(f"error: {error}")

    return run


def argument_parser(doc: str) -> argparse.ArgumentParser:
    """For a command whose module says `doc`, shown as it is written there."""
    return argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
