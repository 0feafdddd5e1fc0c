"""Tidy tables as CSV, by pandas: one row a measurement, with its coordinates as columns."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write


def read_table(path: Path) -> pd.DataFrame:
    """The rows of a CSV, every cell as the text that it is: an empty one as "", numbers with their digits.

    Raises:
        StepError: the file is missing or has no rows.
    """
    try:
        table = pd.read_csv(path, dtype=str, na_filter=False)
    except FileNotFoundError:
        raise StepError(f"{path} does not exist; run the step that writes it first") from None
    except pd.errors.EmptyDataError:
        table = pd.DataFrame()
    if table.empty:
        raise StepError(f"{path} has no rows; delete it and run its step again")
    return table


def write_table(path: Path, rows: pd.DataFrame | Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None) -> None:
    """Write rows as CSV, numbers as Python prints them, lines ended as RFC 4180 says.

    Args:
        path: the file.
        rows: what a row lacks stays empty.
        columns: in this order; by default those that any row has, in the order in which they first appear.
    """
    # As objects, since a column of numbers with a gap would otherwise become one of floats: 20 would be written as 20.0.
    table = pd.DataFrame(rows, columns=None if columns is None else list(columns), dtype=object)
    with atomic_write(path) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\r\n")
