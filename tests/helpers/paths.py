"""Where the project's files are."""

from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
SNAKEFILE = REPOSITORY / "workflow" / "Snakefile"
PARITY = REPOSITORY / "tests" / "parity"
"""Records of what published networks answer."""
