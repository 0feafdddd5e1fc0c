"""Tensors of a checkpoint that holds whole modules of another library, read without that library and without running anything of it.

Such a file is a zip archive with a pickle and the bytes of its tensors. A pickle names functions that are called while it is read.
Here every name stands for an inert shell that keeps what it is given; only tensors are built, by functions of this file.
"""

import pickle
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import torch

from zeroshop_steps.runtime.errors import StepError

DTYPES = {
    "FloatStorage": torch.float32, "HalfStorage": torch.float16, "DoubleStorage": torch.float64, "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64, "IntStorage": torch.int32, "BoolStorage": torch.bool, "ByteStorage": torch.uint8,
}  # fmt: skip
MODULES = ("ema", "model")  # where the checkpoint has its network: the averaged one if there is one


class Shell:
    """Stands for anything that a pickle names; does nothing."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.state = state if isinstance(state, dict) else {}

    def __setitem__(self, key: Any, value: Any) -> None: ...

    def append(self, value: Any) -> None: ...

    def extend(self, values: Any) -> None: ...

    def add(self, value: Any) -> None: ...

    def __call__(self, *_: Any, **__: Any) -> "Shell":
        return Shell()


def read_pickled_modules(path: Path) -> dict[str, torch.Tensor]:
    """The parameters and buffers of a pickled network by name, in single precision where they are numbers with a fraction.

    Raises:
        StepError: the file is not there, damaged, cut short, or no such checkpoint.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            name = next(name for name in archive.namelist() if name.endswith("/data.pkl"))
            content = _InertUnpickler(archive, name.removesuffix("data.pkl")).load()
    except FileNotFoundError:
        raise StepError(f"the weights {path} do not exist") from None
    except Exception as error:  # whatever a damaged pickle leads to
        first = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise StepError(f"{path} is no whole checkpoint ({first}); it is damaged or was cut short. Delete it and fetch it again") from None
    found = next((content[key] for key in MODULES if isinstance(content.get(key), Shell)), None) if isinstance(content, dict) else None
    if found is None:
        raise StepError(f"{path} holds no network; it is not a checkpoint of this kind. Take the one that weights.csv names")
    return dict(_list_tensors(found, ""))


class _InertUnpickler(pickle.Unpickler):
    def __init__(self, archive: zipfile.ZipFile, folder: str) -> None:
        super().__init__(archive.open(f"{folder}data.pkl"))
        self._archive, self._folder = archive, folder

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if module == "torch" and name in DTYPES:
            return DTYPES[name]
        known = {"_rebuild_tensor_v2": _rebuild_tensor, "_rebuild_parameter": _rebuild_parameter}
        return known[name] if module == "torch._utils" and name in known else Shell

    def persistent_load(self, pid: Any) -> torch.Tensor:
        """The numbers of a storage, which a pickle names by ("storage", type, key, device, count)."""
        _, dtype, key, *_ = pid
        content = bytearray(self._archive.read(f"{self._folder}data/{key}"))
        return torch.frombuffer(content, dtype=dtype) if content else torch.empty(0, dtype=dtype)


def _rebuild_tensor(storage: torch.Tensor, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> torch.Tensor:
    tensor = storage.as_strided(tuple(size), tuple(stride), offset)
    return tensor.float() if tensor.is_floating_point() else tensor.clone()


def _rebuild_parameter(tensor: torch.Tensor, *_: Any) -> torch.Tensor:
    return tensor


def _list_tensors(module: Shell, prefix: str) -> list[tuple[str, torch.Tensor]]:
    """Names as `state_dict` gives them."""
    parts = [part for kind in ("_parameters", "_buffers") for part in (module.state.get(kind) or {}).items()]
    found = [(prefix + name, tensor) for name, tensor in parts if isinstance(tensor, torch.Tensor)]
    for name, child in (module.state.get("_modules") or {}).items():
        if isinstance(child, Shell):
            found += _list_tensors(child, f"{prefix}{name}.")
    return found
