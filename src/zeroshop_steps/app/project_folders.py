"""Where the workflow, its weights and a user's project lie: in a clone, or with the installed package."""

import sys
from pathlib import Path

from platformdirs import user_cache_path

import zeroshop_steps
from zeroshop_steps.methods import REGISTRATIONS
from zeroshop_steps.networks.mobile_sam.choice import FILE as SEGMENTER
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, WeightsFile, fetch_weights, look_up_weights
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_write

PACKAGE = Path(zeroshop_steps.__file__).resolve().parent
SNAKEFILE = '''\
"""A project of ZeroShOP: objects.tsv names the objects, config.yaml says what differs from the defaults."""

from zeroshop_steps.app.project_folders import find_project


configfile: "config.yaml"


include: str(find_project() / "workflow/Snakefile")


workflow.default_target = "all"
'''
CONFIG = """\
# What differs from the defaults; all keys and their defaults are in {defaults}
objects_table: objects.tsv
"""


def find_project() -> Path:
    """The folder that holds workflow/ and config/: the clone, or a part of the installed package.

    Raises:
        StepError: neither has them.
    """
    places = (PACKAGE.parents[1], PACKAGE / "project")
    for root in places:
        if (root / "workflow/Snakefile").is_file():
            return root
    raise StepError(f"the workflow is neither at {places[0]} nor at {places[1]}; install ZeroShOP again: `pip install zeroshop`")


def find_weights_home() -> Path:
    """The folder below which downloaded weights lie: the clone, or the user's cache."""
    root = find_project()
    return root if root != PACKAGE / "project" else user_cache_path("zeroshop")


def list_everyday_weights() -> list[WeightsFile]:
    """Those that every mesh of photos uses, where they are there."""
    return [look_up_weights(NETWORKS[DEFAULT].file), look_up_weights(SEGMENTER), *map(look_up_weights, REGISTRATIONS["aliked"].weights)]


def provide_weights() -> None:
    """Download the weights that every mesh of photos uses, where they are missing, once; without a network, a warning says so."""
    home = find_weights_home()
    missing = [row for row in list_everyday_weights() if not (home / row.path).is_file()]
    if not missing or home == find_project():  # a clone's set-up has tried, and said what is missing
        return
    size_mb = sum(row.size_bytes or 0 for row in missing) / 1e6
    licences = ", ".join(sorted({row.licence for row in missing}))
    print(f"Downloading the weights of networks to {home / WEIGHTS_FOLDER}, once ({size_mb:.0f} MB, {licences})", file=sys.stderr)
    for row in missing:
        try:
            (home / row.path).parent.mkdir(parents=True, exist_ok=True)
            fetch_weights(row.file, home / row.path)
        except StepError as error:
            without = "objects on plain tables are refused more often, and objects with the colours of the ground may lose parts"
            warn(f"{str(error).rstrip('.')}. Without these weights, {without}")
            return


def init_project(folder: Path) -> list[Path]:
    """Lay out a project for many objects, tables and clusters; returns the files.

    Raises:
        StepError: one of them is there already.
    """
    defaults = find_project() / "config"
    contents = {
        "Snakefile": SNAKEFILE,
        "config.yaml": CONFIG.format(defaults=defaults / "config.yaml"),
        "objects.tsv": (defaults / "objects.tsv").read_text(),
    }
    if there := [name for name in contents if (folder / name).exists()]:
        raise StepError(f"{folder} has {' and '.join(there)} already; name another folder")
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        with atomic_write(folder / name) as temporary:
            temporary.write_text(content)
    return [folder / name for name in contents]
