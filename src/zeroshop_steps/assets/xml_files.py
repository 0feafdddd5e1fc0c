"""XML files as URDF and MJCF are."""

import xml.etree.ElementTree as xml
from collections.abc import Iterable
from pathlib import Path

from zeroshop_steps.runtime.files import atomic_write


def add(parent: xml.Element, tag: str, /, **attributes: str) -> xml.Element:
    """A new element within `parent`."""
    return xml.SubElement(parent, tag, attributes)


def numbers(values: Iterable[float]) -> str:
    """Numbers with blanks between, with 9 significant digits."""
    return " ".join(f"{float(value):.9g}" for value in values)


def write_xml(path: Path, root: xml.Element) -> None:
    """Write an indented XML file."""
    xml.indent(root)
    with atomic_write(path) as temporary:
        temporary.write_bytes(xml.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
