"""A cached result is found by what it depends on, is checked before it is used, and is made again where it is damaged."""

import argparse
import errno
from pathlib import Path
from types import SimpleNamespace

import pytest

import zeroshop_steps
from zeroshop_steps.networks.saliency.salient_networks import network_path
from zeroshop_steps.register import mast3r, vggt
from zeroshop_steps.runtime import cache
from zeroshop_steps.runtime.cache import Cached, cache_folder, check_cache, content_digest, entry_name, run_cached
from zeroshop_steps.runtime.code_version import KEPT, _read_digests, code_version, reached
from zeroshop_steps.runtime.errors import StepError

STEP = "report.table"  # any step that exists: its code counts


class Step(SimpleNamespace):
    """A method that joins the words of its input and counts how often it runs."""

    def __init__(self, cached: Cached) -> None:
        super().__init__(CACHED=cached, runs=0)

    def run(self, args: argparse.Namespace) -> None:
        self.runs += 1
        args.out.mkdir(exist_ok=True)
        (args.out / "empty").mkdir(exist_ok=True)
        (args.out / "words.txt").write_text(" ".join(file.read_text() for file in sorted(args.images.iterdir())) * args.repeat)


def arguments(folder: Path, **changes: object) -> argparse.Namespace:
    images = folder / "images"
    if not images.exists():
        images.mkdir(parents=True)
        (images / "a.txt").write_text("one")
        (images / "b.txt").write_text("two")
    return argparse.Namespace(**{"images": images, "repeat": 2, "threads": 2, "out": folder / "out", **changes})


@pytest.fixture
def shared(tmp_path, monkeypatch) -> Path:
    """An empty shared cache."""
    folder = tmp_path / "shared"
    folder.mkdir()
    monkeypatch.setenv(cache.LOCATION, str(folder))
    return folder


@pytest.mark.parametrize("cached", [Cached(("images",), ("threads",)), Cached(("images",), ("threads",), ("words.txt",))])
def test_a_second_checkout_does_not_run_the_step(tmp_path, shared, cached):
    step = Step(cached)
    run_cached(STEP, step, arguments(tmp_path / "first"))
    run_cached(STEP, step, arguments(tmp_path / "elsewhere/second", threads=7))
    assert step.runs == 1
    assert (tmp_path / "elsewhere/second/out/words.txt").read_text() == "one twoone two"
    assert not (tmp_path / "elsewhere/second/out/words.txt").is_symlink()
    assert (tmp_path / "elsewhere/second/out/empty").is_dir() == (not cached.outputs)
    assert [path.name for path in (tmp_path / "elsewhere/second").iterdir() if path.name.startswith(".")] == []
    assert len(list(shared.iterdir())) == 1


def test_whatever_the_result_depends_on_makes_another_entry(tmp_path, shared, monkeypatch):
    step, first = Step(Cached(("images",), ("threads",))), arguments(tmp_path / "first")
    names = {entry_name(STEP, step.CACHED, first), entry_name(STEP, step.CACHED, arguments(tmp_path / "first", repeat=3))}
    names.add(entry_name("report.other", step.CACHED, first))
    (first.images / "b.txt").write_text("too")
    names.add(entry_name(STEP, step.CACHED, first))
    (first.images / "b.txt").rename(first.images / "c.txt")
    names.add(entry_name(STEP, step.CACHED, first))
    monkeypatch.setattr(cache, "code_version", lambda step: "another version")
    names.add(entry_name(STEP, step.CACHED, first))
    assert len(names) == 6


@pytest.mark.parametrize("damage", ["changed", "cut", "missing", "manifest", "no manifest", "not JSON"])
def test_a_damaged_entry_is_made_again_and_never_used(tmp_path, shared, capsys, damage):
    step = Step(Cached(("images",)))
    run_cached(STEP, step, arguments(tmp_path / "first"))
    [entry] = shared.iterdir()
    words, manifest = entry / "content/words.txt", entry / cache.MANIFEST
    if damage == "changed":
        words.write_text("one twoone tWo")
    elif damage == "cut":
        words.write_bytes(words.read_bytes()[:-1])
    elif damage == "missing":
        words.unlink()
    elif damage == "manifest":
        manifest.write_text(manifest.read_text().replace("words.txt", "swords.txt"))
    elif damage == "no manifest":
        manifest.unlink()
    else:
        manifest.write_text("[")
    run_cached(STEP, step, arguments(tmp_path / "second"))
    assert step.runs == 2
    assert f"cache entry {entry} was damaged" in capsys.readouterr().err
    assert (tmp_path / "second/out/words.txt").read_text() == "one twoone two"
    run_cached(STEP, step, arguments(tmp_path / "third"))
    assert step.runs == 2, "the entry was made again"
    assert list(shared.iterdir()) == [entry]


def test_what_this_machine_cannot_do_costs_no_entry(tmp_path, shared, capsys, monkeypatch):
    step = Step(Cached(("images",)))
    run_cached(STEP, step, arguments(tmp_path / "first"))
    [entry] = shared.iterdir()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(cache.shutil, "copyfile", full)
        run_cached(STEP, step, arguments(tmp_path / "second"))
    assert step.runs == 2 and (tmp_path / "second/out/words.txt").exists()
    assert "cannot be copied" in capsys.readouterr().err
    run_cached(STEP, step, arguments(tmp_path / "third"))
    assert step.runs == 2 and list(shared.iterdir()) == [entry], "it is whole, and used again"


def test_a_damaged_entry_of_someone_else_is_said_to_stay(tmp_path, shared, capsys, monkeypatch):
    step = Step(Cached(("images",)))
    run_cached(STEP, step, arguments(tmp_path / "first"))
    [entry] = shared.iterdir()
    (entry / "content/words.txt").write_text("other")

    def refused(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(cache.os, "rename", refused)
        run_cached(STEP, step, arguments(tmp_path / "second"))
    assert step.runs == 2 and (tmp_path / "second/out/words.txt").read_text() == "one twoone two"
    assert "yours not to remove" in capsys.readouterr().err
    assert list(shared.iterdir()) == [entry]


def test_a_step_that_fails_leaves_no_entry(tmp_path, shared):
    step = Step(Cached(("images",)))
    with pytest.raises(TypeError):
        run_cached(STEP, step, arguments(tmp_path / "first", repeat="x"))
    assert list(shared.iterdir()) == []


def test_without_a_cache_or_without_being_cacheable_a_step_just_runs(tmp_path, monkeypatch):
    monkeypatch.delenv(cache.LOCATION, raising=False)
    step = Step(Cached(("images",)))
    run_cached(STEP, step, arguments(tmp_path))
    monkeypatch.setenv(cache.LOCATION, "no/such/folder")
    run_cached(STEP, SimpleNamespace(run=step.run), arguments(tmp_path))
    assert step.runs == 2


@pytest.mark.parametrize("place", ["absent", "file", "/proc"])
def test_an_unusable_folder_is_named_with_the_remedy(tmp_path, monkeypatch, place):
    (tmp_path / "file").touch()
    monkeypatch.setenv(cache.LOCATION, str(tmp_path / place))
    with pytest.raises(StepError, match=f"{place} is (no folder on this machine|not writable).*or unset it"):
        cache_folder()


@pytest.mark.parametrize(("now", "former", "warned"), [(True, True, False), (False, True, True), (False, False, False)])
def test_the_former_name_of_the_variable_is_said(tmp_path, monkeypatch, capsys, now, former, warned):
    for name, is_set in ((cache.LOCATION, now), (cache.FORMER_LOCATION, former)):
        monkeypatch.setenv(name, str(tmp_path) if is_set else "")
    check_cache()
    assert ("now named by ZEROSHOP_CACHE" in capsys.readouterr().err) is warned


def test_a_file_counts_with_its_companions(tmp_path):
    for name, content in {"model.ply": "mesh", "model.png": "picture", "model_info.json": "{}", "other.txt": "x", ".hidden": "y"}.items():
        (tmp_path / name).write_text(content)
    before = content_digest(tmp_path / "model.ply")
    (tmp_path / "other.txt").write_text("changed")
    assert content_digest(tmp_path / "model.ply") == before
    (tmp_path / "model.png").write_text("changed")
    assert content_digest(tmp_path / "model.ply") != before


def sources(folder: Path) -> Path:
    """A small package of steps."""
    for name, text in {
        "__init__.py": "",
        "nvs/__init__.py": "",
        "nvs/train.py": "import numpy\ndef run(args):\n    from zeroshop_steps.nvs import kernels\n",
        "nvs/kernels.py": "from zeroshop_steps.geometry.cameras.pinhole import Camera\n",
        "nvs/unused.py": "",
        "geometry/cameras/pinhole.py": "class Camera: pass\n",
        "table.csv": "1\n",
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("file", "counts"), [("nvs/kernels.py", True), ("geometry/cameras/pinhole.py", True), ("table.csv", True), ("nvs/unused.py", False)]
)
def test_the_code_that_a_step_can_run_counts_and_no_other(tmp_path, file, counts):
    folder = sources(tmp_path)
    before = code_version("nvs.train", folder)
    (folder / file).write_text((folder / file).read_text() + "changed = 1\n")
    assert (code_version("nvs.train", folder) != before) is counts


def test_comments_and_docstrings_do_not_count(tmp_path):
    folder = sources(tmp_path)
    path = folder / "geometry/cameras/pinhole.py"
    path.write_text("def project(point):\n    return point[:2]\n")
    before = code_version("nvs.train", folder)
    path.write_text('"""Cameras."""\n\n\ndef project(point):  # to pixels\n    """Project it."""\n    return point[:2]\n')
    assert code_version("nvs.train", folder) == before
    path.write_text('"""Cameras."""\n\n\ndef project(point):\n    return point[:3]\n')
    assert code_version("nvs.train", folder) != before


def test_what_is_known_of_a_file_is_kept_and_a_damaged_record_is_made_again(tmp_path):
    folder = sources(tmp_path)
    before = code_version("nvs.train", folder)
    for content in ((folder / KEPT).read_text(), "{", '{"nvs/train.py": 1}'):
        (folder / KEPT).write_text(content)
        _read_digests.cache_clear()
        assert code_version("nvs.train", folder) == before


def test_the_libraries_count(tmp_path, monkeypatch):
    folder = sources(tmp_path)
    before = code_version("nvs.train", folder)
    monkeypatch.setattr("zeroshop_steps.runtime.code_version.version", lambda name: "0.0")
    assert code_version("nvs.train", folder) != before


def test_the_real_steps_know_their_inputs():
    """Every argument that CACHED names exists, and every one that is a path is an input or the output."""
    import importlib

    sources = Path(zeroshop_steps.__file__).parent
    cached = [path for path in sources.rglob("*.py") if "\nCACHED = " in path.read_text()]
    assert len(cached) >= 12
    for path in cached:
        step = ".".join(path.with_suffix("").relative_to(sources).parts).removesuffix(".__init__")
        module = importlib.import_module(f"zeroshop_steps.{step}")
        parser = argparse.ArgumentParser()
        module.add_arguments(parser)
        inputs = {name.partition("/")[0] for name in module.CACHED.inputs}
        actions = {action.dest: action for action in parser._actions if action.dest != "help"}
        assert inputs | set(module.CACHED.ignored) <= set(actions), step
        paths = {name for name, action in actions.items() if action.type in (Path, network_path)}
        assert paths - set(module.CACHED.ignored) == inputs | {"out"}, step
        assert len(code_version(step)) == 64
        files, libraries = reached(f"zeroshop_steps.{step}")
        assert path in files and "numpy" in libraries, step


@pytest.mark.parametrize("module", [mast3r, vggt])
def test_weights_of_ones_own_count_by_their_content(module, tmp_path):
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    (tmp_path / "images").mkdir()
    weights = tmp_path / "own.pth"
    words = ["--capture", tmp_path, "--out", tmp_path / "out", "--scene", "su_h", "--weights", weights]
    names = set()
    for content in (b"one", b"other"):
        weights.write_bytes(content)
        names.add(entry_name("register", module.CACHED, parser.parse_args(map(str, words))))
    weights.with_name("own.pth.sha256").touch()
    names.add(entry_name("register", module.CACHED, parser.parse_args(map(str, words))))
    assert len(names) == 2, "other weights are another result, the record of their check is not"
