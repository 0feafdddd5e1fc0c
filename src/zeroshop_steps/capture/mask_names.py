"""Find the mask of each photo by its name: one scheme for the whole folder, such as x.png, x.jpg.png, x_mask.png or mask_x.png."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from os.path import commonprefix
from pathlib import Path

from zeroshop_steps.capture.photo_files import CONVERTED_SUFFIXES
from zeroshop_steps.geometry.imaging.image_files import check_folder, list_folder
from zeroshop_steps.geometry.imaging.images import IMAGE_SUFFIXES
from zeroshop_steps.runtime.errors import StepError

MASK_SUFFIXES = (*IMAGE_SUFFIXES, *CONVERTED_SUFFIXES, ".pgm", ".pbm", ".tga", ".jp2", ".npy")
EXAMPLES = ("{stem}.png", "{name}.png", "{stem}_mask.png", "{stem}.mask.png", "mask_{stem}.png")
WORD = "mask"
LEAST_ALIKE = 2  # masks that a scheme other than x.png must name; a single name may look like a photo's by chance
DIGITS = "0123456789"


@dataclass(frozen=True)
class MaskNames:
    """The masks of a folder.

    Attributes:
        found: the mask of each photo that has one.
        example: (photo, mask) names of the first, by which the others are named; empty where each is called as its photo, but .png.
        unused: a mask of the photo in the example that another scheme names, where that names as many; None where there is none.
    """

    found: dict[Path, Path]
    example: tuple[str, str] | tuple[()]
    unused: str | None = None

    def expect(self, photo: Path, folder: Path) -> str:
        """What a photo without a mask lacks, in words."""
        if not self.example:
            return f"{folder / photo.stem}.png does not exist"
        return f"{folder} has none that is named for it as {self.example[1]} is for {self.example[0]}"


def find_masks(photos: Sequence[Path], folder: Path) -> MaskNames:
    """The masks of photos, by the scheme that names most of them; of several, one with the word `mask`, or the shortest.

    Raises:
        StepError: the folder is missing, or none of its files is named like a photo.
    """
    check_folder(folder, "mask folder", "give one mask a photo, named like it but .png")
    there = list_folder(folder)
    files = [path for path in there if path.suffix.lower() in MASK_SUFFIXES]
    schemes = _find_schemes(photos, files)
    if not schemes:
        names = ", ".join(example.format(stem=photos[0].stem, name=photos[0].name) for example in EXAMPLES)
        listed = [path.name + "/" * path.is_dir() for path in files or there]
        held = ", ".join(listed[:3]) + " ..." * (len(listed) > 3) if listed else "nothing"
        lack = f"no mask in {folder} is named like a photo" if files else f"{folder} holds no pictures, which masks are"
        raise StepError(
            f"{lack}: it holds {held}; expected for {photos[0].name} one of {names}, for all alike: name the folder itself, and export"
            " outlines (JSON, XML, TXT) as such pictures"
        )
    ranked = sorted(schemes.items(), key=_rank, reverse=True)
    found = ranked[0][1]
    if all(
        mask == photo or mask == mask.with_name(f"{photo.stem}{mask.suffix}") and mask.suffix.lower() == ".png"
        for photo, mask in found.items()
    ):
        return MaskNames(found, ())
    photo = next(photo for photo in photos if photo in found)
    others = (scheme[photo].name for _, scheme in ranked[1:] if len(scheme) == len(found) and scheme[photo] not in found.values())
    return MaskNames(found, (photo.name, found[photo].name), next(others, None))


def split_masks(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Photos, and the masks that lie among them: files that are named like others of the folder, and `mask` besides."""
    schemes = {affixes: found for affixes, found in _find_schemes(paths, paths).items() if WORD in "".join(affixes)}
    masks = {mask for found in schemes.values() for photo, mask in found.items() if mask != photo}
    return [path for path in paths if path not in masks], sorted(masks)


def _find_schemes(photos: Sequence[Path], files: Sequence[Path]) -> dict[tuple[str, str], dict[Path, Path]]:
    """The mask of each photo, by what a scheme writes before and behind the photo's name, its stem, or the part that differs."""
    schemes: dict[tuple[str, str], dict[Path, Path]] = defaultdict(dict)
    # A PNG goes before a JPEG of the same name.
    ordered = sorted(files, key=lambda path: path.suffix.lower() != ".png")
    stems = [photo.stem.casefold() for photo in photos]
    for keys in ([photo.name.casefold() for photo in photos], stems, _cut_common(stems)):
        # Two photos of one key, such as x.jpg and x.heic, may have one mask.
        for photo, key in zip(photos, keys, strict=True):
            for path in ordered:
                stem = path.stem.casefold()
                before, there, behind = stem.partition(key)
                if key and there and not _goes_on(before, key, behind):
                    schemes[before, behind].setdefault(photo, path)
        kept = {affixes: found for affixes, found in schemes.items() if affixes == ("", "") or len(found) >= min(LEAST_ALIKE, len(photos))}
        if kept:
            return kept
    return _match_numbers(photos, ordered)


def _match_numbers(photos: Sequence[Path], files: Sequence[Path]) -> dict[tuple[str, str], dict[Path, Path]]:
    """The masks whose numbers are the photos', but for zeros before them: 7.png of IMG_0007.jpg. None where a photo has none: then
    another number is meant, such as one that counts from 1."""
    numbers = [[int(key) for key in _cut_common([path.stem for path in paths]) if key.isdecimal()] for paths in (photos, files)]
    of_photos, of_files = (dict(zip(found, paths, strict=False)) for found, paths in zip(numbers, (photos, files), strict=True))
    if (
        [len(photos), len(files)] != [len(found) for found in numbers]
        or len(of_photos) < len(photos)
        or not of_photos.keys() <= of_files.keys()
    ):
        return {}
    return {("", ""): {photo: of_files[number] for number, photo in of_photos.items()}}


def _goes_on(before: str, key: str, behind: str) -> bool:
    """Whether a number goes on beyond a photo's name: IMG_10 is not named after IMG_1."""
    return (before[-1:] in DIGITS and before != "" and key[0] in DIGITS) or (behind[:1] in DIGITS and behind != "" and key[-1] in DIGITS)


def _cut_common(stems: Sequence[str]) -> list[str]:
    """What differs between stems, with whole numbers: 0001 of frame_0001, where others are frame_0002 and so on."""
    before = commonprefix(list(stems)).rstrip(DIGITS)
    behind = commonprefix([stem[len(before) :][::-1] for stem in stems]).rstrip(DIGITS)
    cut = [stem[len(before) : len(stem) - len(behind)] for stem in stems]
    return cut if len(set(cut)) == len(cut) > 1 else list(stems)


def _rank(scheme: tuple[tuple[str, str], dict[Path, Path]]) -> tuple[int, bool, int]:
    affixes, found = scheme
    return len(found), WORD in "".join(affixes), -sum(map(len, affixes))
