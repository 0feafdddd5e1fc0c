"""Which steps ask for a GPU, for how much of its memory, and what is left for the steps beside them."""

from pathlib import Path

import pytest
import yaml
from snakemake.api import SnakemakeApi
from snakemake.iocontainers import InputFiles, Wildcards
from snakemake.settings.types import ConfigSettings, ResourceSettings

from helpers.paths import REPOSITORY, SNAKEFILE
from zeroshop_steps.methods import CUDA_MB, DETECTORS, SURFACES, Method

CONFIG = yaml.safe_load((REPOSITORY / "config/config.yaml").read_text())
PLACE = {"dataset": "demo", "object": "mug", "scene": "su_h", "registration": "mast3r", "nvs": "2dgs", "models": "true"}
POSES = {"estimator": "foundationpose", "masks": "truth"}


def asked_for(folder: Path, config: dict, limits: dict[str, int]) -> dict[str, dict[str, int]]:
    """The resources that rules ask for, by their names, with these changes of the config and these limits of a profile."""
    with SnakemakeApi() as api:
        settings = ResourceSettings(cores=8, resources=limits)
        workflow = api.workflow(settings, config_settings=ConfigSettings(config=config), snakefile=SNAKEFILE, workdir=folder)._workflow
        wildcards = Wildcards(fromdict=PLACE | POSES)
        names = ("train_2dgs", "train_svraster", "register", "cnos", "estimate_poses", "texture", "evaluate", "fuse_2dgs", "shape")
        rules = {rule.name: rule for rule in workflow.rules}
        return {name: dict(rules[name].expand_resources(wildcards, InputFiles([]), 1).items()) for name in names}


def on(device: str) -> dict:
    """Changes of the config by which networks, both optimizers, the texture and the evaluation run on a device."""
    return {"devices": {"networks": device, "kernels": device}}


def test_on_the_processor_no_step_asks_for_a_gpu(tmp_path):
    asked = asked_for(tmp_path, on("cpu"), {})
    names = ("train_2dgs", "train_svraster", "register", "cnos", "estimate_poses", "texture", "evaluate", "fuse_2dgs", "shape")
    for name in names:
        assert not asked[name].get("gpu") and not asked[name].get("gpu_mem_mb"), name
    assert asked["train_2dgs"]["_cores"] == asked["train_svraster"]["_cores"] == 8
    assert asked_for(tmp_path, {}, {})["register"]["gpu"] == 1, "networks take a card where there is one"


@pytest.mark.parametrize(("device", "cores"), [("cuda", 2), ("auto", 8)])
def test_on_a_gpu_steps_ask_for_its_memory_and_training_leaves_cores(tmp_path, device, cores):
    asked = asked_for(tmp_path, on(device), {"gpu_mem_mb": 10_000})
    for name in ("2dgs", "svraster"):
        resources = asked[f"train_{name}"]
        assert (resources["gpu"], resources["_cores"]) == (1, cores)
        options = CONFIG["nvs"][name]["train"] | {"device": device}
        assert resources["gpu_mem_mb"] == SURFACES[name].gpu_mem_mb(options) > CUDA_MB
    assert asked["estimate_poses"]["gpu"] == 1 and CUDA_MB < asked["estimate_poses"]["gpu_mem_mb"] <= 10_000
    assert asked["cnos"]["gpu_mem_mb"] == 10_000 < DETECTORS["cnos"].mem_mb, "what is predicted to need more has the card for itself"
    for name in ("texture", "evaluate"):
        assert asked[name]["gpu"] == 1 and CUDA_MB < asked[name]["gpu_mem_mb"] < 2000
    assert not any(asked[name].get("gpu") for name in ("fuse_2dgs", "shape"))


def test_several_trainings_share_the_card_of_the_profile_and_leave_cores_for_others():
    profile = yaml.safe_load((REPOSITORY / "workflow/profiles/gpu/config.yaml").read_text())
    limits = {key: int(value) for key, value in (limit.split("=") for limit in profile["resources"])}
    training = SURFACES["2dgs"].gpu_mem_mb(CONFIG["nvs"]["2dgs"]["train"] | {"device": "cuda"})
    assert "gpu" not in limits and limits["gpu_mem_mb"] // training >= 3 and profile["cores"] > 3 * 2


def test_predicted_memory_grows_with_primitives_and_pixels_and_is_nothing_on_the_processor():
    method = Method("surface.made", gpu_bytes={"primitive": 1000, "pixel": 300})
    options = {"device": "cuda", "count_max": 50_000, "image_width_px": 300}
    assert method.gpu_mem_mb(options) == CUDA_MB + 50 + 36
    assert method.gpu_mem_mb(options | {"count_max": 100_000}) == CUDA_MB + 100 + 36
    assert method.gpu_mem_mb(options | {"image_width_px": 600}) == CUDA_MB + 50 + 144
    assert method.gpu_mem_mb(options | {"device": "cpu"}) == 0 == Method("surface.made").gpu_mem_mb({"device": "cuda"})
    network = DETECTORS["cnos"]
    assert network.gpu_mem_mb({}) == network.gpu_mem_mb({"device": "cuda"}) == network.mem_mb and network.gpu_mem_mb({"device": "cpu"}) == 0
