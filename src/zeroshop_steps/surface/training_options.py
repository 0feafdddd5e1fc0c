"""The command line that the optimizers share, apart from what they import: help should not wait for PyTorch."""

import os
from argparse import ArgumentParser
from pathlib import Path


def add_training_arguments(parser: ArgumentParser, product: str, iterations: int, image_width_px: int, sh_degree: int) -> None:
    """Add the options, with an optimizer's own defaults; product: the file that holds the trained model."""
    parser.add_argument("--cameras", type=Path, required=True, help="registration: images, masks and sparse model")
    parser.add_argument("--stereo", type=Path, required=True, help="seeds.npz that stereo has made from these cameras")
    parser.add_argument("--out", type=Path, required=True, help=f"folder for {product}, training.csv and training.json")
    parser.add_argument("--iterations", type=int, default=iterations)
    parser.add_argument("--image-width-px", type=int, default=image_width_px, help="images are resampled to this width, never up")
    parser.add_argument("--sh-degree", type=int, default=sh_degree, choices=range(4), help="spherical-harmonics degree of the colour")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--checkpoint-every", type=int, default=100, help="iterations between checkpoints")
    parser.add_argument("--resume", action="store_true", help="go on from a checkpoint of the same settings")
