"""Cameras that are bent spoil the masks that are found with them: what one photo shows, the others then seem to contradict.

A salient-object network looks at each photo by itself, so its outlines are free of that. Where the outlines of the found masks miss each
other, cameras are adjusted to those of the network, and the masks are found anew. Matches tell whether that was right: cameras that were
bent as a whole fit them nearly as well afterwards. Where the network sees something else, they are adjusted to the found masks, if matches
fit no worse than before.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction, write_reconstruction
from zeroshop_steps.networks.saliency.object_finder import cut_main_things
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.refinement.silhouette_refinement import MOST_ERROR_GROWTH
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_masks
from zeroshop_steps.register.verification.predicted_masks import find_object_maps
from zeroshop_steps.runtime.files import link_or_copy

LEFT_SHARE, ERROR_GROWTH = 0.5, MOST_ERROR_GROWTH
"""Of what the network's outlines missed, in the mean, at most so much may be left, and reprojection errors may grow so much. A bent travel
mug kept 0.21 and 0.24; of cameras that were right, 0.79 and 0.92 where matches still fitted."""
FOUND_LEFT_SHARE, FOUND_ERROR_GROWTH = 0.8, 1.0
"""The same of the outlines of masks that were found with these cameras, which the cameras' errors may have spoilt: matches must agree."""


def see_things(views: Sequence[View], network: SalientObjectNetwork) -> list[np.ndarray]:
    """(H, W) bool: what a network sees in each photo."""
    sizes_px = [(view.camera.width_px, view.camera.height_px) for view in views]
    return cut_main_things(find_object_maps(network, [view.image_path for view in views]), sizes_px)


def straighten_scene(
    scene: Path, views: Sequence[View], masks: Sequence[np.ndarray], left_share: float, error_growth: float, folder: Path
) -> bool:
    """Fill a folder with a scene whose cameras are adjusted to the outlines of masks.

    Args:
        scene: the registration's folder.
        views: its views.
        masks: (H, W) bool in their order and size; empty or full ones do not count.
        left_share: of what the outlines missed, at most so much may be left.
        error_growth: of the mean reprojection error, at most.
        folder: to fill.

    Returns:
        Whether outlines and matches fit so well. Otherwise the folder stays empty.
    """
    seen = {view.camera.name: mask for view, mask in zip(views, masks, strict=True) if mask.any() and not mask.all()}
    if not seen:
        return False
    adjusted = adjust_model_by_masks(read_reconstruction(scene / "sparse"), [view.camera for view in views], seen, found=True)
    (missed_px, left_px), (error_px, error_after_px) = adjusted.missed_px, adjusted.error_px
    if left_px > left_share * missed_px or error_after_px > error_growth * error_px:
        return False
    shutil.copytree(scene, folder, ignore=shutil.ignore_patterns("sparse"), copy_function=link_or_copy, dirs_exist_ok=True)
    write_reconstruction(adjusted.model, folder / "sparse")
    return True
