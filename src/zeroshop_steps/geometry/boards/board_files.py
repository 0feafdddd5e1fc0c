"""Boards that people have printed already, each described by a small YAML file, or by the side of a tag alone.

    kind: charuco          # columns, rows: squares; square_mm, marker_mm; first_id; legacy: true for boards of OpenCV before 4.6
    kind: grid             # columns, rows: tags; marker_mm, gap_mm between them; first_id; from_below: true where ids rise upwards
    kind: tags             # marker_mm: tags of this side with any number, each for itself
    kind: bar              # ids: two tags; distance_mm between their centres

`dictionary` is 36h11 and so on for AprilTag, 5x5_1000 and so on for ArUco. A file of Kalibr (target_type: aprilgrid) is read, too.
"""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import yaml

from zeroshop_steps.geometry.boards.printed_board import Board, TagBoard
from zeroshop_steps.runtime.errors import StepError

OWN = Path(__file__).parent
OF_ONE_TAG = re.compile(r"(?P<dictionary>[\w]+):\s*(?P<side>\d+(\.\d+)?)(\s*mm)?")
LENGTH_MM = {"type": "number", "minimum": 1, "maximum": 5000}
COUNT = {"type": "integer", "minimum": 1, "maximum": 1000}
NUMBER, SWITCH = {"type": "integer", "minimum": 0}, {"type": "boolean"}
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "charuco": (
        {"columns": COUNT, "rows": COUNT, "square_mm": LENGTH_MM, "marker_mm": LENGTH_MM},
        {"first_id": NUMBER, "legacy": SWITCH, "paper_mm": {"type": "array", "items": LENGTH_MM, "minItems": 2, "maxItems": 2}},
    ),
    "grid": (
        {"columns": COUNT, "rows": COUNT, "marker_mm": LENGTH_MM, "gap_mm": {"type": "number", "minimum": 0}},
        {"first_id": NUMBER, "from_below": SWITCH, "border_cells": COUNT},
    ),
    "tags": ({"marker_mm": LENGTH_MM}, {"border_cells": COUNT}),
    "bar": (
        {"ids": {"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 2, "uniqueItems": True}, "distance_mm": LENGTH_MM},
        {"border_cells": COUNT},
    ),
}
"""Keys of each kind that are needed, and keys that may be there, with their JSON schemas."""


def read_board(name: str) -> Board | TagBoard:
    """The board of a name: one of ours (a4, a3), a YAML file, or DICTIONARY:SIDE in mm for tags of one size, such as 36h11:50.

    Raises:
        StepError: the file is missing, or does not describe a board.
    """
    own = OWN / f"{name.lower()}.yaml"
    single = OF_ONE_TAG.fullmatch(name)
    if single:
        return _make(name, {"kind": "tags", "dictionary": single["dictionary"], "marker_mm": float(single["side"])})
    path = own if own.is_file() else Path(name)
    if not path.is_file():
        ours = ", ".join(sorted(file.stem for file in OWN.glob("*.yaml")))
        raise StepError(
            f"there is no board {name}; expected {ours}, a YAML file that describes one, or tags of one size in mm, such as 36h11:50"
        )
    try:
        content = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise StepError(f"{path} cannot be read as YAML ({str(error).splitlines()[0]}); correct it") from None
    return _make(own.stem if path == own else str(path), _from_kalibr(str(path), content))


def _from_kalibr(name: str, content: Any) -> Any:
    """A description of Kalibr's AprilGrid in the words of ours; anything else as it is."""
    if not isinstance(content, dict) or content.get("target_type") != "aprilgrid":
        return content
    if not all(isinstance(content.get(key), int | float) for key in ("tagSize", "tagSpacing")):
        raise StepError(f"board {name} of Kalibr needs the numbers tagSize, in metres, and tagSpacing, in tag sizes; correct them")
    side_mm = 1000.0 * content["tagSize"]
    grid = {"kind": "grid", "dictionary": "36h11", "columns": content.get("tagCols"), "rows": content.get("tagRows"), "marker_mm": side_mm}
    grid["first_id"] = content.get("codeOffset", 0)
    return grid | {"gap_mm": side_mm * content["tagSpacing"], "from_below": True, "border_cells": 2}


def _make(name: str, content: Any) -> Board | TagBoard:
    if not isinstance(content, dict) or content.get("kind") not in KINDS:
        kind = content.get("kind", content.get("target_type")) if isinstance(content, dict) else None
        raise StepError(f"board {name} has {f'the kind {kind!r}' if kind else 'no kind'}; expected one of {', '.join(KINDS)}")
    needed, possible = KINDS[content["kind"]]
    given = {key: value for key, value in content.items() if key not in ("kind", "dictionary")}
    given = json.loads(json.dumps(given, default=str), parse_constant=str)  # NaN and infinities become words, which no schema takes
    schema = {"required": list(needed), "properties": needed | possible, "additionalProperties": False}
    error = next(jsonschema.Draft202012Validator(schema).iter_errors(given), None)
    if error is not None:
        where = f"{error.absolute_path[0]}: " if error.absolute_path else ""
        raise StepError(
            f"board {name} of kind {content['kind']}: {where}{error.message}; expected {', '.join(needed)}, in millimetres, and possibly"
            f" {', '.join(possible)}"
        )
    whole = {key: int(value) if isinstance(value, float) and value.is_integer() else value for key, value in given.items()}  # 5.0 columns
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in whole.items()}
    dictionary = find_dictionary(name, str(content.get("dictionary", "")))
    count = len(cv2.aruco.getPredefinedDictionary(dictionary).bytesList)
    of_board = values.get("columns", 0) * values.get("rows", 0) // (2 if content["kind"] == "charuco" else 1)
    if (last := max(*values.get("ids", (0,)), values.get("first_id", 0) + of_board - 1)) >= count:
        raise StepError(
            f"board {name} needs the tag {last}, but {content['dictionary']} has {count}, counted from 0; name the one you printed"
        )
    if content["kind"] == "charuco":
        if not values["marker_mm"] < values["square_mm"]:
            raise StepError(f"board {name}: marker_mm is {values['marker_mm']}; expected less than square_mm, {values['square_mm']}")
        values.setdefault("first_id", 0)
        values.setdefault("paper_mm", (0.0, 0.0))
        return Board(name, dictionary=dictionary, **values)
    return TagBoard(name, content["kind"], dictionary, **values)


def find_dictionary(name: str, text: str) -> int:
    """OpenCV's number of a dictionary by its usual names; `name` is the board's. Raises StepError for one that there is not."""
    plain = text.lower().removeprefix("tag").removeprefix("dict_").removeprefix("apriltag_")
    names = [f"DICT_APRILTAG_{plain}", f"DICT_{plain.upper()}"]
    found = next((getattr(cv2.aruco, one) for one in names if plain and hasattr(cv2.aruco, one)), None)
    if found is None:
        raise StepError(f"board {name} has the dictionary {text!r}; expected 16h5, 25h9, 36h10, 36h11, or 4x4_50 to 7x7_1000")
    return int(found)


BOARDS: dict[str, Board] = {file.stem: board for file in sorted(OWN.glob("*.yaml")) if isinstance(board := read_board(file.stem), Board)}
"""Our own boards, which `print_board` writes."""
