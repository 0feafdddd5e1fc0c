"""The models that a robot knows: read once, named, and read again when the workflow has made a better mesh.

The folder is one of models in BOP's layout (with models_info.json), or a dataset's folder of the workflow's results, such as
results/demo, whose objects have OBJECT/2dgs.ply and OBJECT/2dgs.json.
"""

import hashlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.models import (
    ObjectModel,
    check_diameter_mm,
    list_model_files,
    list_objects,
    model_path,
    read_models,
    read_models_info,
)
from zeroshop_steps.detect.templates import Templates, read_templates, save_templates
from zeroshop_steps.geometry.meshes.mesh_files import list_mesh_files, read_mesh
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory, read_json

VIEWS, SIDE_PX = 42, 224  # of the templates, as the workflow makes them


@dataclass(frozen=True)
class ObjectFiles:
    """The files of one object.

    Attributes:
        mesh: PLY in mm.
        record: the JSON beside a mesh of the workflow; None of a model in BOP's layout.
    """

    mesh: Path
    record: Path | None

    def signature(self) -> tuple[tuple[str, int, int], ...]:
        """Changes when one of the files is written again."""
        paths = [*list_mesh_files(self.mesh), self.record or self.mesh.with_name("models_info.json")]
        found = [(path, path.stat()) for path in paths if path.is_file()]
        return tuple((str(path), status.st_mtime_ns, status.st_size) for path, status in found)


@dataclass(frozen=True)
class StoredObject:
    """One model.

    Attributes:
        name: how goals and answers call it.
        model: its mesh in mm.
        version: a digest of its files' bytes.
        description: its scale, and where that is from.
    """

    name: str
    model: ObjectModel
    version: str
    description: str


class UnknownScale(StepError):
    """A mesh is of unknown scale: poses and grasps would be wrong by the same factor."""


class ObjectStore:
    """The models of a folder by name. A model of unknown scale is not taken: its poses would be wrong by any factor."""

    def __init__(self, folder: Path, nvs: str = "2dgs", objects: Sequence[str] = (), templates: Path | None = None) -> None:
        """Read the models.

        Args:
            folder: of the models.
            nvs: the surface method whose meshes are taken from the workflow's results.
            objects: their names, all if empty.
            templates: folder that keeps rendered views between starts; None: they are rendered at each.

        Raises:
            StepError: there is no model, or none of a name.
        """
        self.folder, self.nvs, self.wanted = Path(folder), nvs, tuple(objects)
        self._own_templates = tempfile.TemporaryDirectory(prefix="views.")
        self.templates = templates or Path(self._own_templates.name)
        self.objects: dict[str, StoredObject] = {}
        self.refused: dict[str, str] = {}
        self.generation = 0
        self._signatures: dict[str, tuple] = {}
        self._numbers: dict[str, int] = {}
        self.refresh()
        missing = [name for name in self.wanted if name not in self.objects and name not in self.refused]
        if missing or not self.objects:
            reasons = "; ".join(self.refused.values())
            raise StepError(f"{folder} has no usable model{' of ' + ', '.join(missing) if missing else ''}. {reasons or self._told()}")

    def refresh(self) -> None:
        """Read what is new or was written again since the last call; `generation` grows if anything changed.

        Files that vanish change nothing: Snakemake removes a mesh before it makes the next one.
        """
        sources = self._find_sources()
        changed = False
        for name, source in sources.items():
            signature = source.signature()
            if self._signatures.get(name) != signature:
                self._signatures[name] = signature
                changed |= self._read(name, source)
        self.generation += changed

    def find(self, name: str) -> StoredObject:
        """The object of a name. Raises StepError with the reason where there is none."""
        if name in self.objects:
            return self.objects[name]
        if name in self.refused:
            raise StepError(self.refused[name])
        raise StepError(f"there is no object {name!r} here. {self._told()}")

    def name_of(self, object_id: int) -> str:
        """The name of an object's number."""
        return next(name for name, stored in self.objects.items() if stored.model.object_id == object_id)

    @property
    def models(self) -> dict[int, ObjectModel]:
        """By number."""
        return {stored.model.object_id: stored.model for stored in sorted(self.objects.values(), key=lambda one: one.model.object_id)}

    def views_of(self, object_id: int) -> Templates:
        """The rendered views of a model, made once for each version of it. They are read from the disk: each has 15 MB."""
        stored = self.objects[self.name_of(object_id)]
        folder = self.templates / f"{stored.name}-{stored.version}"
        if not folder.is_dir():
            with atomic_directory(folder) as part:
                save_templates(part, stored.model, VIEWS, SIDE_PX)
        return read_templates(folder, object_id)

    def _told(self) -> str:
        known = ", ".join(sorted(self.objects)) or f"none; expected models_info.json or OBJECT/{self.nvs}.ply in {self.folder}"
        return f"Known objects: {known}"

    def _find_sources(self) -> dict[str, ObjectFiles]:
        if (self.folder / "models_info.json").is_file() or list_model_files(self.folder):
            listed = read_models_info(self.folder)
            numbers = {listed[str(number)].get("name", f"obj_{number:06d}"): number for number in list_objects(self.folder)}
            self._numbers |= numbers
            sources = {name: ObjectFiles(model_path(self.folder, number), None) for name, number in numbers.items()}
        else:
            meshes = {path.parent.name: path for path in sorted(self.folder.glob(f"*/{self.nvs}.ply"))}
            for name in meshes:
                self._numbers.setdefault(name, max(self._numbers.values(), default=0) + 1)
            sources = {name: ObjectFiles(path, path.with_suffix(".json")) for name, path in meshes.items()}
        return {name: source for name, source in sources.items() if not self.wanted or name in self.wanted}

    def _read(self, name: str, source: ObjectFiles) -> bool:
        """Read one object; True if it changed. One that cannot be read keeps its former version, with a warning."""
        try:
            stored = read_object(name, self._numbers[name], source)
        except UnknownScale as error:
            self.refused[name] = str(error)
            return self.objects.pop(name, None) is not None
        except StepError as error:
            warn(f"{name}: {error}")
            if name not in self.objects:
                self.refused[name] = str(error)
            return False
        before = self.objects.get(name)
        self.objects[name] = stored
        self.refused.pop(name, None)
        return before is None or before.version != stored.version


def read_object(name: str, number: int, source: ObjectFiles) -> StoredObject:
    """Read one object.

    Raises:
        StepError: a file is missing or damaged, or the mesh is not in millimetres.
        UnknownScale: its scale is unknown.
    """
    if source.record is None:
        model, description = read_models(source.mesh.parent, [number])[number], "model in BOP's layout, in millimetres"
    else:
        record = read_json(source.record)
        if record["scale"] != "known":
            raise UnknownScale(
                f"the scale of {source.mesh} is unknown, and poses would be wrong by the same factor: give its height (config/README.md,"
                " heights), make the mesh again, and it is taken at the next goal"
            )
        mesh = read_mesh(source.mesh)
        diameter_mm = check_diameter_mm(source.mesh, mesh, None)
        model = ObjectModel(number, mesh, diameter_mm, np.eye(4)[None], {"name": name})
        description = f"mesh of ZeroShOP in millimetres, scale from {record['scale_source']}"
    digest = hashlib.sha256()
    for path in list_mesh_files(source.mesh):
        digest.update(path.read_bytes())
    return StoredObject(name, model, digest.hexdigest()[:16], description)
