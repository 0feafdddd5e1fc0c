"""Keep the pairs of images whose matches lie all over both pictures: those of sides that look alike lie on the object alone.

Two photos of the two labels of a bottle match in many points, pass every check of two views, and agree with other photos of these labels:
the model that they give is folded, and nothing but a contradiction with other pairs shows it. But photos from nearly one place share more
than the object, namely the table and the room behind it. Missing correspondences tell wrong pairs (Zach et al., What Can Missing
Correspondences Tell Us About 3D Structure and Motion?, CVPR 2008; Heinly et al., Correcting for Duplicate Scene Structure, ECCV 2014).
Here pairs are kept by how much of both pictures their matches cover.
"""

from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.register.scene.database import delete_pair, read_matches, read_places
from zeroshop_steps.register.scene.image_set import find_cells

# Set on frames of a chewing gum bottle with two equal labels.
LEAST_CELLS = 12  # of 64, with a match, in both pictures


def delete_pairs_of_low_coverage(database: Path) -> int:
    """Delete the pairs of a database whose verified matches cover little of either picture; returns how many.

    Args:
        database: COLMAP's, with verified matches; changed in place.
    """
    with pycolmap.Database.open(database) as opened:
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        images = {image.image_id: cameras[image.camera_id] for image in opened.read_all_images()}
        places = read_places(opened)
        cells = {image_id: find_cells(places[image_id], (camera.width, camera.height)) for image_id, camera in images.items()}
        narrow = []
        for pair, matches in read_matches(opened):
            covered = [len(np.unique(cells[image][matches[:, side]])) for side, image in enumerate(pair)]
            if len(matches) and min(covered) < LEAST_CELLS:
                narrow.append(pair)
        for first, second in narrow:
            delete_pair(opened, first, second)
    return len(narrow)
