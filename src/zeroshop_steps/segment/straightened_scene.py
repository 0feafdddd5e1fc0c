"""Cameras that are bent spoil the masks that are found with them: what one photo shows, the others then seem to contradict.

A salient-object network looks at each photo by itself, so its outlines are free of that. Where the outlines of the found masks miss each
other, cameras are adjusted to those of the network, and the masks are found anew. Matches tell whether that was right: cameras that were
bent as a whole fit them nearly as well afterwards.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction, write_reconstruction
from zeroshop_steps.networks.saliency.object_finder import cut_main_things
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.refinement.silhouette_refinement import MOST_ERROR_GROWTH
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_masks
from zeroshop_steps.register.verification.predicted_masks import find_object_maps
from zeroshop_steps.runtime.files import link_or_copy

LEFT_SHARE = 0.5
"""Of what the network's outlines missed, in the mean, at most so much may be left. A bent travel mug kept 0.21 and 0.24; of cameras that
were right, 0.79 and 0.92 where matches still fitted."""


def straighten_scene(scene: Path, views: Sequence[View], network: SalientObjectNetwork, folder: Path) -> bool:
    """Fill a folder with a scene whose cameras are adjusted to the outlines that a network sees in each photo.

    Args:
        scene: the registration's folder.
        views: its views.
        network: sees the object.
        folder: to fill.

    Returns:
        Whether the outlines fit much better and the matches nearly as well as before. Otherwise the folder stays empty.
    """
    sizes_px = [(view.camera.width_px, view.camera.height_px) for view in views]
    masks = cut_main_things(find_object_maps(network, [view.image_path for view in views]), sizes_px)
    seen = {view.camera.name: mask for view, mask in zip(views, masks, strict=True) if mask.any() and not mask.all()}
    if not seen:
        return False
    adjusted = adjust_model_by_masks(read_reconstruction(scene / "sparse"), [view.camera for view in views], seen, found=True)
    (missed_px, left_px), (error_px, error_after_px) = adjusted.missed_px, adjusted.error_px
    if left_px > LEFT_SHARE * missed_px or error_after_px > MOST_ERROR_GROWTH * error_px:
        return False
    shutil.copytree(scene, folder, ignore=shutil.ignore_patterns("sparse"), copy_function=link_or_copy, dirs_exist_ok=True)
    write_reconstruction(adjusted.model, folder / "sparse")
    return True
