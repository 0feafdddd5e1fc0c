"""A model is improved only where it passes the checks still; photos that contradict it then are left out, if enough stay."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest

from zeroshop_steps.register import final_refinement
from zeroshop_steps.register.final_refinement import ROUGH_MISS_PX, Improver
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


def report(reason=None, culprits=()):
    return ConsistencyReport(None, None, {}, reason, culprits)


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
        return report("wrong" if culprits else None, culprits)

    monkeypatch.setattr(final_refinement, "refine_keypoints", lambda model, *_: (changed(model, "sharpened"), {"points": 100}))
    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", lambda model, *_: adjusted(changed(model, "outlines")))
    monkeypatch.setattr(
        final_refinement,
        "remove_images",
        lambda model, names: replace(model, images=tuple(name for name in model.images if name not in names)),
    )
    return lambda needed, found=False: Improver(SimpleNamespace(images=[], masks_found=found), check, needed, {"left_out": ["e"]})


def test_a_photo_that_contradicts_the_sharpened_model_is_left_out(improver):
    improver = improver(3)
    model, again = improver.refine_keypoints(Model(), report())
    assert model == Model(("a", "b", "c"), ("sharpened",)) and again.reason is None
    assert improver.figures["left_out"] == ["e", "d"]


def test_where_too_few_would_stay_the_model_stays_as_it_was(improver):
    improver, before = improver(4), report()
    assert improver.refine_keypoints(Model(), before) == (Model(), before)
    assert improver.adjust_by_silhouettes(Model(), before) == (Model(), before)
    assert improver.figures["left_out"] == ["e"] and improver.figures["outlines"] == {"miss_px": [0.4, 0.1], "adjusted": False}


def test_outlines_adjust_what_passes(improver):
    improver = improver(2)
    model, _ = improver.adjust_by_silhouettes(Model(), report())
    assert model == Model(("a", "b"), ("outlines",)) and improver.figures["outlines"]["adjusted"]


def test_rough_masks_are_not_used(improver, monkeypatch):
    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", lambda model, *_: adjusted(Model(("a",)), ROUGH_MISS_PX + 0.1))
    improver = improver(2)
    model, _ = improver.adjust_by_silhouettes(Model(), report())
    assert model == Model() and not improver.figures["outlines"]["adjusted"]


def test_aligned_points_count_by_their_noise_where_the_result_passes(improver, monkeypatch):
    improver, asked = improver(4), []

    def adjust(model, _images, _wrong, kind):
        asked.append(kind)
        return adjusted(replace(model, changes=("sharpened",) if kind is TrackKind.ALIGNED else ()))

    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", adjust)
    improver.figures["sharpened"] = {"points": 100}
    before = Model()
    model, _ = improver.adjust_by_silhouettes(before, report())
    assert model == before and model is not before and asked == [TrackKind.ALIGNED, TrackKind.MATCHED]
    model, _ = improver.adjust_by_silhouettes(Model(("a", "b", "c", "f")), report())
    assert model.changes == ("sharpened",) and asked[2:] == [TrackKind.ALIGNED]


def test_views_that_stand_out_by_found_masks_are_left_out_where_enough_stay(improver, monkeypatch):
    """A given mask is believed."""
    monkeypatch.setattr(final_refinement, "adjust_model_by_silhouettes", lambda model, *_: adjusted(model, 0.1, {"b"} & set(model.images)))
    for needed, found, kept in ((3, True, ("a", "c", "d")), (4, True, ("a", "b", "c", "d")), (3, False, ("a", "b", "c", "d"))):
        one = improver(needed, found)
        model, _ = one.adjust_by_silhouettes(Model(), report())
        assert model.images == kept and one.figures["outlines"].get("standing_out") == (["b"] if len(kept) == 3 else None)
