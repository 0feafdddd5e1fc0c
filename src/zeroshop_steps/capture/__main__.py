"""`python -m zeroshop_steps.capture --method METHOD ...`"""

import sys

from zeroshop_steps.capture import METHODS
from zeroshop_steps.cli import stage_main

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.capture", METHODS))
