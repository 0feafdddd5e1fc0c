"""What trimesh does not make of an OBJ: its text is changed before it is read."""

import re

import numpy as np

from zeroshop_steps.geometry.meshes.mesh_repair import cut_polygons

VERTEX, POLYGON = re.compile(rb"(?m)^v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)"), re.compile(rb"(?m)^f((?:[ \t]+[-\d/]+){4,})")
VERTEX_COLOR = re.compile(rb"(?m)^(v(?:[ \t]+\S+){3})[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)[ \t]*\r?$")
"""A line of OBJ with a colour behind the place."""


def scale_colors(content: bytes) -> bytes:
    """An OBJ with colours at vertices from 0 to 1, as trimesh expects them, where they are from 0 to 255."""
    found = [float(value) for line in VERTEX_COLOR.findall(content) for value in line[1:]]
    if max(found, default=0.0) <= 1:
        return content
    return VERTEX_COLOR.sub(lambda line: b" ".join([line[1], *(b"%f" % (float(line[index]) / 255) for index in (2, 3, 4))]), content)


def cut_obj(content: bytes) -> bytes:
    """An OBJ whose concave polygons are triangles; trimesh cuts all as fans."""
    content = content.replace(b"\\\r\n", b"").replace(b"\\\n", b"")  # lines that go on in the next one
    lines, vertices = list(POLYGON.finditer(content)), list(VERTEX.finditer(content))
    words = [line[1].split() for line in lines]
    counts = np.array([len(one) for one in words], int)
    before = np.searchsorted([line.start() for line in vertices], [line.start() for line in lines])  # from where a negative number counts
    numbers = np.array([int(word.split(b"/")[0]) for one in words for word in one], int)
    numbers += np.where(numbers < 0, np.repeat(before, counts), -1)
    if not lines or numbers.min() < 0 or numbers.max() >= len(vertices):  # which trimesh refuses
        return content
    polygons, corners = cut_polygons(np.array([line.groups() for line in vertices]).astype(float)[numbers], counts)
    parts, end = [], 0
    for polygon in np.unique(polygons[(corners[:, 0] > 0) | (corners[:, 2] != corners[:, 1] + 1)]):
        rows = corners[polygons.searchsorted(polygon) : polygons.searchsorted(polygon, "right")]
        parts += [content[end : lines[polygon].start()], b"\n".join(b"f " + b" ".join(words[polygon][one] for one in row) for row in rows)]
        end = lines[polygon].end()
    return b"".join([*parts, content[end:]])
