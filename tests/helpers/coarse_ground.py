"""Rendered scenes whose ground is only as fine as a test's small photos can show."""

import functools
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from zeroshop_steps.synthetic.rendering import lighting
from zeroshop_steps.synthetic.scenes import scene_meshes


@contextmanager
def coarse_ground(texels: int) -> Iterator[None]:
    """Within, the printed ground has so many texels on a side, and its light is sampled more coarsely."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lighting, "SURFACE_CELLS", 24)
        patch.setattr(scene_meshes, "make_rich_texture", functools.partial(scene_meshes.make_rich_texture, texels=texels))
        yield
