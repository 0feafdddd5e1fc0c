"""The tables of a PLY file as any program writes it: ASCII or binary of either byte order, with lists of any length."""

import re
import struct
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zeroshop_steps.runtime.errors import StepError

_NAMES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
_SIZED = {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d"}
TYPES = _NAMES | _SIZED
"""Codes of the types, which `struct` and NumPy share."""
BYTE_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
LINE_END = re.compile(rb"\r\n|\n|\r")
HEADER_END = re.compile(rb"(?:\r\n|\n|\r)end_header[ \t]*(?:\r\n|\n|\r|$)")


@dataclass(frozen=True)
class Lists:
    """A list property: the lists of N rows, one after the other.

    Attributes:
        values: all entries.
        counts: (N,) int64 entries of each row.
    """

    values: np.ndarray
    counts: np.ndarray


@dataclass(frozen=True)
class Property:
    """A property of the header: its name in lower case, the codes of its type and, for a list, of the type of its count."""

    name: str
    code: str
    count_code: str | None = None


@dataclass(frozen=True)
class Element:
    """An element of a PLY file.

    Attributes:
        rows: how many.
        properties: as the header lists them.
        columns: (rows,) values by the property's name, in the file's type; float64 of ASCII files.
        lists: the same of list properties.
    """

    rows: int
    properties: tuple[Property, ...]
    columns: dict[str, np.ndarray]
    lists: dict[str, Lists]

    def code_of(self, name: str) -> str:
        """The code of a property's type in the header."""
        return next(entry.code for entry in self.properties if entry.name == name)


@dataclass(frozen=True)
class PlyTables:
    """What a PLY file holds: its elements by name, and the texts of its `comment` and `obj_info` lines."""

    elements: dict[str, Element]
    remarks: tuple[str, ...]


def read_ply_tables(path: Path) -> PlyTables:
    """Read all elements of a PLY file. Raises StepError where it is none, or cut off."""
    content = path.read_bytes()
    end = HEADER_END.search(content)
    try:
        if not content.startswith(b"ply") or end is None:
            raise ValueError("its header does not end" if content.startswith(b"ply") else "it does not start with ply")
        lines = _split_lines(content[: end.start()])
        form, elements = _parse_header(lines)
        body, order = content[end.end() :], BYTE_ORDERS[form]
        if form == "ascii":
            # As numbers of 8 bytes, words are read like a binary file.
            body = np.array(body.split(), dtype="S").astype("<f8").tobytes() if body.strip() else b""
        start = 0
        for name, element in elements.items():
            wide = tuple(Property(entry.name, "d", entry.count_code and "d") for entry in element.properties)
            columns, lists, start = _read_rows(body, start, name, element.rows, wide if form == "ascii" else element.properties, order)
            elements[name] = replace(element, columns=columns, lists=lists)
    except (ArithmeticError, IndexError, KeyError, ValueError) as error:
        raise StepError(f"mesh {path} cannot be read as PLY ({error}); export it again") from None
    return PlyTables(elements, _list_remarks(lines))


def read_remarks(path: Path) -> tuple[str, ...]:
    """The texts of the `comment` and `obj_info` lines of a PLY file, read from its header alone."""
    with open(path, "rb") as file:
        header = HEADER_END.split(file.read(1 << 16), maxsplit=1)[0]
    return _list_remarks(_split_lines(header))


def _split_lines(header: bytes) -> list[str]:
    return [line.decode("utf-8", "replace").strip() for line in LINE_END.split(header)]


def _list_remarks(lines: list[str]) -> tuple[str, ...]:
    return tuple(line.split(None, 1)[1] for line in lines if re.match(r"(comment|obj_info)\s+\S", line))


def _parse_header(lines: list[str]) -> tuple[str, dict[str, Element]]:
    """The format and the elements, still without their rows."""
    form, elements, name = "", {}, ""
    for words in (line.split() for line in lines):
        match words:
            case ["format", form, *_]:
                pass
            case ["element", name, rows]:
                elements[name] = Element(int(rows), (), {}, {})
            case ["property", "list", count_type, kind, entry]:
                known = Property(entry.lower(), TYPES[kind], TYPES[count_type])
                elements[name] = replace(elements[name], properties=(*elements[name].properties, known))
            case ["property", kind, entry]:
                elements[name] = replace(elements[name], properties=(*elements[name].properties, Property(entry.lower(), TYPES[kind])))
    if form not in BYTE_ORDERS:
        raise ValueError(f"its format is {form or 'not named'}, expected {', '.join(BYTE_ORDERS)}")
    return form, elements


def _read_rows(
    body: bytes, start: int, name: str, rows: int, properties: tuple[Property, ...], order: str
) -> tuple[dict[str, np.ndarray], dict[str, Lists], int]:
    """Columns and lists of an element whose rows begin at byte `start`, and where they end."""
    if not rows or not properties:
        return {one.name: np.zeros(0) for one in properties}, {one.name: Lists(np.zeros(0), np.zeros(0, int)) for one in properties}, start
    lengths = _measure_lists(body, start, properties, order)
    fields: list[tuple] = []
    for index, (entry, length) in enumerate(zip(properties, lengths, strict=True)):
        fields += [(f"n{index}", order + entry.count_code)] if entry.count_code else []
        fields += [(f"v{index}", order + entry.code, (length,) if entry.count_code else ())]
    layout = np.dtype(fields)
    end = start + rows * layout.itemsize
    table = np.frombuffer(body, layout, rows, start) if end <= len(body) else None
    listed = {index: entry for index, entry in enumerate(properties) if entry.count_code}
    if table is None or any((table[f"n{index}"] != lengths[index]).any() for index in listed):
        if not listed:
            raise ValueError(f"element {name} is cut off: {(len(body) - start) // layout.itemsize} of {rows} rows are there")
        return _read_uneven_rows(body, start, name, rows, properties, order)
    columns = {entry.name: table[f"v{index}"] for index, entry in enumerate(properties) if index not in listed}
    lists = {entry.name: Lists(table[f"v{index}"].reshape(-1), np.full(rows, lengths[index])) for index, entry in listed.items()}
    return columns, lists, end


def _measure_lists(body: bytes, start: int, properties: tuple[Property, ...], order: str) -> list[int]:
    """The lengths of the lists in the row at byte `start`; 1 for a property that is no list."""
    lengths = []
    for entry in properties:
        length = 1
        if entry.count_code:
            if start + struct.calcsize(order + entry.count_code) > len(body):
                raise ValueError("it is cut off")
            length = int(struct.unpack_from(order + entry.count_code, body, start)[0])
            if length < 0:
                raise ValueError(f"a list of {entry.name} has {length} entries")
            start += struct.calcsize(order + entry.count_code)
        lengths.append(length)
        start += length * struct.calcsize(order + entry.code)
    return lengths


def _read_uneven_rows(
    body: bytes, start: int, name: str, rows: int, properties: tuple[Property, ...], order: str
) -> tuple[dict[str, np.ndarray], dict[str, Lists], int]:
    """`_read_rows` of lists whose lengths differ from row to row."""
    parts: list[list[bytes]] = [[] for _ in properties]
    counts = np.ones((rows, len(properties)), np.int64)
    sizes = [struct.calcsize(order + entry.code) for entry in properties]
    count_sizes = [struct.calcsize(order + entry.count_code) if entry.count_code else 0 for entry in properties]
    for row in range(rows):
        lengths = _measure_lists(body, start, properties, order)
        counts[row] = lengths
        for part, length, size, count_size in zip(parts, lengths, sizes, count_sizes, strict=True):
            start += count_size + length * size
            part.append(body[start - length * size : start])
        if start > len(body):
            raise ValueError(f"element {name} is cut off: {row} of {rows} rows are there")
    values = [np.frombuffer(b"".join(part), order + entry.code) for part, entry in zip(parts, properties, strict=True)]
    columns = {entry.name: values[index] for index, entry in enumerate(properties) if not entry.count_code}
    lists = {entry.name: Lists(values[index], counts[:, index]) for index, entry in enumerate(properties) if entry.count_code}
    return columns, lists, start
