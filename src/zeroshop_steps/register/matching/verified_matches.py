"""Match features of image pairs, and verify the matches by two views' geometry, in a COLMAP database."""

from pathlib import Path

import pycolmap

from zeroshop_steps.register.features.sift import SiftOptions


def match_features(database: Path, options: SiftOptions, pairs: list[tuple[str, str]] | None = None) -> None:
    """Match image pairs and keep what one epipolar geometry (or homography) explains.

    Args:
        database: with the features of all images.
        options: see `SiftOptions`.
        pairs: names of the images of each pair; None for all pairs.
    """
    verification = make_verification_options(options.seed)
    if pairs is None:
        pycolmap.match_exhaustive(database, make_matching_options(), verification_options=verification)
        return
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = write_pairs(database, pairs)
    pycolmap.match_image_pairs(database, make_matching_options(), pairing, verification)


def write_pairs(database: Path, pairs: list[tuple[str, str]]) -> Path:
    """Write names of the images of each pair beside a database, as COLMAP reads them; returns the file."""
    path = Path(database).with_name("pairs.txt")
    path.write_text("".join(f"{first} {second}\n" for first, second in pairs))
    return path


def make_matching_options() -> pycolmap.FeatureMatchingOptions:
    """Options of the descriptor matching: on one thread, whatever else runs on more.

    pycolmap 4.2.1 holds a BLAS that is not safe to call from two threads at once, and its matcher's threads do: in about
    one run of forty over ten images on two threads, pairs lost some or all of their matches, and nothing said so. In 400
    runs on one thread none did. Over 20 images one thread takes 5.5 s, two take 2.9 s.
    """
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1
    return matching


def make_verification_options(seed: int) -> pycolmap.TwoViewGeometryOptions:
    """Options of the geometric verification, with a fixed seed."""
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    return verification
