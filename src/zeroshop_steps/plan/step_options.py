"""The options of steps in the config: what it says once for many, and what a section names beside the keys that the schema describes.

Any option of a step may stand in the section of the step; the schema describes those that people change.
"""

import argparse
import importlib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

from zeroshop_steps import methods
from zeroshop_steps.config_manual import resolve
from zeroshop_steps.runtime.config_files import name_error
from zeroshop_steps.runtime.errors import StepError

Section = Mapping[str, Any]
STEPS = {
    "stereo": "surface.stereo",
    "finish.clean": "finish.shape",
    "assets": "assets.body",
    "grasp": "grasp.antipodal",
    "bop.test_set": "synthetic.make_test_scenes",
    "report.page": "report.object_page",
}
"""The steps that sections of the config belong to, but for those of methods."""


def complete_sections(config: Section) -> dict[str, Any]:
    """The config with what it says once, and what presets have of their own, in every section that it concerns; its own word counts.

    `devices.networks` goes to methods that read weights, `devices.kernels` to training, stereo and texture.
    """
    full = deepcopy(dict(config))
    devices = full["devices"]
    for stage, table in methods.SECTIONS.items():
        full[stage] = full.get(stage) or {}
        for name, method in table.items():
            section = full[stage][name] = {**method.defaults, **(full[stage].get(name) or {})}
            if devices["networks"] != "auto" and (method.files or method.tries):
                section.setdefault("device", devices["networks"])
            for key in method.options:
                section[key] = section.get(key) or {}
            if devices["kernels"] != "cpu" and method.gpu_bytes:
                section[method.options[0]].setdefault("device", devices["kernels"])
    for stage in ("stereo", "finish"):
        full[stage].setdefault("device", devices["kernels"])
    for stage in ("assets", "grasp"):
        full[stage].setdefault("unknown_scale", full["unknown_scale"])
    full["bop"]["test_set"].setdefault("samples", full["capture"]["samples"])
    return full


def check_step_options(config: Section, schema: Section) -> None:
    """Raise StepError for an option that the schema does not describe and that its step does not know, or does not take with this value.

    `config` is what the user gave: what `complete_sections` adds to it is checked already.
    """
    faults = []
    for path, step in _list_sections(config):
        section, described = config, schema
        for key in path.split("."):
            section = section.get(key) or {}
            described = resolve(described.get("properties", {}).get(key, {}), schema)
        others = {key: value for key, value in section.items() if key not in described.get("properties", {})}
        if others:  # to ask the step, its libraries are imported, which takes longer than a plan
            known = _read_options(step)
            for key, value in others.items():
                if key not in known:
                    faults.append(name_error(f"option of {path}", key, known))
                elif value is not None and (fault := _find_fault(known[key], value)):
                    faults.append(f"{path}.{key}: {value!r} is {fault} ({known[key].help})")
    if faults:
        raise StepError(
            "the config has faults:\n  " + "\n  ".join(faults) + "\nconfig/KEYS.md says where the options of steps are described."
        )


def _list_sections(config: Section) -> Iterator[tuple[str, str]]:
    """Every section that has options of a step, as its path in the config, with the step."""
    yield "capture", methods.RENDERERS[config["capture"]["renderer"]].step
    yield from STEPS.items()
    for stage, table in methods.SECTIONS.items():
        for name, method in table.items():
            if method.options:
                steps = (method.step, f"{method.step.split('.')[0]}.{method.mesh}")
                yield from ((f"{stage}.{name}.{key}", step) for key, step in zip(method.options, steps, strict=False))
            else:
                yield f"{stage}.{name}", method.step


def _read_options(step: str) -> dict[str, argparse.Action]:
    """The options of a step that are not required, by name."""
    parser = argparse.ArgumentParser(add_help=False)
    importlib.import_module(f"zeroshop_steps.{step}").add_arguments(parser)
    return {action.dest: action for action in parser._actions if not action.required}


def _find_fault(action: argparse.Action, value: Any) -> str:
    """What is wrong with the value of an option; an empty text where nothing is."""
    words = list(map(str, value)) if isinstance(value, list) else [str(value)]
    if action.choices is not None and not set(words) <= set(map(str, action.choices)):
        return f"none of {', '.join(map(str, action.choices))}"
    try:
        for word in words:
            action.type and action.type(word)  # type: ignore[operator]
    except (ValueError, argparse.ArgumentTypeError):
        return f"no {getattr(action.type, '__name__', 'value of this option')}"
    return ""
