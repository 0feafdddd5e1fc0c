"""Libraries that must not meet in the wrong order."""

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
