"""Bundle adjustment under a robust loss, the same bytes in every run."""

import pycolmap


def adjust_robustly(model: pycolmap.Reconstruction, scale_px: float, iterations: int, cameras: bool = True) -> None:
    """Adjust cameras and points of a model under a Cauchy loss, in place.

    Args:
        scale_px: of the loss: an error from which an observation counts clearly less.
        iterations: at most.
        cameras: whether poses and lenses are adjusted, too, or the points alone.
    """
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = scale_px
    options.ceres.solver_options.num_threads = 1  # on several, sums are formed in a changing order
    options.ceres.solver_options.max_num_iterations = iterations
    if not cameras:
        options.refine_focal_length = options.refine_extra_params = options.refine_rig_from_world = False
    pycolmap.bundle_adjustment(model, options)
