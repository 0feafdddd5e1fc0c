"""What a PyTorch checkpoint holds, read without running anything of it and without the libraries whose objects are in it.

Such a file is a zip archive with a pickle and the bytes of its tensors. A pickle names functions that are called while it is read.
Here every name stands for an inert shell that keeps what it is given; only tensors and dictionaries are built, by functions of this file.
"""

import pickle
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import torch

DTYPES = {
    "FloatStorage": torch.float32, "HalfStorage": torch.float16, "DoubleStorage": torch.float64, "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64, "IntStorage": torch.int32, "BoolStorage": torch.bool, "ByteStorage": torch.uint8,
}  # fmt: skip


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


def read_inert(path: Path) -> Any:
    """The content of a checkpoint: tensors as they are, and shells for all else that it names.

    Raises:
        FileNotFoundError, ValueError: the file is not there; damaged, cut short, or no such checkpoint.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            name = next(name for name in archive.namelist() if name.endswith("/data.pkl"))
            return _InertUnpickler(archive, name.removesuffix("data.pkl")).load()
    except FileNotFoundError:
        raise
    except Exception as error:  # whatever a damaged pickle leads to
        raise ValueError((str(error).strip() or type(error).__name__).splitlines()[0]) from None


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
    return storage.as_strided(tuple(size), tuple(stride), offset).clone()


def _rebuild_parameter(tensor: torch.Tensor, *_: Any) -> torch.Tensor:
    return tensor
