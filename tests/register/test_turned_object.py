"""Photos of an object that was turned before a still, textured background: networks must see the object alone."""

import argparse
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from helpers.made_scene import made_scene
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.networks.mast3r.framing import load_picture
from zeroshop_steps.register import mast3r
from zeroshop_steps.register.colmap import ColmapOptions
from zeroshop_steps.register.da3 import solve as da3_solve
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.pipeline import StructureOptions
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import OBJECT_ONLY
from zeroshop_steps.register.vggt import frames
from zeroshop_steps.register.vggt import solve as vggt_solve
from zeroshop_steps.register.vggt.options import VggtOptions
from zeroshop_steps.runtime.errors import StepError

AZIMUTHS_DEG = [40.0 * number for number in range(9)]


class Seen(Exception):
    """Ends a step once its network has got its pictures."""


@pytest.fixture(scope="module")
def turned(tmp_path_factory) -> tuple[Path, ImageSet]:
    """A capture of a carton that turns before a background of noise, and the same object on black."""
    scene = made_scene(AZIMUTHS_DEG, [25.0] * len(AZIMUTHS_DEG), width_px=192, height_px=144)
    still, black = (tmp_path_factory.mktemp(name) for name in ("still", "black"))
    sets = [scene.image_set(folder) for folder in (still, black)]
    noise = cv2.resize(np.random.default_rng(0).integers(0, 256, (36, 48, 3), dtype=np.uint8), (192, 144))
    for path, other, mask in zip(sets[0].images, sets[1].images, scene.masks, strict=True):
        image = read_image(path)
        write_image(path, np.where(mask[..., None], image, noise))
        write_image(other, image * mask[..., None])
    return still, sets[1]


def options_of(module, capture: Path, scene: str, out: Path) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    (out / "weights").touch()
    words = ["--capture", str(capture), "--scene", scene, "--out", str(out / "cameras"), "--weights", str(out / "weights")]
    return parser.parse_args([*words, "--device", "cpu"])


@pytest.mark.parametrize(("scene", "bare"), [("video_segmented", True), ("video", False)])
def test_mast3r_sees_the_turned_object_alone(turned, scene, bare, tmp_path, monkeypatch):
    capture, on_black = turned
    seen = []

    def predictor(network, paths, device, long_side_px, masks):
        seen.extend(load_picture(path, long_side_px, mask)[0] for path, mask in zip(paths, masks or [None] * len(paths), strict=True))
        raise Seen

    monkeypatch.setattr(mast3r, "Mast3rPredictor", predictor)
    monkeypatch.setattr(mast3r, "load_mast3r", lambda weights: None)
    monkeypatch.setattr(mast3r, "resolve_weights", lambda *given: given[0])
    with pytest.raises(Seen):
        mast3r.run(options_of(mast3r, capture, scene, tmp_path))
    expected = [load_picture(path)[0] for path in on_black.images]
    assert len(seen) == len(expected)
    assert all(torch.equal(*pair) == bare for pair in zip(seen, expected, strict=True))


@pytest.mark.parametrize("method", ["vggt", "da3"])
@pytest.mark.parametrize(("scene", "bare"), [("video_segmented", True), ("video", False)])
def test_networks_of_all_images_see_the_turned_object_alone(turned, method, scene, bare, tmp_path):
    capture, on_black = turned

    class Network:
        def predict(self, pixels: np.ndarray) -> None:
            expected = frames.read_frames(on_black, 140, 14).pixels
            assert [np.array_equal(*pair) for pair in zip(pixels, expected, strict=True)] == [bare] * len(expected)
            raise Seen

    object_only = scene in OBJECT_ONLY
    structure = StructureOptions(object_only=object_only)
    vggt, da3 = VggtOptions(structure=structure), Da3Options(colmap=ColmapOptions(structure=structure))
    options, module = {"vggt": (vggt, vggt_solve), "da3": (da3, da3_solve)}[method]
    with pytest.raises(Seen):
        module.register(read_image_set(capture), tmp_path, options, Network(), 140, 14, {})


def test_an_object_without_masks_is_refused(turned, tmp_path):
    _, on_black = turned
    with pytest.raises(StepError, match="has no masks"):
        frames.read_frames(ImageSet(on_black.images, None, on_black.sizes_px), 140, 14, object_only=True)
