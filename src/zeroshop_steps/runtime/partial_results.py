"""Results of a long loop, kept item by item beside its output until that is written, so that a killed step continues where it was."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO


class PartialResults:
    """A file of JSON lines: what the results belong to, then a key and a value each.

    As a context manager it deletes the file once the loop and what follows it have ended well.

    Args:
        out: the output that the loop is for; the file lies beside it.
        belongs_to: values that must be the same for results to be taken up; of paths, all files below count with size and time.
    """

    def __init__(self, out: Path, belongs_to: Mapping[str, Any]) -> None:
        self.path = out.with_name(f".{out.name}.partial")
        self._first = json.dumps({key: _stamp(value) for key, value in sorted(belongs_to.items())})
        self.done = self._read()
        self._file: TextIO | None = None

    def _read(self) -> dict[str, Any]:
        """The whole lines of a file that belongs here; a last line that was cut short counts as missing."""
        try:
            first, *lines = self.path.read_text().splitlines()
        except (OSError, ValueError):
            return {}
        found: dict[str, Any] = {}
        for line in lines if first == self._first else ():
            try:
                key, value = json.loads(line)
            except ValueError:
                break
            found[key] = value
        return found

    def keep(self, key: str, value: Any) -> None:
        """Add a result, which JSON can hold."""
        if self._file is None:  # only now: a step that ends before its first result leaves nothing
            self.path.parent.mkdir(parents=True, exist_ok=True)
            kept = [self._first, *(json.dumps(item) for item in self.done.items())]
            self.path.write_text("".join(f"{line}\n" for line in kept))
            self._file = self.path.open("a")
        self.done[key] = value
        self._file.write(json.dumps([key, value]) + "\n")
        self._file.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._file is not None:
            self._file.close()
        if kind is None:
            self.path.unlink(missing_ok=True)


def _stamp(value: Any) -> Any:
    if not isinstance(value, Path):
        return value if isinstance(value, int | float | str | None) else str(value)
    files: Iterable[Path] = sorted(value.rglob("*")) if value.is_dir() else [value]
    return [str(value), *([str(file), file.stat().st_size, file.stat().st_mtime_ns] for file in files if file.is_file())]
