"""USD of a body, for Isaac Sim and other readers of UsdPhysics: one rigid body, z up, in metres and kilograms.

`.usda` is text that refers to the texture in the body's folder; `.usdz` is one file that holds the texture, too. Below the default prim
lie `Geometry/visual` (the textured mesh), `Geometry/collision` (convex parts, with purpose `guide`, so that they are not rendered)
and `Looks` (the material that is seen, and the physical one with the friction).
"""

import argparse
import shutil
from pathlib import Path
from typing import Any

from zeroshop_steps.assets.body_files import TEXTURE, Body, read_body, require_beside
from zeroshop_steps.assets.usd_stage import load_pxr, write_stage
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, scratch_directory


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--body", type=Path, required=True, help="the body's folder, beside --out")
    parser.add_argument(
        "--date", help="day of creation for the metadata, such as 2026-11-24; without it, the file depends on the body alone"
    )
    parser.add_argument("--out", type=Path, required=True, help="e.g. results/demo/mug/2dgs.usda, or .usdz")


def run(args: argparse.Namespace) -> None:
    """Write one USD file."""
    body, pxr = read_body(args.body), load_pxr()
    if args.out.suffix == ".usda":
        folder = require_beside(body, args.out)
        with atomic_write(args.out) as temporary:
            write_stage(pxr, body, temporary, f"./{folder}/{TEXTURE}", args.date)
    elif args.out.suffix == ".usdz":
        write_package(pxr, body, args.out, args.date)
    else:
        raise StepError(f"{args.out} ends in {args.out.suffix or 'nothing'}; expected .usda or .usdz")


def write_package(pxr: Any, body: Body, out: Path, date: str | None) -> None:
    """Write a usdz: an archive of a binary stage and its texture."""
    with scratch_directory(out, "usdz") as folder:
        stage = folder / f"{out.stem}.usdc"
        write_stage(pxr, body, stage, f"./{TEXTURE}", date)
        if (body.folder / TEXTURE).is_file():
            shutil.copyfile(body.folder / TEXTURE, folder / TEXTURE)
        packed = folder / out.name
        if not pxr.UsdUtils.CreateNewUsdzPackage(pxr.Sdf.AssetPath(str(stage)), str(packed)):
            raise StepError(f"{out} cannot be packed: usd-core says why above")
        with atomic_write(out) as temporary:
            shutil.copyfile(packed, temporary)
