"""Tensors of a checkpoint that holds whole modules of another library, read without that library (inert_pickles)."""

from pathlib import Path

import torch

from zeroshop_steps.networks.inert_pickles import Shell, read_inert
from zeroshop_steps.runtime.errors import StepError

MODULES = ("ema", "model")  # where the checkpoint has its network: the averaged one if there is one


def read_pickled_modules(path: Path) -> dict[str, torch.Tensor]:
    """The parameters and buffers of a pickled network by name, in single precision where they are numbers with a fraction.

    Raises:
        StepError: the file is not there, damaged, cut short, or no such checkpoint.
    """
    path = Path(path)
    try:
        content = read_inert(path)
    except FileNotFoundError:
        raise StepError(f"the weights {path} do not exist") from None
    except ValueError as error:
        raise StepError(f"{path} is no whole checkpoint ({error}); it is damaged or was cut short. Delete it and fetch it again") from None
    found = next((content[key] for key in MODULES if isinstance(content.get(key), Shell)), None) if isinstance(content, dict) else None
    if found is None:
        raise StepError(f"{path} holds no network; it is not a checkpoint of this kind. Take the one that weights.csv names")
    return {name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in _list_tensors(found, "")}


def _list_tensors(module: Shell, prefix: str) -> list[tuple[str, torch.Tensor]]:
    """Names as `state_dict` gives them."""
    parts = [part for kind in ("_parameters", "_buffers") for part in (module.state.get(kind) or {}).items()]
    found = [(prefix + name, tensor) for name, tensor in parts if isinstance(tensor, torch.Tensor)]
    for name, child in (module.state.get("_modules") or {}).items():
        if isinstance(child, Shell):
            found += _list_tensors(child, f"{prefix}{name}.")
    return found
