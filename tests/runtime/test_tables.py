"""Tables are written the same from rows and from frames."""

import numpy as np
import pandas as pd

from zeroshop_steps.runtime.tables import read_table, write_table

ROWS = [
    {"measure": "faces", "value": 20},
    {"measure": "a, b", "value": np.float64(0.1), "reason": 'says "no"'},
    {"measure": "gap", "value": None, "reason": "two\nlines"},
    {"measure": "nan", "value": float("nan")},
    {"measure": "flag", "value": True},
]


def test_rows_and_frames_give_the_same_bytes(tmp_path):
    write_table(tmp_path / "rows.csv", ROWS)
    write_table(tmp_path / "frame.csv", pd.DataFrame(ROWS, dtype=object))
    assert (tmp_path / "rows.csv").read_bytes() == (tmp_path / "frame.csv").read_bytes()
    assert (tmp_path / "rows.csv").read_bytes().startswith(b'measure,value,reason\r\nfaces,20,\r\n"a, b",0.1,"says ""no"""\r\n')
    assert list(read_table(tmp_path / "rows.csv").value) == ["20", "0.1", "", "", "True"]


def test_columns_are_those_that_are_asked_for_in_their_order(tmp_path):
    for rows in (ROWS, pd.DataFrame(ROWS, dtype=object)):
        write_table(tmp_path / "table.csv", rows, ["reason", "measure"])
        assert (tmp_path / "table.csv").read_bytes().startswith(b"reason,measure\r\n,faces\r\n")
