"""What is matched with what: the pairs of images, and groups that show something in common.

Photos of another place or thing have no matches with the others.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from zeroshop_steps.register.features.static_marks import StaticMark, describe_marks
from zeroshop_steps.register.matching.turntable import TURNTABLE_REMEDY, StationaryMatches
from zeroshop_steps.register.scene.database import LEAST_TIES, read_matches
from zeroshop_steps.register.scene.record import Evidence


@dataclass(frozen=True)
class ViewGraph:
    """How the images of a database were matched.

    Attributes:
        median_features: of an image.
        first_octave: of the scale space that features were taken from.
        focal_source: given, exif or estimated: of the focal length to start from.
        matched_pairs: how many pairs were matched.
        stationary: the matches that stand still.
        on_turntable: whether the background stood still while the object turned: matches of what stands still were left out.
        tilted: names of the images that got features of a tilted copy.
        pairs: names of the images of each pair that was matched; None for all pairs.
        marks: that stand still in the photos, whose features were left out.
        wide_lens: whether the matches show a wide lens.
    """

    median_features: float
    first_octave: int
    focal_source: str
    matched_pairs: int
    stationary: StationaryMatches
    on_turntable: bool
    tilted: tuple[str, ...] = ()
    pairs: tuple[tuple[str, str], ...] | None = None
    marks: tuple[StaticMark, ...] = ()
    wide_lens: bool = False

    def evidence(self) -> Evidence:
        """As written to registration.json."""
        entries = {
            "median_features": self.median_features,
            "first_octave": self.first_octave,
            "focal_source": self.focal_source,
            "matched_pairs": self.matched_pairs,
            **{f"still_{name}": share for name, share in asdict(self.stationary).items()},
            "still_background": self.on_turntable,
            "stretched": list(self.tilted),
            "static_marks": [asdict(mark) for mark in self.marks],
        }
        found = f"{self.stationary.describe()}: the cameras are found from what turns; {TURNTABLE_REMEDY}"
        return Evidence(entries, warnings=(*describe_marks(self.marks), *([found] if self.on_turntable else [])))

    def may_match(self) -> Callable[[str, str], bool] | None:
        """Whether two images, by the stems of their names, were not matched, so that they may show the same; None where all were."""
        if self.pairs is None:
            return None
        tested = {frozenset(Path(name).stem for name in pair) for pair in self.pairs}
        return lambda one, other: frozenset((one, other)) not in tested


def find_components(database: Path) -> list[list[str]]:
    """Names of the images that verified matches of pairs tie together, directly or through others; the largest group first."""
    with pycolmap.Database.open(database) as opened:
        images = sorted(opened.read_all_images(), key=lambda image: image.name)
        row = {image.image_id: index for index, image in enumerate(images)}
        pairs = [[row[image_id] for image_id in pair] for pair, matches in read_matches(opened) if len(matches) >= LEAST_TIES]
    one, other = np.array(pairs, int).reshape(-1, 2).T
    labels = connected_components(coo_matrix((np.ones(len(one)), (one, other)), shape=(len(images),) * 2), directed=False)[1]
    groups = [[images[index].name for index in np.flatnonzero(labels == label)] for label in np.unique(labels)]
    return sorted(groups, key=lambda names: (-len(names), names))


def describe_components(groups: list[list[str]], shown: dict[str, str]) -> str:
    """The groups in words, by the names that the user knows."""
    several = [f"{len(names)} photos ({shown[names[0]]} to {shown[names[-1]]})" for names in groups if len(names) > 1]
    single = sum(len(names) == 1 for names in groups)
    return ", ".join(several + ([f"{single} that fit to no other"] if single else []))
