"""A model is improved only where it passes the checks still; photos that contradict it then are left out, if enough stay."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest

from zeroshop_steps.register import final_refinement
from zeroshop_steps.register.final_refinement import ROUGH_MISS_PX, Hypothesis, Improver
from zeroshop_steps.register.scene.record import Finding
from zeroshop_steps.register.silhouettes.model_adjustment import AdjustedModel
from zeroshop_steps.register.silhouettes.state import TrackKind
from zeroshop_steps.register.verification.consistency import ConsistencyReport


@dataclass(frozen=True)
class Model:
    """Names of the registered images, and what was done to it."""

    images: tuple[str, ...] = ("a", "b", "c", "d")
    changes: tuple[str, ...] = ()

    def num_reg_images(self):
        return len(self.images)


def report(culprits=()):
    return ConsistencyReport(None, None, {}, (Finding("error", 3.0, "wrong", culprits),) if culprits else ())


def passed(model):
    return Hypothesis(model, report(), left_out=("e",))


def changed(model, word):
    return replace(model, changes=(*model.changes, word))


def adjusted(model, missed_px=0.1, standing_out=()):
    return AdjustedModel(model, [], (0.4, missed_px), (0.0, 0.0), list(standing_out))


@pytest.fixture
def improver(monkeypatch):
    """Of models in which the image `d` contradicts every change, and `c` those by outlines, too."""

    def check(model):
        bad = {"sharpened": {"d"}, "outlines": {"c", "d"}}
        culprits = tuple(sorted(set(model.images) & set().union(*(bad[change] for change in model.changes))))
        return report(culprits)

    monkeypatch.setattr(final_refinement, "refine_keypoints", lambda model, *_: (changed(model, "sharpened"), {"points": 100}))
    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", lambda model, *_: adjusted(changed(model, "outlines")))
    monkeypatch.setattr(
        final_refinement,
        "remove_images",
        lambda model, names: replace(model, images=tuple(name for name in model.images if name not in names)),
    )
    return lambda needed, found=False: Improver(SimpleNamespace(images=[], masks_found=found), check, needed)


def test_a_photo_that_contradicts_the_sharpened_model_is_left_out(improver):
    found, entries = improver(3).refine_keypoints(passed(Model()))
    assert found.model == Model(("a", "b", "c"), ("sharpened",)) and not found.report.is_doubtful
    assert found.left_out == ("e", "d") and entries == {"sharpened": {"points": 100}}


def test_where_too_few_would_stay_the_model_stays_as_it_was(improver):
    improver, before = improver(4), passed(Model())
    assert improver.refine_keypoints(before)[0] is before
    after, entries = improver.adjust_by_silhouettes(before, False)
    assert after is before and entries == {"outlines": {"miss_px": [0.4, 0.1], "adjusted": False}}


def test_outlines_adjust_what_passes(improver):
    found, entries = improver(2).adjust_by_silhouettes(passed(Model()), False)
    assert found.model == Model(("a", "b"), ("outlines",)) and entries["outlines"]["adjusted"]


def test_rough_masks_are_not_used(improver, monkeypatch):
    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", lambda model, *_: adjusted(Model(("a",)), ROUGH_MISS_PX + 0.1))
    found, entries = improver(2).adjust_by_silhouettes(passed(Model()), False)
    assert found.model == Model() and not entries["outlines"]["adjusted"]


def test_aligned_points_count_by_their_noise_where_the_result_passes(improver, monkeypatch):
    improver, asked = improver(4), []

    def adjust(model, _images, _wrong, kind):
        asked.append(kind)
        return adjusted(replace(model, changes=("sharpened",) if kind is TrackKind.ALIGNED else ()))

    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", adjust)
    before = Model()
    model = improver.adjust_by_silhouettes(passed(before), True)[0].model
    assert model == before and model is not before and asked == [TrackKind.ALIGNED, TrackKind.MATCHED]
    model = improver.adjust_by_silhouettes(passed(Model(("a", "b", "c", "f"))), True)[0].model
    assert model.changes == ("sharpened",) and asked[2:] == [TrackKind.ALIGNED]


def test_views_that_stand_out_by_found_masks_are_left_out_where_enough_stay(improver, monkeypatch):
    """A given mask is believed."""
    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", lambda model, *_: adjusted(model, 0.1, {"b"} & set(model.images)))
    for needed, found, kept in ((3, True, ("a", "c", "d")), (4, True, ("a", "b", "c", "d")), (3, False, ("a", "b", "c", "d"))):
        one = improver(needed, found)
        changed, entries = one.adjust_by_silhouettes(passed(Model()), False)
        assert changed.model.images == kept and entries["outlines"].get("standing_out") == (["b"] if len(kept) == 3 else None)
