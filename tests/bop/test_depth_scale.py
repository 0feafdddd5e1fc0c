"""The depth scale of a scene that lists none is that of its dataset's camera file."""

import json
from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.errors import StepError


@pytest.mark.parametrize(
    ("cameras", "scale"), [({"camera.json": 0.1}, 0.1), ({"camera_a.json": 0.1, "camera_b.json": 1.0}, None), ({}, None)]
)
def test_the_scale_is_that_of_the_dataset(tmp_path: Path, cameras: dict[str, float], scale: float | None) -> None:
    scene = tmp_path / "test/000001"
    write_image(scene / "depth/000000.png", np.full((4, 6), 7003, np.uint16))
    (scene / "scene_camera.json").write_text(json.dumps({"0": {"cam_K": [100, 0, 3, 0, 100, 2, 0, 0, 1]}}))
    for name, value in cameras.items():
        (tmp_path / name).write_text(json.dumps({"fx": 100, "depth_scale": value}))
    frame = read_scene(scene, truth_needed=False)[0]
    if scale is None:
        with pytest.raises(StepError, match="has depth but no depth_scale, and neither has a camera.json of its dataset; add it"):
            frame.depth_mm()
    else:
        assert frame.depth_mm()[0, 0] == pytest.approx(7003 * scale)
