"""Which weights of MobileSAM a step uses: the published ones, the user's own, or none."""

from pathlib import Path

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, require_weights
from zeroshop_steps.runtime.errors import StepError, warn

DEFAULT, FILE, NONE = "mobile_sam", "mobile_sam.pt", "none"


def segmenter_path(segmenter: str) -> Path | None:
    """The file of weights that DEFAULT or a path names; None for NONE."""
    return None if segmenter == NONE else WEIGHTS_FOLDER / FILE if segmenter == DEFAULT else Path(segmenter)


def find_segmenter(segmenter: str, root: Path = Path(), advice: str = "") -> Path | None:
    """The file of weights that DEFAULT or a path names; None for NONE, and with a warning where the published ones are not there.

    Args:
        segmenter: the name or path.
        root: the folder that holds resources/.
        advice: ends the warning.

    Raises:
        StepError: the user's own file does not exist.
    """
    if segmenter != DEFAULT:
        path = segmenter_path(segmenter)
        if path is not None and not path.is_file():
            raise StepError(
                f"the weights {path} do not exist; segment.saliency.segmenter (--segmenter) is {DEFAULT}, a file of such weights, or {NONE}"
            )
        return path
    try:
        return require_weights(FILE, root)
    except StepError as error:
        warn(f"objects are cut out without Segment Anything: {error}{advice}")
        return None
