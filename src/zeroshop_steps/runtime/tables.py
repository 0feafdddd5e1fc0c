"""Tidy tables as CSV: one row a measurement, with its coordinates as columns.

pandas takes half a second to import, so a step that only writes rows does without.
"""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

if TYPE_CHECKING:
    import pandas as pd


def read_table(path: Path) -> "pd.DataFrame":
    """The rows of a CSV, every cell as the text that it is: an empty one as "", numbers with their digits.

    Raises:
        StepError: the file is missing or has no rows.
    """
    import pandas as pd

    try:
        table = pd.read_csv(path, dtype=str, na_filter=False)
    except FileNotFoundError:
        raise StepError(f"{path} does not exist; run the step that writes it first") from None
    except pd.errors.EmptyDataError:
        table = pd.DataFrame()
    if table.empty:
        raise StepError(f"{path} has no rows; delete it and run its step again")
    return table


def write_table(path: Path, rows: "pd.DataFrame | Sequence[Mapping[str, Any]]", columns: Sequence[str] | None = None) -> None:
    """Write rows as CSV, numbers as Python prints them, lines ended as RFC 4180 says.

    Args:
        path: the file.
        rows: what a row lacks stays empty.
        columns: in this order; by default those that any row has, in the order in which they first appear.
    """
    with atomic_write(path) as temporary:
        if not isinstance(rows, Sequence):
            # As objects, since a column of numbers with a gap would otherwise become one of floats: 20 would be written as 20.0.
            rows.astype(object).to_csv(temporary, index=False, columns=columns, lineterminator="\r\n")
            return
        names = list(dict.fromkeys(name for row in rows for name in row) if columns is None else columns)
        with temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            writer.writerows([_print_value(row.get(name)) for name in names] for row in rows)


def _print_value(value: Any) -> str:
    """A value as text; what is missing is empty."""
    return "" if value is None or value != value else str(value)
