"""COLMAP's mapper, with the same bytes in every run: incremental mapping, bundle adjustment, triangulation."""

from collections.abc import Callable
from pathlib import Path

import pycolmap

from zeroshop_steps.register.scene.database import has_wide_lens
from zeroshop_steps.register.scene.image_set import ImageSet

WIDE_COEFFICIENT = 100.0  # of a fisheye's polynomial whose focal length is far from that of the ideal lens
GROWTH, REFINEMENTS = 1.4, 2
"""The model grows by this factor between adjustments of all cameras, each of so many rounds; COLMAP's 1.1 and 5 take half as long again,
and every model is refined afterwards. Of a rendered bottle, centres are 0.07 mm off with either."""


def make_mapping_options(min_registered: int, seed: int) -> pycolmap.IncrementalPipelineOptions:
    """Options of the incremental mapper.

    Args:
        min_registered: a model with fewer images is given up and the next initial pair is tried.
        seed: of all RANSAC loops.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size = min_registered
    # On several threads sums are formed in a changing order: not the same bytes, and at this size hardly faster.
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.ba_global_frames_ratio = options.ba_global_points_ratio = GROWTH
    options.ba_global_max_refinements = REFINEMENTS
    return options


def map_incrementally(
    database: Path, images: Path, output: Path, options: pycolmap.IncrementalPipelineOptions
) -> pycolmap.Reconstruction | None:
    """Reconstruct; the model with the most images (then the most points) is returned, None when there is none."""
    models = map_submodels(database, images, output, options)
    return max(models, key=lambda model: (model.num_reg_images(), model.num_points3D()), default=None)


def map_submodels(
    database: Path, images: Path, output: Path, options: pycolmap.IncrementalPipelineOptions
) -> list[pycolmap.Reconstruction]:
    """Reconstruct; the models of all groups of images that fit together."""
    output.mkdir(parents=True, exist_ok=True)
    pycolmap.set_random_seed(max(options.random_seed, 0))
    if has_wide_lens(database):  # its coefficients together may exceed 1, from which on COLMAP drops an image
        options.max_extra_param = options.mapper.max_extra_param = WIDE_COEFFICIENT
    return list(pycolmap.incremental_mapping(database, images, output, options).values())


def make_adjustment_options(scale_px: float, iterations: int) -> pycolmap.BundleAdjustmentOptions:
    """Options of bundle adjustment under a Cauchy loss of this scale, with so many iterations at most, whose bytes repeat."""
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = scale_px
    options.ceres.solver_options.num_threads = 1  # on several, sums are formed in a changing order
    options.ceres.solver_options.max_num_iterations = iterations
    return options


def adjust_robustly(model: pycolmap.Reconstruction, scale_px: float, iterations: int, cameras: bool = True) -> None:
    """Adjust cameras and points of a model under a Cauchy loss, in place.

    Args:
        scale_px: of the loss: an error from which an observation counts clearly less.
        iterations: at most.
        cameras: whether poses and lenses are adjusted, too, or the points alone.
    """
    options = make_adjustment_options(scale_px, iterations)
    if not cameras:
        options.refine_focal_length = options.refine_extra_params = options.refine_rig_from_world = False
    pycolmap.bundle_adjustment(model, options)


def triangulate_points(
    database: Path,
    image_set: ImageSet,
    camera_from_world: dict[str, pycolmap.Rigid3d],
    seed: int,
    change: Callable[[pycolmap.IncrementalPipelineOptions], None] | None = None,
    lens: pycolmap.Camera | None = None,
) -> pycolmap.Reconstruction:
    """Sparse points from the matches of a database, with its cameras held fixed at {image stem: pose}.

    Args:
        database: with verified matches; what COLMAP writes lies beside it.
        image_set: the images.
        camera_from_world: an image without a pose is left out.
        seed: of RANSAC.
        change: of the usual options.
        lens: whose parameters all cameras have instead of those in the database.
    """
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        for camera in opened.read_all_cameras():
            if lens:
                camera.params = lens.params
            model.add_camera_with_trivial_rig(camera)
        for image in sorted(opened.read_all_images(), key=lambda image: image.name):
            pose = camera_from_world.get(Path(image.name).stem)
            if pose is not None:
                placed = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
                model.add_image_with_trivial_frame(placed, pose)
    mapper = make_mapping_options(len(image_set.images), seed)
    if change:
        change(mapper)
    output = database.parent / "triangulated"
    output.mkdir(exist_ok=True)
    return pycolmap.triangulate_points(model, database, image_set.images[0].parent, output, options=mapper)
