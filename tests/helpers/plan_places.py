"""The default config, and places that the tests of plans ask about."""

import yaml

from helpers.paths import REPOSITORY
from zeroshop_steps.plan.datasets import Place

DEFAULTS = yaml.safe_load((REPOSITORY / "config/config.yaml").read_text())


def place(**names):
    usual = {"dataset": "photos", "object": "cup", "scene": "video", "registration": "colmap", "nvs": "2dgs"}
    return Place(**{**usual, **names})
