"""The command `zeroshop`; also `python -m zeroshop_steps`."""

import sys

from zeroshop_steps.app.command import main

if __name__ == "__main__":
    sys.exit(main())
