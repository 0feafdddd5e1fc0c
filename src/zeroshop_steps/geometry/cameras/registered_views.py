"""Registered photos with their cameras and masks."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, SparseModel, read_sparse_model
from zeroshop_steps.geometry.imaging.images import read_confidence, read_image, read_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.tables import read_table

PASSES = "passes.json"
"""Beside cameras of several passes: which images belong to which."""

DEVIATIONS = "camera_deviation.csv"
"""Beside cameras that were estimated: how surely each is held."""

CONFIDENCE = "confidence"  # the folder beside masks/; a mask without a file there is sure everywhere
SEGMENTATION = "segmentation.json"  # the file beside masks/ that says how they were found and how good they are


@dataclass(frozen=True)
class View:
    """A photo, its mask and its camera. Pixels are read on demand.

    Attributes:
        camera: the photo's camera.
        image_path, mask_path: the files; `mask_path` is None without masks.
        pass_number: 1, or that of a later pass, in which the object lay differently.
    """

    camera: Camera
    image_path: Path
    mask_path: Path | None
    pass_number: int = field(default=1, kw_only=True)

    @property
    def own_stem(self) -> str:
        """The stem of the photo's name in the capture of its pass."""
        return Path(self.camera.name).stem.removeprefix(f"{self.pass_number}_")

    def image(self) -> np.ndarray:
        """(height, width, 3) uint8 sRGB."""
        image = read_image(self.image_path)
        if image.shape[:2] != (self.camera.height_px, self.camera.width_px):
            raise StepError(
                f"{self.image_path} is {image.shape[1]} x {image.shape[0]} px, its camera {self.camera.width_px} x "
                f"{self.camera.height_px} px; images and cameras must come from one registration: run it again"
            )
        return image

    def mask(self) -> np.ndarray:
        """(height, width) bool, True on the object; all True without a mask."""
        if self.mask_path is None:
            return np.ones((self.camera.height_px, self.camera.width_px), bool)
        return read_mask(self.mask_path, (self.camera.width_px, self.camera.height_px))

    def confidence(self) -> np.ndarray | None:
        """(height, width) float32 how sure the mask is at each pixel, 0 to 1; None if it is sure everywhere."""
        if self.mask_path is None:
            return None
        path = self.mask_path.parent.with_name(CONFIDENCE) / self.mask_path.name
        return read_confidence(path, (self.camera.width_px, self.camera.height_px)) if path.is_file() else None


def space_evenly(count: int, most: int) -> list[int]:
    """Numbers of at most `most` of `count` things in their order: the first, the last, and those evenly between them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()


def read_views(folder: Path, sparse: str = "sparse") -> tuple[list[View], SparseModel]:
    """Read what the register stage writes; the folder of its cameras may have another name.

    Returns:
        views: one for each registered image, sorted by name.
        model: the cameras and sparse points.
    """
    folder = Path(folder)
    model = read_sparse_model(folder / sparse)
    if not model.cameras:
        raise StepError(f"{folder / sparse} has no registered cameras; run registration again")
    passes = read_passes(folder)
    views = []
    for camera in model.cameras:
        mask = folder / "masks" / (Path(camera.name).stem + ".png")
        mask_path = mask if (folder / "masks").is_dir() else None
        views.append(View(camera, folder / "images" / camera.name, mask_path, pass_number=passes.get(camera.name, 1)))
    return views, model


def find_possible(mask: np.ndarray, confidence: np.ndarray | None) -> np.ndarray:
    """(height, width) bool: the pixels that may show the object, because the mask says so or is not sure."""
    return mask if confidence is None else mask | (confidence < 0.5)


def read_passes(folder: Path) -> dict[str, int]:
    """{image name: number of its pass} of a folder of cameras; empty where there was one pass only."""
    path = Path(folder) / PASSES
    return {name: one["number"] for one in read_json(path)["passes"] for name in one["images"]} if path.is_file() else {}


def read_deviations(folder: Path) -> dict[str, float]:
    """{image name: deviation_px} of a folder of cameras: the standard deviation of where the object lies in the image.

    It is empty where nothing was written, as of true cameras.
    """
    path = Path(folder) / DEVIATIONS
    return {row.image: float(row.deviation_px) for row in read_table(path).itertuples()} if path.is_file() else {}


def choose_standing(views: Sequence[View]) -> list[View]:
    """The views of the first pass, in which the object stands on its support: they say what is up."""
    return [view for view in views if view.pass_number == 1]


def read_first_cameras(folder: Path) -> tuple[Camera, ...]:
    """The registered cameras of the first pass, whose frame is that of all.

    They alone say how a joined model lies to the truth: a plain bowl's second pass may be turned about its axis, which no photo shows.
    """
    return tuple(view.camera for view in choose_standing(read_views(folder)[0]))


def read_object_masks(views: Sequence[View]) -> list[np.ndarray]:
    """The views' masks. Raises StepError where one is empty."""
    masks = [view.mask() for view in views]
    for view, mask in zip(views, masks, strict=True):
        if not mask.any():
            raise StepError(f"mask {view.mask_path} is empty; segment that image again or leave it out")
    return masks


def read_mask_record(folder: Path | None) -> dict[str, Any]:
    """What `SEGMENTATION` beside the masks says; where there is none, the user gave the masks."""
    return read_json(folder / SEGMENTATION) if folder and (folder / SEGMENTATION).is_file() else {"method": "given"}
