"""Average precision of detections as COCO defines it, by pycocotools: the mean over IoU 0.5 to 0.95 and over objects.

As in BOP since 2022: all objects in the target images are annotated, and those of which less than a tenth is visible are ignored,
detected or not. Masks are of the visible pixels. Boxes are amodal (around the whole silhouette) or modal (around the visible part).
"""

import contextlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from zeroshop_steps.bop.formats.detections import Detection, encode_mask, mask_to_box
from zeroshop_steps.bop.formats.targets import LEAST_VISIBLE_SHARE, Frames
from zeroshop_steps.runtime.errors import StepError

MEASURES = ("ap", "ap_50", "ap_75")


class _Evaluation(COCOeval):
    """COCO's evaluation that ignores annotations marked `ignored`; the original ignores `iscrowd` only."""

    def _prepare(self) -> None:
        super()._prepare()
        for annotations in self._gts.values():
            for annotation in annotations:
                annotation["ignore"] = annotation["ignored"]


def make_annotations(frames: Frames, amodal: bool, with_masks: bool) -> COCO:
    """COCO's annotations of the objects in the frames; images are numbered in the order of the frames.

    Boxes are taken from scene_gt_info.json where the masks are not there.

    Raises:
        StepError: a mask or the visibility of an instance is missing.
    """
    images: list[dict] = []
    annotations: list[dict] = []
    objects: set[int] = set()
    for number, frame in enumerate(frames.values(), start=1):
        images.append({"id": number})
        for index, instance in enumerate(frame.instances):
            objects.add(instance.object_id)
            if instance.visible_share is None:
                raise StepError(f"{frame.folder / 'scene_gt_info.json'} has no visib_fract for instance {index} of image {frame.image_id}")
            entry: dict[str, Any] = {
                "image_id": number,
                "category_id": instance.object_id,
                "iscrowd": 0,
                "ignored": instance.visible_share < LEAST_VISIBLE_SHARE,
            }
            noted = instance.info.get("bbox_obj" if amodal else "bbox_visib")
            if not with_masks and noted and frame.image_path("mask_visib", index) is None:
                entry |= {"area": instance.info.get("px_count_visib", noted[2] * noted[3]), "bbox": noted}
            else:
                visible = frame.mask(index)
                images[-1] |= {"height": visible.shape[0], "width": visible.shape[1]}
                if not visible.any():
                    continue
                entry |= {"area": int(visible.sum()), "bbox": list(mask_to_box(frame.mask(index, "mask") if amodal else visible))}
                entry |= {"segmentation": encode_mask(visible)} if with_masks else {}
            if entry["area"]:
                annotations.append(entry | {"id": len(annotations) + 1})
    return _make_coco({"images": images, "annotations": annotations, "categories": [{"id": number} for number in sorted(objects)]})


def average_precision(detections: Sequence[Detection], frames: Frames, kind: str, amodal: bool, path: Path) -> dict[str, float]:
    """AP, AP at IoU 0.5 and at 0.75 over all objects, and `ap_object_N` of each object; all are 0 without detections.

    Args:
        detections: those in other images are ignored.
        frames: the target images.
        kind: `segm` for masks, `bbox` for boxes.
        amodal: whether true boxes are around the whole silhouette; masks are always of the visible part.
        path: of the detections, for messages.

    Raises:
        StepError: a detection lacks its mask or box, or a mask has another size than its image.
    """
    truth = make_annotations(frames, amodal and kind == "bbox", kind == "segm")
    numbers = {key: number for number, key in enumerate(frames, start=1)}
    results = []
    for detection in detections:
        number = numbers.get((detection.scene_id, detection.image_id))
        given = detection.mask if kind == "segm" else detection.box_px
        if given is None:
            raise StepError(f"{path}: a detection of object {detection.object_id} has no {'segmentation' if kind == 'segm' else 'bbox'}")
        if number is not None:
            if kind == "segm":
                _check_size(detection, truth.imgs[number], path)
            entry = {"image_id": number, "category_id": detection.object_id, "score": detection.score}
            results.append(entry | ({"segmentation": given} if kind == "segm" else {"bbox": list(given)}))
    objects = truth.getCatIds()
    if not results or not objects:
        return dict.fromkeys([*MEASURES, *(f"ap_object_{number}" for number in objects)], 0.0)
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = _Evaluation(truth, truth.loadRes(results), kind)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    means = evaluation.eval["precision"][:, :, :, 0, -1]
    scores = dict(zip(MEASURES, map(float, evaluation.stats[:3]), strict=True))
    for index, number in enumerate(objects):
        valid = means[:, :, index][means[:, :, index] > -1]
        scores[f"ap_object_{number}"] = float(valid.mean()) if len(valid) else float(np.nan)
    return scores


def _check_size(detection: Detection, image: dict, path: Path) -> None:
    """Raise StepError for a mask of another size than its image, which pycocotools would count as a miss."""
    height, width = detection.require_mask()["size"]
    if "height" in image and (height, width) != (image["height"], image["width"]):
        raise StepError(
            f"{path}: a mask of object {detection.object_id} is {width} x {height} px, image {detection.image_id} of scene"
            f" {detection.scene_id} is {image['width']} x {image['height']} px; masks must be of the whole image"
        )


def _make_coco(content: dict) -> COCO:
    coco = COCO()
    coco.dataset = content
    with contextlib.redirect_stdout(io.StringIO()):
        coco.createIndex()
    return coco
