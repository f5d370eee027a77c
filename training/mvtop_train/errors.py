"""What the user can mend, and how a command says it."""

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
