"""Classical structure from motion with COLMAP: SIFT, matching of pairs, a camera for each lens, incremental mapping.

The cameras are checked against the masks, if there are any, which had no part in finding them. Then images and masks are
undistorted. Too few registered images, or cameras that the images contradict, are a failure with a reason.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.register.camera_proposals import Proposer, propose
from zeroshop_steps.register.features.sift import SiftOptions, extract_features, find_focal_source, fit_to_count, refine
from zeroshop_steps.register.features.static_marks import StaticMarks, find_static_marks
from zeroshop_steps.register.features.tilted_features import VERTICAL, add_tilted_features, find_foreshortened, find_weak_images
from zeroshop_steps.register.image_sequence import are_in_order, keep_sequence
from zeroshop_steps.register.mapping.mapper import make_mapping_options
from zeroshop_steps.register.matching.pair_selection import choose_name_pairs
from zeroshop_steps.register.matching.turntable import TURNTABLE_REMEDY, measure_stationary, verify_without_stationary
from zeroshop_steps.register.matching.verified_matches import match_features
from zeroshop_steps.register.matching.view_graph import ViewGraph
from zeroshop_steps.register.matching.wide_lens import WIDE_LENS_REMEDY, find_wide_lenses, set_lenses
from zeroshop_steps.register.pipeline import StructureOptions, add_matching_arguments, read_structure_options, reconstruct
from zeroshop_steps.register.registration import add_options, read_options, write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import DuplicateStructure, Record, RegistrationFailed, Stopwatch, TooFewRegistered
from zeroshop_steps.register.verification.view_coverage import LEAST_SPREAD_DEG, LEAST_TURN_DEG, check_spread
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import scratch_directory

CACHED = Cached(inputs=("capture/images", "capture/masks", "capture/cameras.json"), ignored=("threads",))

Start = Callable[[Path], tuple[pycolmap.Reconstruction, dict[str, Any]]]
"""Gives a model from a database of verified matches, and entries of the record."""


@dataclass(frozen=True)
class ColmapOptions:
    """Parameters of the method.

    Attributes:
        sift: extraction and matching.
        structure: of the reconstruction; where it is of the object only, features come from inside the masks.
        weak_matches, weak_share: views with fewer verified matches, over all pairs, or less than this share of what a
            well-matched view has, get features of a stretched copy, too.
        tilt: how much that copy is stretched (5 suits a surface seen under 8 to 20 degrees).
    """

    sift: SiftOptions = field(default_factory=SiftOptions)
    structure: StructureOptions = field(default_factory=StructureOptions)
    weak_matches: int = 1000
    weak_share: float = 0.5
    tilt: float = 5.0


Match = Callable[[Path, ImageSet, ColmapOptions, Stopwatch], ViewGraph]
"""What fills a database with features and verified matches, as `match_images` does."""

METHOD = {"title": "COLMAP", "rank": 0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    add_own_arguments(parser)


def add_own_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that this method alone has."""
    add_options(parser, SiftOptions(), max_features="SIFT features per image")


def read_colmap_options(args: argparse.Namespace) -> ColmapOptions:
    """The options that the command line gives."""
    return ColmapOptions(read_options(SiftOptions, args), read_structure_options(args))


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    options, image_set = read_colmap_options(args), read_image_set(args.capture)
    write_registration(args.out, lambda folder: register(image_set, folder, options))


def register(image_set: ImageSet, out: Path, options: ColmapOptions, match: Match | None = None) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Args:
        image_set: what to register.
        out: folder to fill.
        options: see `ColmapOptions`.
        match: fills the database; None for `match_images`.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: too few images, or an inconsistent model.
    """
    with scratch_directory(out, "colmap") as scratch:
        return propose(out, make_proposers(image_set, options, scratch, match))


def make_proposers(image_set: ImageSet, options: ColmapOptions, scratch: Path, match: Match | None = None) -> list[Proposer]:
    """What registers a scene, or the object alone; then what mends it. The database is kept in `scratch`; the rest is as for `register`."""
    ways = _Ways(image_set, options, scratch / "database.db", match or match_images)
    first = Proposer("colmap", ways.register_first)
    finer = Proposer("finer features", ways.register_finer, ways.may_match_finer)
    ordered = Proposer("order of the images", ways.register_in_order, ways.may_unfold)
    return [first, ordered] if match else [first, finer, ordered]


@dataclass
class _Ways:
    """Ways to register images by the matches of one database; the later ones mend what failed before.

    Attributes:
        image_set, options: as for `register`.
        database: that `match` writes.
        match: fills the database.
        used, graph: the options that it was asked with last, and what it matched.
    """

    image_set: ImageSet
    options: ColmapOptions
    database: Path
    match: Match
    used: ColmapOptions | None = None
    graph: ViewGraph | None = None

    def register_first(self, out: Path, _: RegistrationFailed | None) -> dict[str, Any]:
        return self._register(fit_to_count(self.options.sift, len(self.image_set.images)), out)

    def may_match_finer(self, failure: RegistrationFailed) -> bool:
        """Whether too few images matched, by features that were not the finest."""
        return isinstance(failure, TooFewRegistered) and self._find_finer(failure) is not None

    def register_finer(self, out: Path, failure: RegistrationFailed | None) -> dict[str, Any]:
        finer = self._find_finer(failure) if failure else None
        assert finer is not None
        self.database.unlink()
        return self._register(finer, out)

    def may_unfold(self, failure: RegistrationFailed) -> bool:
        """Whether sides that look alike were merged, and the order of the images can tell them apart."""
        return isinstance(failure, DuplicateStructure) and are_in_order(self.database)

    def register_in_order(self, out: Path, _: RegistrationFailed | None) -> dict[str, Any]:
        assert self.used is not None, "the images were matched before"
        record = Record.begin("colmap", self.image_set, self.used, pycolmap)
        with scratch_directory(out, "order") as own:
            copy = own / self.database.name
            done = match_and_reconstruct(self.image_set, out, copy, self.used, record, match=self._keep_order, all_matches=self.database)
        return dict(done.entries)

    def _register(self, sift: SiftOptions, out: Path) -> dict[str, Any]:
        self.used = replace(self.options, sift=sift)
        record = Record.begin("colmap", self.image_set, self.used, pycolmap)
        return dict(match_and_reconstruct(self.image_set, out, self.database, self.used, record, match=self._match).entries)

    def _match(self, *asked: Any) -> ViewGraph:
        self.graph = self.match(*asked)
        return self.graph

    def _keep_order(self, copy: Path, *_: Any) -> ViewGraph:
        """The same matches but for those that contradict the order of the images."""
        assert self.graph is not None, "the images were matched before"
        mapper = make_mapping_options(self.options.structure.min_images, self.options.structure.seed)
        return replace(self.graph, pairs=tuple(keep_sequence(self.database, copy, self.image_set.images[0].parent, mapper)))

    def _find_finer(self, failure: RegistrationFailed) -> SiftOptions | None:
        return refine(self.options.sift, failure.figures["first_octave"], len(self.image_set.images))


def match_and_reconstruct(
    image_set: ImageSet,
    out: Path,
    database: Path,
    options: ColmapOptions,
    record: Record,
    start: Start | None = None,
    match: Match | None = None,
    all_matches: Path | None = None,
) -> Record:
    """Fill a new database with matches and register by them.

    Args:
        image_set, out, options, match: as for `register`.
        database: to write.
        record: that was begun; it is completed.
        start: gives a model of the matches to begin with.
        all_matches: as for `reconstruct`.
    """
    structure = options.structure
    graph = (match or match_images)(database, image_set, options, record.stopwatch)
    record, first = record.judge(graph.evidence()), None
    if start:
        try:
            first, found = start(database)
        except RegistrationFailed as failure:
            raise failure.after(record) from None
        record = record.add(**found)
    try:
        by_object, may_match = structure.object_only, graph.may_match()
        done = reconstruct(database, image_set, out, structure, record, may_match, by_object, first, all_matches)
        _check_spread(out, done, graph)
        return done
    except RegistrationFailed as failure:
        if graph.wide_lens:
            failure = failure.because(f"{failure}. {WIDE_LENS_REMEDY}")
        if not graph.on_turntable:
            raise failure from None
        still = graph.stationary.describe()
        reason = f"{still}, and what turns is too little to find the cameras ({failure}); {TURNTABLE_REMEDY}"
        if isinstance(failure, DuplicateStructure):  # photos of equal sides do not move either
            reason = f"{failure}. Or {still}: then {TURNTABLE_REMEDY}"
        raise failure.because(reason) from None


def _check_spread(folder: Path, record: Record, graph: ViewGraph) -> None:
    """Raise RegistrationFailed where all cameras look from one side."""
    try:
        check_spread(list(read_sparse_model(folder / "sparse").cameras), LEAST_TURN_DEG if graph.on_turntable else LEAST_SPREAD_DEG)
    except StepError as error:
        raise record.fail(str(error)) from None


def match_images(
    database: Path,
    image_set: ImageSet,
    options: ColmapOptions,
    stopwatch: Stopwatch,
    lenses: dict[str, pycolmap.Camera] | None = None,
) -> ViewGraph:
    """Write the features of all images and their verified matches into a new database; `lenses` are others than came with the capture."""
    structure, count, lenses = options.structure, len(image_set.images), lenses or image_set.lenses
    mask_folder = database.parent / "masks" if structure.object_only else None
    median_features, first_octave = extract_features(database, image_set, options.sift, mask_folder, lenses)
    focal_source = "given" if lenses or options.sift.focal_px is not None else find_focal_source(database)
    # On an object alone, what stands still in all pictures is rather a can that turns, whose outline stays where it is.
    marks = StaticMarks() if structure.object_only else find_static_marks(database, image_set)
    marks.leave_out(database, image_set)
    stopwatch.lap("extract")
    pairs = choose_name_pairs(image_set, options.sift, structure.object_only)
    stopwatch.lap("choose")
    match_features(database, options.sift, pairs)
    wide = {} if structure.object_only or lenses else find_wide_lenses(database, options.sift.seed)
    if wide:
        set_lenses(database, wide, options.sift.seed)
    stationary = measure_stationary(database, image_set, options.sift.seed)
    on_turntable = stationary.are_background and not structure.object_only
    if on_turntable:
        verify_without_stationary(database, image_set, options.sift.seed)
    stopwatch.lap("match")
    weak = [] if structure.object_only else find_weak_images(database, options.weak_matches, options.weak_share)
    flattened = find_foreshortened(database, weak)
    if not structure.leave_out:
        # Only oblique views benefit. On plain rendered grounds that was not measured: all weak ones are tilted there.
        flattened = {name: flattened.get(name, VERTICAL) for name in weak}
    if flattened:
        again = add_tilted_features(database, image_set, flattened, options.tilt, options.sift, pairs)
        marks.leave_out(database, image_set)
        match_features(database, options.sift, again)
        if on_turntable:
            verify_without_stationary(database, image_set, options.sift.seed)
    stopwatch.lap("stretch")
    matched = count * (count - 1) // 2 if pairs is None else len(pairs)
    every = None if pairs is None else tuple(pairs)
    tilted = tuple(sorted(flattened))
    return ViewGraph(median_features, first_octave, focal_source, matched, stationary, on_turntable, tilted, every, marks.found, bool(wide))
