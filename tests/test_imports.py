"""Libraries that must not meet in the wrong order, or that take longer to import than what needs them."""

import subprocess
import sys

PROGRAM = """
import zeroshop_steps
import pycolmap
import cv2
import numpy as np

for _ in range(10):
    assert cv2.imencode(".png", np.random.default_rng(0).integers(0, 255, (400, 240, 3), dtype=np.uint8))[0]
print("written")
"""


def test_png_can_be_written_after_pycolmap_was_loaded():
    ended = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert ended.returncode == 0 and ended.stdout == "written\n", ended.stderr


def test_a_plan_imports_no_large_library():
    """Snakemake imports this package anew for every plan."""
    program = "import sys, zeroshop_steps.plan.pages; print(*{'numpy', 'pandas', 'scipy', 'torch', 'cv2', 'matplotlib'} & set(sys.modules))"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ended.returncode == 0 and not ended.stdout.strip(), ended.stdout + ended.stderr
