"""One progress display: a bar on a terminal, plain lines in a log."""

import sys
import threading
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Item = TypeVar("Item")


class ProgressReport:
    """Shows how far a loop is, with a free text (loss, count) beside it.

    Used as a context manager. On a terminal this is one moving bar; in a log it is a plain line at most every
    `line_every_s` seconds, so that a log of hours stays short. `done` are the steps that an earlier run has made. Several threads
    may advance it.
    """

    def __init__(self, title: str, total: int, line_every_s: float = 10.0, done: int = 0) -> None:
        self.title, self.total, self.line_every_s = title, total, line_every_s
        self.done = self._earlier = done
        self._start_s = self._last_line_s = time.monotonic()
        self._bar: Progress | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> "ProgressReport":
        if sys.stderr.isatty():
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
            )
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._bar.start()
            self._task = self._bar.add_task(self.title, total=self.total, completed=self.done, note="")
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, steps: int = 1, note: str = "") -> None:
        """Count `steps` more as done and show `note` beside the bar."""
        with self._lock:
            self.done += steps
            now_s = time.monotonic()
            if self._bar is not None:
                self._bar.update(self._task, advance=steps, note=note)
            elif self.done >= self.total or now_s - self._last_line_s >= self.line_every_s:
                self._last_line_s = now_s
                left_s = (now_s - self._start_s) / max(self.done - self._earlier, 1) * (self.total - self.done)
                print(f"{self.title}: {self.done}/{self.total}, {left_s:.0f} s left {note}".rstrip(), file=sys.stderr, flush=True)


def track(items: Iterable[Item], title: str, total: int) -> Iterator[Item]:
    """Iterate over `items` and show the progress."""
    with ProgressReport(title, total) as report:
        for item in items:
            yield item
            report.advance()
