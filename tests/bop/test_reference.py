"""Errors and scores agree with those recorded from bop_toolkit (helpers/bop_reference_cases.py tells how)."""

import json
from pathlib import Path

import numpy as np
import pytest
from pycocotools import mask as coco_masks

from helpers import bop_reference_cases as cases
from zeroshop_steps.bop.formats.bop_scenes import Frame, Instance
from zeroshop_steps.bop.formats.detections import Detection, encode_mask, mask_to_box
from zeroshop_steps.bop.formats.symmetry import list_symmetry_transforms
from zeroshop_steps.bop.scoring.depth_render import DepthPatch
from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mspd, mssd, vsd
from zeroshop_steps.bop.scoring.precision import MEASURES, average_precision
from zeroshop_steps.bop.scoring.recall import THRESHOLDS, PosePairs, count_found_instances

REFERENCE = json.loads(Path(__file__).with_name("reference.json").read_text())


@pytest.mark.parametrize("name", cases.MODELS_INFO)
def test_mssd_and_mspd_agree(name):
    symmetries = list_symmetry_transforms(cases.MODELS_INFO[name])
    estimated, true = cases.poses(list(cases.MODELS_INFO).index(name))
    points = ModelPoints.from_vertices(cases.points())
    intrinsics = np.tile(cases.INTRINSICS, (len(true), 1, 1))
    np.testing.assert_allclose(mssd(estimated, true, points, symmetries), REFERENCE["mssd"][name], atol=1e-9)
    np.testing.assert_allclose(mspd(estimated, true, intrinsics, points, symmetries), REFERENCE["mspd"][name], atol=1e-9)


def test_vsd_agrees():
    for (measured, estimated, true), expected in zip(cases.visible_surface_cases(), REFERENCE["vsd"], strict=True):
        found = vsd(measured, patch(estimated), patch(true), cases.INTRINSICS, cases.DIAMETER_MM, 15.0)
        np.testing.assert_allclose(found, expected, atol=1e-12)


def patch(depth: np.ndarray) -> DepthPatch:
    """The part of a depth image that is not empty."""
    rows, columns = np.nonzero(depth)
    if not len(rows):
        return DepthPatch(0, 0, np.zeros((0, 0), np.float32))
    top, left = rows.min(), columns.min()
    return DepthPatch(int(left), int(top), depth[top : rows.max() + 1, left : columns.max() + 1])


def test_recall_agrees():
    errors, first, instances, total = [], [0], [], 0
    for case in cases.matching_cases():
        order = np.argsort(-np.array(case["scores"]), kind="stable")[: case["count"]]
        valid = np.sort(np.argsort(-np.array(case["visible"]), kind="stable")[: case["count"]])
        errors += [case["errors"][row][column] for row in order for column in valid]
        first.append(len(errors))
        instances.append(len(valid))
        total += case["count"]
    pairs = PosePairs(*(np.zeros(len(errors), int),) * 3, np.array(first), np.array(instances))
    recall = count_found_instances(pairs, np.array(errors), THRESHOLDS).sum(0) / total
    np.testing.assert_allclose(recall, REFERENCE["recall"], atol=1e-12)


class MaskedFrame(Frame):
    """A frame whose masks are in memory, in its instances' info."""

    def mask(self, instance, kind="mask_visib"):
        return self.instances[instance].info["mask"]


@pytest.mark.parametrize("kind", ["segm", "bbox"])
def test_average_precision_agrees(kind):
    instances, detections = cases.detection_cases()
    frames = {}
    for image in range(6):
        held = [Instance(entry["object"], np.eye(4), entry["visible"], entry) for entry in instances if entry["image"] == image]
        frames[1, image] = MaskedFrame(1, image, np.eye(3), None, None, tuple(held), Path("scene"))
    found = [
        Detection(1, entry["image"], entry["object"], entry["score"], mask_to_box(entry["mask"]), encode_mask(entry["mask"]))
        for entry in detections
    ]
    scores = average_precision(found, frames, kind, True, Path("detections.json"))
    np.testing.assert_allclose([scores[measure] for measure in MEASURES], REFERENCE["ap"][kind], atol=1e-12)
    assert coco_masks.area(found[0].mask) > 0


def test_an_ignored_instance_decides_nothing():
    """The cases hold instances that are hardly visible, and counting them would show."""
    instances, _ = cases.detection_cases()
    assert any(entry["visible"] < 0.1 for entry in instances)
