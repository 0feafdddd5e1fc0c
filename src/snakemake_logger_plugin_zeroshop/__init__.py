"""Snakemake's logger plugin of the command `zeroshop`, which Snakemake finds by the name of this package: `--logger zeroshop`.

It writes what a run plans and does as lines of JSON to the file descriptor that the variable EVENTS_FD names. Snakemake's own report stays.
"""

import contextlib
import json
import os
from logging import LogRecord
from typing import Any

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent

EVENTS_FD = "ZEROSHOP_EVENTS_FD"


def read_event(record: LogRecord) -> dict[str, Any] | None:
    """What a record says; None for what is not shown.

    `planned` has the number of jobs by rule; a `job` that starts has its `rule`, and `says` what it does; one that ends is `finished`.
    """
    event = vars(record).get("event")
    if event == LogEvent.RUN_INFO:
        return {"planned": {rule: count for rule, count in vars(record)["stats"].items() if rule != "total"}}
    if event == LogEvent.JOB_INFO:
        said = vars(record)
        return {"job": said["jobid"], "rule": said["rule_name"], "says": said["rule_msg"] or ""}
    return {"finished": vars(record)["job_id"]} if event == LogEvent.JOB_FINISHED else None


class LogHandler(LogHandlerBase):
    """Writes the events of a run."""

    writes_to_stream = writes_to_file = has_filter = has_formatter = needs_rulegraph = False

    def __post_init__(self) -> None:
        self.descriptor = int(os.environ[EVENTS_FD])

    def emit(self, record: LogRecord) -> None:
        """Write a line for an event that `zeroshop` shows."""
        if event := read_event(record):
            with contextlib.suppress(BrokenPipeError):  # `zeroshop` was killed, and this run goes on
                os.write(self.descriptor, f"{json.dumps(event)}\n".encode())
