"""`python -m zeroshop_steps.segment --method METHOD ...`"""

import sys

from zeroshop_steps.cli import stage_main
from zeroshop_steps.segment import METHODS

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.segment", METHODS))
