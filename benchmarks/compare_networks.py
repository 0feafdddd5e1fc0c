"""Compare salient-object networks by the masks that they give alone: the main thing of the whole photo, where it is likelier than not.

The overlap (IoU) with the right mask, photo by photo, for each network; with --table, also as a file.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from capture_benchmark.table import HALVES
from masked_photos import MaskedPhoto, find_rendered, pair_folders
from zeroshop_steps.capture.photo_files import MAX_SIDE_PX, read_photo
from zeroshop_steps.geometry.imaging.images import compute_overlap, read_mask
from zeroshop_steps.networks.saliency.object_finder import keep_main_thing
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS, network_path
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track
from zeroshop_steps.runtime.tables import write_table

POOR = 0.85  # an overlap below which a mask is not of use


def main() -> int:
    """Run the command line and return the exit status."""
    args = parse_arguments()
    try:
        photos = find_rendered(args.inputs, args.half) if args.inputs else []
        photos += [one for name, folder, masks in args.photos for one in pair_folders(name, Path(folder), Path(masks))]
        if not photos:
            raise StepError("there is nothing to compare on; give --inputs, --photos or both")
        overlaps = pd.concat([measure(path, photos) for path in args.networks], ignore_index=True)
        if args.table:
            write_table(args.table, overlaps)
    except StepError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(summarize(overlaps).to_string(float_format="{:.3f}".format))
    return 0


def parse_arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    networks_help = f"networks, each {', '.join(NETWORKS)} or an ONNX file; unknown ones are taken as trained further from {DEFAULT}"
    parser.add_argument("networks", type=network_path, nargs="+", metavar="NETWORK", help=networks_help)
    parser.add_argument("--inputs", type=Path, help="the benchmark's folder of stored captures, to compare on the rendered ones")
    parser.add_argument("--half", choices=HALVES, default="tune", help="of the rendered captures (default: %(default)s)")
    photos_help = "a capture's name, the folder of its photos, and that of their masks, named as they are; may be repeated"
    parser.add_argument("--photos", nargs=3, action="append", default=[], metavar=("NAME", "FOLDER", "MASKS"), help=photos_help)
    parser.add_argument("--table", type=Path, help="CSV file for the overlap in each photo")
    return parser.parse_args()


def measure(path: Path, photos: Sequence[MaskedPhoto]) -> pd.DataFrame:
    """The overlap of a network's mask with the right one in each photo: the columns network, capture, photo and overlap.

    Raises:
        StepError: the network is missing or no such network, or a file cannot be read.
    """
    known = next((one for one in NETWORKS.values() if one.path == path), NETWORKS[DEFAULT])
    network = SalientObjectNetwork(path, known.mean, known.deviation)
    rows = []
    for one in track(photos, path.stem, len(photos)):
        right = read_mask(one.mask)
        found = network.predict(read_photo(one.photo, MAX_SIDE_PX).pixels, right.shape[::-1])
        overlap = compute_overlap(keep_main_thing(found) > 0.5, right)
        rows.append({"network": str(path), "capture": one.capture, "photo": one.photo.stem, "overlap": round(overlap, 4)})
    return pd.DataFrame(rows)


def summarize(overlaps: pd.DataFrame) -> pd.DataFrame:
    """Of each capture, and of all photos together, by network: median, mean, least, and the share of photos below POOR."""
    together = overlaps.assign(capture="ALL")
    groups = pd.concat([overlaps, together]).groupby(["capture", "network"], sort=False)["overlap"]
    figures = groups.agg(["count", "median", "mean", "min"])
    figures[f"below {POOR}"] = groups.agg(lambda values: (values < POOR).mean())
    return figures


if __name__ == "__main__":
    sys.exit(main())
