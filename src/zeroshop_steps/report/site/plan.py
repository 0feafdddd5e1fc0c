"""Where the cameras stood: a plan seen from above and a section, as SVG. Not by Matplotlib, for the reasons in svg_plots.py."""

import numpy as np
from markupsafe import Markup, escape

from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.transforms import transform_camera

SIZE = 300
MARGIN = 24


def camera_plan(model: SparseModel, object_from_registration: np.ndarray, unit: str) -> Markup:
    """Centres and view directions of the registered cameras around the object: from above (x to the right) and from the side."""
    moved = [transform_camera(camera, object_from_registration) for camera in model.cameras]
    centres = np.array([camera.centre_in_world for camera in moved])
    forward = np.array([camera.camera_from_world[2, :3] for camera in moved])
    names = [camera.name for camera in model.cameras]
    radius = float(np.abs(centres).max()) * 1.05
    away = np.linalg.norm(centres[:, :2], axis=1)
    outward = np.einsum("ij,ij->i", forward[:, :2], centres[:, :2]) / np.maximum(away, 1e-12)
    above = _picture(centres[:, :2], forward[:, :2], names, radius, "from above")
    side = _picture(
        np.stack([away, centres[:, 2]], 1), np.stack([outward, forward[:, 2]], 1), names, radius, "from the side: distance and height"
    )
    note = f"{len(moved)} cameras, up to {np.linalg.norm(centres, axis=1).max():.4g} {escape(unit)} from the object"
    return Markup(f'<div class="plan">{above}{side}</div><figcaption>{note}</figcaption>')


def _picture(places: np.ndarray, directions: np.ndarray, names: list[str], radius: float, title: str) -> str:
    def at(place: np.ndarray) -> tuple[float, float]:
        x, y = SIZE / 2 + place / radius * (SIZE / 2 - MARGIN) * (1, -1)
        return round(float(x), 1), round(float(y), 1)

    parts = [f'<line class="grid" x1="0" x2="{SIZE}" y1="{SIZE / 2}" y2="{SIZE / 2}"/>']
    parts.append(f'<line class="grid" x1="{SIZE / 2}" x2="{SIZE / 2}" y1="0" y2="{SIZE}"/>')
    parts.append(f'<rect class="dot s2" x="{SIZE / 2 - 5}" y="{SIZE / 2 - 5}" width="10" height="10"><title>the object</title></rect>')
    for place, direction, name in zip(places, directions, names, strict=True):
        (x, y), (tip_x, tip_y) = at(place), at(place + direction * radius * 0.13)
        parts.append(f'<line class="series s1" x1="{x}" y1="{y}" x2="{tip_x}" y2="{tip_y}"/>')
        parts.append(f'<circle class="dot s1" cx="{x}" cy="{y}" r="4"><title>{escape(name)}</title></circle>')
    parts.append(f'<text x="8" y="{SIZE - 8}">{escape(title)}</text>')
    return f'<svg viewBox="0 0 {SIZE} {SIZE}" role="img" aria-label="cameras {escape(title)}">{"".join(parts)}</svg>'
