"""More features for views at a flat angle: SIFT on a vertically stretched copy of the image.

A support plane seen under 8 degrees is compressed seven times along the view, which no affine adaptation of single
features undoes: neighbouring views 36 degrees apart then share a few dozen matches. Simulating the tilt before
detection does undo it (ASIFT: Morel and Yu, SIAM J. Imaging Sciences 2009), with one tilt, because a camera that is
held upright sees a plane compressed vertically. Only views that match badly without it pay for it.
"""

from pathlib import Path

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.images import read_image, write_image
from zeroshop_steps.register.image_set import ImageSet
from zeroshop_steps.register.sift import SiftOptions, make_extraction_options, make_matching_options, make_verification_options

COPY_WIDTH = 0.5  # features must be as large across as along the view, where stretching cannot bring back detail


def find_weak_images(database: Path, min_matches: int, min_share: float) -> list[str]:
    """Names of the images with few verified matches, all pairs together.

    Args:
        database: with verified matches.
        min_matches: fewer than these are few.
        min_share: so are fewer than this share of what a well-matched image (upper quartile) of the same set has.
    """
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        totals = dict.fromkeys(names, 0)
        for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            for image_id in pycolmap.pair_id_to_image_pair(pair_id):
                totals[image_id] += len(geometry.inlier_matches)
    few = max(min_matches, min_share * float(np.percentile(list(totals.values()), 75)))
    return sorted(name for image_id, name in names.items() if totals[image_id] < few)


def add_stretched_features(database: Path, image_set: ImageSet, names: list[str], tilt: float, options: SiftOptions) -> None:
    """Add features of stretched copies to the images `names`, and match these images anew with all images.

    Args:
        database: with features and matches of all images; changed in place.
        image_set: the images.
        names: the images to treat.
        tilt: ratio of vertical to horizontal magnification of the copies.
        options: as for the first extraction.
    """
    shrink, stretch = COPY_WIDTH, COPY_WIDTH * tilt
    folder = Path(database).parent / "stretched"
    for path in image_set.images:
        if path.name in names:
            image = read_image(path)
            size = (round(image.shape[1] * shrink), round(image.shape[0] * stretch))
            half = cv2.resize(image, (size[0], image.shape[0]), interpolation=cv2.INTER_AREA)
            write_image(folder / f"{path.name}.png", cv2.resize(half, size, interpolation=cv2.INTER_CUBIC))
    stretched_database = Path(database).with_name("stretched.db")
    stretched_names = [f"{name}.png" for name in names]
    pycolmap.Database.open(stretched_database).close()
    pycolmap.import_images(stretched_database, folder, pycolmap.CameraMode.SINGLE, stretched_names)
    extraction = make_extraction_options(options, first_octave=0)
    pycolmap.extract_features(stretched_database, folder, stretched_names, pycolmap.CameraMode.SINGLE, extraction_options=extraction)
    with pycolmap.Database.open(database) as opened, pycolmap.Database.open(stretched_database) as stretched:
        images = {image.name: image.image_id for image in opened.read_all_images()}
        descriptors = {image_id: opened.read_descriptors(image_id) for image_id in images.values()}
        for name in names:
            source_id = stretched.read_image_with_name(f"{name}.png").image_id
            keypoints = stretched.read_keypoints(source_id)
            keypoints[:, 1] /= round(image_set.size_px[1] * stretch) / image_set.size_px[1]
            keypoints[:, 0] /= round(image_set.size_px[0] * shrink) / image_set.size_px[0]
            keypoints[:, 2:4] /= shrink
            keypoints[:, 4:] /= stretch  # second row of the affine shape [a11, a12; a21, a22]
            image_id = images[name]
            opened.update_keypoints(image_id, np.concatenate([opened.read_keypoints(image_id), keypoints]))
            both = np.concatenate([descriptors[image_id].data, stretched.read_descriptors(source_id).data])
            descriptors[image_id] = pycolmap.FeatureDescriptors(descriptors[image_id].type, both)
        opened.clear_descriptors()
        for image_id, data in sorted(descriptors.items()):
            opened.write_descriptors(image_id, data)
        pairs = sorted({tuple(sorted((name, other))) for name in names for other in images if other != name})
        for first, second in pairs:
            opened.delete_matches(images[first], images[second])
            opened.delete_two_view_geometry(images[first], images[second])
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = Path(database).with_name("pairs.txt")
    Path(pairing.match_list_path).write_text("".join(f"{first} {second}\n" for first, second in pairs))
    pycolmap.match_image_pairs(database, make_matching_options(), pairing, make_verification_options(options.seed))
