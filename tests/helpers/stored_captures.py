"""The features and matches of all views of a rendered capture, computed once and kept, and those of some views out of them."""

import argparse
import pickle
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import Camera, read_sparse_model
from zeroshop_steps.geometry.imaging.images import write_mask
from zeroshop_steps.networks.aliked import FeatureMatcher
from zeroshop_steps.networks.saliency.object_finder import cut_main_things
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register import aliked, colmap
from zeroshop_steps.register.features.static_marks import StaticMark
from zeroshop_steps.register.matching.turntable import StationaryMatches
from zeroshop_steps.register.matching.verified_matches import verify_pairs
from zeroshop_steps.register.matching.view_graph import ViewGraph
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.lenses import import_images
from zeroshop_steps.register.scene.record import Stopwatch
from zeroshop_steps.register.verification.predicted_masks import find_object_maps
from zeroshop_steps.runtime.files import read_json, write_json


class StoredMatcher:
    """A network's features of all views, and the matches of the pairs that were asked for so far, kept in a file.

    Attributes:
        keypoints, similar: of all views, as `FeatureMatcher` has them.
    """

    def __init__(self, path: Path, prepare: Callable[[], FeatureMatcher]) -> None:
        self._path, self._prepare = path, prepare
        self._network: FeatureMatcher | None = None
        self._matches: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        if path.is_file():
            self.keypoints, self.similar, self._matches = pickle.loads(path.read_bytes())
        else:
            self._network = prepare()
            self.keypoints, self.similar = self._network.keypoints, self._network.similarities()

    def match(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """As `FeatureMatcher.match`, by the numbers among all views."""
        if (first, second) not in self._matches:
            self._network = self._network or self._prepare()
            self._matches[first, second] = self._network.match(first, second)
        return self._matches[first, second]

    def save(self) -> None:
        """Keep all that is known."""
        self._path.write_bytes(pickle.dumps((self.keypoints, self.similar, self._matches)))


@dataclass(frozen=True)
class SubsetMatcher:
    """What a network would say of some views: `FeatureMatcher` from what is stored of all."""

    stored: StoredMatcher
    numbers: np.ndarray

    @property
    def keypoints(self) -> list[np.ndarray]:
        """Of each view."""
        return [self.stored.keypoints[number] for number in self.numbers]

    def similarities(self) -> np.ndarray:
        """(N, N)."""
        return self.stored.similar[np.ix_(self.numbers, self.numbers)]

    def match(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """Of two views."""
        return self.stored.match(int(self.numbers[first]), int(self.numbers[second]))


@dataclass
class StoredCapture:
    """A capture with the features and matches of all its views; `read_matches` and `matcher` compute them where they are not kept yet.

    Attributes:
        network: finds the masks, in place of those that the renderer gave.
    """

    capture: Path
    folder: Path
    weights: Path
    network: Path | None = None
    images: ImageSet = field(init=False)
    truth: tuple[Camera, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.images = read_image_set(self.capture)
        if self.network:
            self.images = replace(self.images, masks=self._find_masks(self.network), masks_found=True)
        self.truth = read_sparse_model(self.capture / "truth").cameras
        self._matcher: StoredMatcher | None = None

    @property
    def scene(self) -> str:
        """Its name in the path."""
        return self.capture.parent.name

    def _find_masks(self, network: Path) -> tuple[Path, ...]:
        paths = tuple(self.folder / "masks" / name for name in self.images.names)
        if not all(path.is_file() for path in paths):
            maps = find_object_maps(SalientObjectNetwork(network), self.images.images)
            for path, mask in zip(paths, cut_main_things(maps, self.images.sizes_px), strict=True):
                write_mask(path, mask)
        return paths

    def matcher(self) -> StoredMatcher:
        """ALIKED's features and LightGlue's matches."""
        if self._matcher is None:
            arguments = argparse.Namespace(device="auto", weights=self.weights, threads=1)
            options = aliked.AlikedOptions()
            prepare = aliked.make_matcher(arguments, options)
            self._matcher = StoredMatcher(self.folder / "aliked.pkl", lambda: prepare(aliked.cut_crops(self.images, options.side_px)))
        return self._matcher

    def read_matches(self, options: colmap.ColmapOptions) -> tuple[Path, ViewGraph]:
        """The database of SIFT's features and matches of all views, and how they were matched."""
        database, record = self.folder / "sift.db", self.folder / "sift.json"
        if not record.is_file():
            database.unlink(missing_ok=True)
            write_json(record, asdict(colmap.match_images(database, self.images, options, Stopwatch())))
        stored = read_json(record)
        marks = tuple(StaticMark(**mark) for mark in stored.get("marks", []))
        return database, ViewGraph(**stored | {"stationary": StationaryMatches(**stored["stationary"]), "marks": marks})

    def save(self) -> None:
        """Keep what was matched."""
        if self._matcher is not None:
            self._matcher.save()


def copy_matches(stored: Path, database: Path, images: ImageSet, seed: int) -> None:
    """Write the features of some images and their matches from a database into a new one, and verify these by another seed."""
    import_images(database, images)
    pairs = []
    with pycolmap.Database.open(stored) as source, pycolmap.Database.open(database) as target:
        numbers = {name: (source.read_image_with_name(name).image_id, target.read_image_with_name(name).image_id) for name in images.names}
        for number, copied in numbers.values():
            target.write_keypoints(copied, source.read_keypoints(number))
        for place, one in enumerate(images.names):
            for other in images.names[place + 1 :]:
                if source.exists_matches(numbers[one][0], numbers[other][0]):
                    target.write_matches(numbers[one][1], numbers[other][1], source.read_matches(numbers[one][0], numbers[other][0]))
                    pairs.append((one, other))
    verify_pairs(database, pairs, seed)
