"""The one error type that a step shows to its user."""


class StepError(Exception):
    """Something the user can act on: names the file or option, what was expected and the remedy.

    A step that raises it ends with status 1 and prints the message without a traceback.
    """
