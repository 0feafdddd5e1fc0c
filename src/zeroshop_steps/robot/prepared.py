"""The options that say what is recognized and how, and the recognizers that they mean."""

import argparse
import shlex
import sys
from pathlib import Path

from zeroshop_steps.robot.object_store import ObjectStore
from zeroshop_steps.robot.recognizers import Recognizer, make_recognizers


def add_recognizer_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that say what is recognized, and how."""
    parser.add_argument("--models", type=Path, required=True, help="folder of models in BOP's layout, or of a dataset's results")
    parser.add_argument("--nvs", default="2dgs", help="surface method whose meshes are taken from results (default: %(default)s)")
    parser.add_argument("--objects", nargs="*", default=[], help="names of the models to take (default: all)")
    parser.add_argument("--detectors", nargs="*", help="methods of the stage detect (default: all whose weights are here)")
    parser.add_argument("--estimators", nargs="*", help="methods of the stage pose (default: all whose weights are here)")
    parser.add_argument("--instances", type=int, default=1, help="the most detections of an object in an image (default: %(default)s)")
    parser.add_argument("--templates", type=Path, help="folder that keeps rendered views of the models between starts")
    parser.add_argument(
        "--options", nargs=2, action="append", default=[], metavar=("METHOD", "WORDS"), help="of a method, such as cnos '--device cuda'"
    )


def prepare_recognizers(args: argparse.Namespace) -> tuple[ObjectStore, dict[str, Recognizer]]:
    """The models, and the recognizers by the names of their servers, with models and networks loaded; models that are refused are told.

    Raises:
        StepError: there is no usable model, or a method cannot run here.
    """
    store = ObjectStore(args.models, args.nvs, args.objects, args.templates)
    for reason in store.refused.values():
        print(f"left out: {reason}", file=sys.stderr)
    options = {name: shlex.split(words) for name, words in args.options}
    recognizers = make_recognizers(args.detectors, args.estimators, store, options, args.instances)
    for recognizer in recognizers.values():
        recognizer.prepare()
    print(f"known objects: {', '.join(sorted(store.objects))}", flush=True)
    return store, recognizers
