"""ZeroShOP for Python: photos or a film of an object become a textured mesh of true size.

    from zeroshop import reconstruct

    asset = reconstruct("photos/mug", height_m=0.096)
    print(asset.grade, asset.extents_mm, asset.mesh)
    asset.export("urdf")

Results are files below results/photos/NAME, as the command `zeroshop` makes them, and are made anew only where what they depend on changed.
Stages are modules with plain functions from paths to paths, such as `zeroshop_steps.register.colmap.register`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zeroshop_steps import __version__
from zeroshop_steps.app.check import check_capture
from zeroshop_steps.app.reconstruct_object import METHODS, Outcome, Request, find_outcome, make_mesh
from zeroshop_steps.app.summary import find_reason
from zeroshop_steps.runtime.errors import StepError

__all__ = ["Asset", "StepError", "__version__", "check", "load", "reconstruct"]


@dataclass(frozen=True)
class Asset:
    """A mesh that was made, with all that is known of it."""

    outcome: Outcome

    @property
    def mesh(self) -> Path:
        """The textured PLY, in millimetres where the scale is known; beside it .glb, .json and .preview.png."""
        return self.outcome.mesh

    @property
    def cameras(self) -> Path:
        """The folder of the registered photos: images/, masks/ and sparse/, COLMAP's model."""
        return self.outcome.cameras

    @property
    def facts(self) -> dict[str, Any]:
        """What the JSON beside the mesh says."""
        return self.outcome.facts

    @property
    def grade(self) -> str:
        """`good`, `sparse` or `none`: whether the mesh can be used for pose estimation and grasping."""
        return str(self.facts["grade"]["grade"])

    @property
    def extents_mm(self) -> tuple[float, float, float] | None:
        """Width, depth and height in millimetres; None where the scale is unknown."""
        return tuple(self.facts["extents"]) if self.facts["scale"] == "known" else None

    def export(self, kind: str) -> Path:
        """Make what robots and simulators read, and return its path.

        Args:
            kind: urdf, mjcf, usd, usdz, body, foundationpose, nerfstudio or colmap.

        Raises:
            StepError: there is no such kind, or it could not be made: an unknown scale, for example.
        """
        return self.outcome.export(kind)


def reconstruct(
    *sources: str | Path,
    height_m: float | None = None,
    name: str = "",
    masks: str | Path | None = None,
    method: str = METHODS[0],
    into: str | Path = ".",
    **options: Any,
) -> Asset:
    """Make the mesh of an object; progress goes to standard error.

    Args:
        sources: folders of photos, or films, up to three; for each after the first, the object was turned over.
        height_m: of the standing object, in metres; None where it is unknown.
        name: of the results; by default that of the first source.
        masks: folder of masks; by default the object is found.
        method: of the surface, "2dgs" or "svraster".
        into: folder that gets results/.
        options: `cores`, `count`, `network`, `board` and `board_photos` of `zeroshop_steps.app.reconstruct_object.Request`.

    Raises:
        StepError: what is given cannot be used, or no mesh could be made; says why, and what to do.
    """
    request = Request(tuple(map(Path, sources)), height_m, name, Path(masks) if masks else None, method=method, into=Path(into), **options)
    outcome = make_mesh(request)
    if not outcome.done:
        raise StepError("; ".join(find_reason(outcome.log)))
    return Asset(outcome)


def load(name: str, method: str = METHODS[0], into: str | Path = ".") -> Asset:
    """A mesh that was made before.

    Raises:
        StepError: there is none of this name; lists those that are there.
    """
    return Asset(find_outcome(name, method, Path(into)))


def check(source: str | Path) -> tuple[list[str], list[str]]:
    """Judge photos or a film in a minute: problems, with which no mesh can be made, and warnings.

    Raises:
        StepError: it cannot be read.
    """
    problems, warnings = check_capture(Path(source))
    return list(problems), list(warnings)
