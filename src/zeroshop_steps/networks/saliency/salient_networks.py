"""Salient-object networks that are known by name: where their files lie, and how each expects its images.

U-2-Net (Qin et al. 2020) and its small version u2netp, IS-Net (Qin et al. 2022), BiRefNet (Zheng et al. 2024).
"""

from dataclasses import dataclass
from pathlib import Path

from zeroshop_steps.networks.imagenet import LEVEL_DEVIATION, LEVEL_MEAN
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, read_table, require_weights
from zeroshop_steps.runtime.errors import StepError, warn

FOLDER = "saliency"
Levels = tuple[float, ...]


@dataclass(frozen=True)
class SalientNetwork:
    """A network that is known by name.

    Attributes:
        name: of the network and of its file below resources/weights.
        side_px: of its square input.
        published_as: other names of its file, in lower case, without the ending.
        mean, deviation: of red, green and blue, 0 to 255, in training: it takes (level - mean) / deviation. The U-2-Net code divides levels
            by the brightest one of the photo instead of 255. In most photos that is the same; in a dark photo, the answer would depend on
            one pixel.
    """

    name: str
    side_px: int
    published_as: tuple[str, ...] = ()
    mean: Levels = LEVEL_MEAN
    deviation: Levels = LEVEL_DEVIATION

    @property
    def file(self) -> str:
        """Its row in weights.csv."""
        return f"{FOLDER}/{self.name}.onnx"

    @property
    def path(self) -> Path:
        """Where its file belongs, as seen from the folder that holds resources/."""
        return WEIGHTS_FOLDER / self.file


NETWORKS = {
    network.name: network
    for network in (
        SalientNetwork("u2netp", 320),
        SalientNetwork("u2net", 320),
        SalientNetwork("isnet", 1024, ("isnet-general-use",), (127.5, 127.5, 127.5), (255.0, 255.0, 255.0)),
        SalientNetwork("birefnet", 1024, ("birefnet-general", "birefnet-general-epoch_244")),
    )
}
DEFAULT = "u2netp"
"""The one that comes with the set-up. It alone may be missing where nobody asked for it."""
NONE = "none"
"""In place of a name, for no network: Snakemake's command line cannot give null."""


def network_path(network: str) -> Path:
    """The file of a network, given by its name or by the path of an ONNX file."""
    return NETWORKS[network].path if network in NETWORKS else Path(network)


def find_network(network: str, needed: bool, root: Path = Path(), advice: str = "") -> Path | None:
    """The file of a network that a user names; None for NONE. The default one may be absent where it is not needed: a warning says so.

    Args:
        network: a name of `NETWORKS`, the path of an ONNX file, or NONE.
        needed: whether there must be one.
        root: the folder that holds resources/.
        advice: ends the message.

    Raises:
        StepError: it is missing or damaged.
    """
    if network == NONE:
        if needed:
            raise StepError(f"segment.saliency.network is none; name a network: {', '.join(NETWORKS)}, or an ONNX file")
        return None
    try:
        return require_weights(NETWORKS[network].file, root) if network in NETWORKS else require_network(Path(network))
    except StepError as error:
        if needed or network != DEFAULT:
            raise StepError(f"{error}{advice}") from None
        warn(f"objects are found without a salient-object network: {error}{advice}")
        return None


def require_network(path: Path) -> Path:
    """Return `path`, a network's file that is there; where it is that of a named one, its size and SHA-256 are checked.

    Raises:
        StepError: the file is missing, was cut short, or is another one.
    """
    for known in NETWORKS.values():
        if path == known.path:
            return require_weights(known.file)
    if not path.is_file():
        raise StepError(
            f"the network {path} does not exist; segment.saliency.network (--network) is the ONNX file of a salient-object network, or one"
            f" of {', '.join(NETWORKS)}"
        )
    return path


def recognize_network(path: Path, sha256: str, size_px: tuple[int, int]) -> SalientNetwork | None:
    """The network that a file holds: by its SHA-256, or by its name and the (width, height) of its input; None where that is not sure."""
    table = read_table()
    for known in NETWORKS.values():
        named = path.stem.lower() in (known.name, *known.published_as)
        if sha256 == table[known.file].sha256 or (named and size_px == (known.side_px, known.side_px)):
            return known
    return None
