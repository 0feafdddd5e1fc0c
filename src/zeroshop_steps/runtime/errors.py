"""What a step says to its user: the one error type, and warnings."""

import sys
from pathlib import Path


class StepError(Exception):
    """Something the user can act on: names the file or option, what was expected and the remedy.

    A step that raises it ends with status 1 and prints the message without a traceback.
    """

    def write_details(self, folder: Path) -> None:
        """Leave in the folder that holds the record of this failure (failures.py) what helps to see why; most have nothing."""


_NO_MEMORY = ("allocate memory", "Failed to allocate", "Insufficient memory", "not enough memory", "out of memory")


def is_out_of_memory(error: BaseException) -> bool:
    """Whether memory ran out, in the words of Python, PyTorch, OpenCV or NumPy; by name, since few steps load PyTorch."""
    told = type(error).__name__ == "OutOfMemoryError" or any(words in str(error) for words in _NO_MEMORY)
    return isinstance(error, MemoryError) or (isinstance(error, Exception) and not isinstance(error, StepError) and told)


WARNING = "warning: "
"""How a line of a step's log begins that the workflow repeats at its end."""


def warn(message: str) -> None:
    """Say what the user should know of a result that stands."""
    print(f"{WARNING}{message}", file=sys.stderr)
