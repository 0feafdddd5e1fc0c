"""What a salient-object network saw in photos, beside their cameras: it takes seconds for each, so later steps read what it said.

`saliency/STEM.png` has 0 to 255 for 0 to 1; `saliency/finder.json` tells which network said so, and at which width. Maps of another network
or width do not count.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.images import decode_image, write_image
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.runtime.files import read_json, write_json

FOLDER = "saliency"
WIDTH_PX = 480  # of the maps that are kept: finer ones cost time and bring nothing to features
FINE_WIDTH_PX = 1000  # of those that cut the object out where its outline holds the cameras


def write_maps(scene: Path, network: SalientObjectNetwork, maps: Mapping[str, np.ndarray]) -> None:
    """Keep the maps, (h, w) of 0 to 1, of a scene's images, by their stems; finer ones than `WIDTH_PX` are reduced to it."""
    write_json(scene / FOLDER / "finder.json", _describe(network, WIDTH_PX))
    for stem, found in maps.items():
        height, width = found.shape
        if width > WIDTH_PX:
            found = cv2.resize(found, (WIDTH_PX, round(height * WIDTH_PX / width)), interpolation=cv2.INTER_AREA)
        write_image(scene / FOLDER / f"{stem}.png", np.round(255 * found).astype(np.uint8))


def find_maps(scene: Path, network: SalientObjectNetwork, images: Sequence[Path], width_px: int) -> list[np.ndarray]:
    """What it sees in each image of a scene, as `SalientObjectNetwork.find_maps`; it is asked only where no map is kept."""
    kept = read_maps(scene, network, width_px)
    missing = [path for path in images if path.stem not in kept]
    kept |= dict(zip((path.stem for path in missing), network.find_maps(missing, width_px), strict=True))
    return [kept[path.stem] for path in images]


def read_maps(scene: Path, network: SalientObjectNetwork, width_px: int) -> dict[str, np.ndarray]:
    """The maps that are kept of this network at this width, (h, w) float32, by the stems of their images."""
    described = scene / FOLDER / "finder.json"
    if not described.is_file() or read_json(described) != _describe(network, width_px):
        return {}
    files = sorted(described.parent.glob("*.png"))
    return {path.stem: decode_image(path, cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255 for path in files}


def _describe(network: SalientObjectNetwork, width_px: int) -> dict[str, Any]:
    return {**network.describe(), "width_px": width_px}
