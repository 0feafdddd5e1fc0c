"""What a step says to its user: the one error type, and warnings."""

import sys


class StepError(Exception):
    """Something the user can act on: names the file or option, what was expected and the remedy.

    A step that raises it ends with status 1 and prints the message without a traceback.
    """


WARNING = "warning: "
"""How a line of a step's log begins that the workflow repeats at its end."""


def warn(message: str) -> None:
    """Say what the user should know of a result that stands."""
    print(f"{WARNING}{message}", file=sys.stderr)
