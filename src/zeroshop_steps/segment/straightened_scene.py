"""Cameras that are bent spoil the masks that are found with them: what one photo shows, the others then seem to contradict.

A salient-object network looks at each photo by itself, so its outlines are free of that. Where the outlines of the found masks miss each
other, cameras are adjusted to those of the network, and the masks are found anew. Matches tell whether that was right: cameras that were
bent as a whole fit them nearly as well afterwards. Where the network sees something else, they are adjusted to the found masks, if matches
fit no worse than before.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction, write_reconstruction
from zeroshop_steps.networks.saliency.object_finder import cut_main_things
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.refinement.silhouette_refinement import MOST_ERROR_GROWTH
from zeroshop_steps.register.silhouettes.model_adjustment import AdjustedModel, adjust_model_by_masks
from zeroshop_steps.register.verification.predicted_masks import find_object_maps
from zeroshop_steps.runtime.files import link_or_copy


class Limits(NamedTuple):
    """When an adjustment is kept: what outlines miss, and reprojection errors, in the mean, as shares of what they were before."""

    missed: float
    error: float


BY_NETWORK = Limits(0.5, MOST_ERROR_GROWTH)
"""A bent travel mug had 0.21 and 0.24 of its misses left; cameras that were right 0.79 and 0.92 where matches still fitted."""
BY_FOUND = Limits(0.8, 1.0)
"""Of masks that were found with these cameras, which bent ones spoil: matches must agree. A figure on a table had 0.69 and 0.99; a bear and
a gnome whose masks lack parts 0.77 and 1.09, 0.86 and 1.32."""


def straighten_scene(
    scene: Path, views: Sequence[View], masks: dict[str, np.ndarray], network: SalientObjectNetwork | None, folder: Path
) -> bool:
    """Fill a folder with a scene whose cameras are adjusted to the outlines that a network sees in each photo, else to those of masks.

    Args:
        scene: the registration's folder.
        views: its views.
        masks: {image name: (H, W) bool} that were found with these cameras; images without one are held by matches alone.
        network: sees the object.
        folder: to fill.

    Returns:
        Whether outlines and matches fit within the limits. Otherwise the folder stays empty.
    """
    adjusted = None if network is None else _adjust(scene, views, see_things(views, network), BY_NETWORK)
    adjusted = adjusted or _adjust(scene, views, masks, BY_FOUND)
    if adjusted is None:
        return False
    shutil.copytree(scene, folder, ignore=shutil.ignore_patterns("sparse"), copy_function=link_or_copy, dirs_exist_ok=True)
    write_reconstruction(adjusted.model, folder / "sparse")
    return True


def see_things(views: Sequence[View], network: SalientObjectNetwork) -> dict[str, np.ndarray]:
    """{image name: (H, W) bool}: what a network sees in each photo."""
    sizes_px = [(view.camera.width_px, view.camera.height_px) for view in views]
    seen = cut_main_things(find_object_maps(network, [view.image_path for view in views]), sizes_px)
    return {view.camera.name: mask for view, mask in zip(views, seen, strict=True)}


def _adjust(scene: Path, views: Sequence[View], masks: dict[str, np.ndarray], limits: Limits) -> AdjustedModel | None:
    """The scene's model adjusted to the outlines of masks, {image name: (H, W) bool}; None where it does not fit within the limits."""
    seen = {name: mask for name, mask in masks.items() if mask.any() and not mask.all()}
    if not seen:
        return None
    adjusted = adjust_model_by_masks(read_reconstruction(scene / "sparse"), [view.camera for view in views], seen, found=True)
    (missed_px, left_px), (error_px, error_after_px) = adjusted.missed_px, adjusted.error_px
    return adjusted if left_px <= limits.missed * missed_px and error_after_px <= limits.error * error_px else None
