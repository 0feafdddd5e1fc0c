"""Render one capture: `PYTHONPATH=benchmarks python -m casual_captures --help`."""

import argparse

from casual_captures import capture

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=capture.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    capture.add_arguments(parser)
    capture.run(parser.parse_args())
