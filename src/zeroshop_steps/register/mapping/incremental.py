"""Incremental structure from motion over a database of verified matches."""

from pathlib import Path

import pycolmap

MANY_GROWTH, MANY_REFINEMENTS = 1.4, 2  # the model grows by this factor between adjustments, each of so many rounds; COLMAP: 1.1, 5


def make_mapping_options(min_registered: int, seed: int, many: bool = False) -> pycolmap.IncrementalPipelineOptions:
    """Options of the incremental mapper.

    Args:
        min_registered: a model with fewer images is given up and the next initial pair is tried.
        seed: of all RANSAC loops.
        many: whether there are so many images that all cameras are adjusted together less often, which each time costs more.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size = min_registered
    # On several threads sums are formed in a changing order: not the same bytes, and at this size hardly faster.
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    if many:
        options.ba_global_frames_ratio = options.ba_global_points_ratio = MANY_GROWTH
        options.ba_global_max_refinements = MANY_REFINEMENTS
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
    return list(pycolmap.incremental_mapping(database, images, output, options).values())
