"""Where compiled kernels lie on a machine on which a user may write nowhere but to the temporary folder."""

import os
from pathlib import Path

import pytest

from zeroshop_steps.runtime.compute import kernel_cache
from zeroshop_steps.runtime.compute.kernel_cache import VARIABLE, provide_kernel_cache


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nothing of the usual places can be written to."""
    monkeypatch.setattr(kernel_cache, "PACKAGE", Path("/proc"))
    monkeypatch.setattr(kernel_cache.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/cache")
    monkeypatch.setenv(VARIABLE, "/proc/kernels")
    monkeypatch.setattr(os, "access", lambda folder, _: not str(folder).startswith("/proc"))
    return tmp_path


def test_a_folder_of_the_users_own(nowhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    provide_kernel_cache()
    folder = Path(os.environ[VARIABLE])
    assert folder.parent == nowhere and folder.stat().st_mode & 0o777 == 0o700
    assert f"compiled kernels are kept in {folder}" in capsys.readouterr().err


def test_a_folder_that_others_can_write_to_is_not_used(nowhere: Path) -> None:
    usual = nowhere / f"zeroshop-kernels-{os.geteuid()}"
    usual.mkdir()
    usual.chmod(0o777)
    provide_kernel_cache()
    assert os.environ[VARIABLE] != str(usual) and Path(os.environ[VARIABLE]).parent == nowhere


def test_the_usual_places_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "kernels"))
    provide_kernel_cache()
    assert os.environ[VARIABLE] == str(tmp_path / "kernels")
