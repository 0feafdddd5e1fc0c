"""A small virtual capture that the registration tests share."""

import shutil
from pathlib import Path

import pytest

from zeroshop_steps.geometry.cameras import read_sparse_model, write_cameras
from zeroshop_steps.synthetic.demo_objects import write_demo_object
from zeroshop_steps.synthetic.raycast import capture


@pytest.fixture(scope="session")
def carton_capture(tmp_path_factory) -> Path:
    """The raised ring of ten views (480 x 360) around a printed carton on a textured surface, with true cameras."""
    folder = tmp_path_factory.mktemp("register")
    write_demo_object("gelatin_carton", folder / "model")
    capture(folder / "model" / "model.ply", "su_h", 480, 360, 0, folder / "whole")
    ring = folder / "ring"
    names = [f"{index:06d}.png" for index in range(10, 20)]
    for part in ("images", "masks", "depth"):
        (ring / part).mkdir(parents=True)
        for name in names:
            shutil.copy(folder / "whole" / part / name, ring / part / name)
    cameras = read_sparse_model(folder / "whole" / "truth").cameras
    write_cameras(ring / "truth", [camera for camera in cameras if camera.name in names])
    return ring


@pytest.fixture
def blank_capture(tmp_path) -> Path:
    """Ten pictures with a mask but with nothing to match in them."""
    import numpy as np

    from zeroshop_steps.geometry.images import write_image, write_mask

    for index in range(10):
        mask = np.zeros((120, 160), bool)
        mask[40:80, 50 : 100 + index] = True
        write_image(tmp_path / "images" / f"{index:06d}.png", np.where(mask, 200, 40).astype(np.uint8)[..., None].repeat(3, axis=2))
        write_mask(tmp_path / "masks" / f"{index:06d}.png", mask)
    return tmp_path
