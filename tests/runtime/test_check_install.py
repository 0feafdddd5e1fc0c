"""The set-up names every missing system library in one command, and installs only as root."""

import pytest

from zeroshop_steps.runtime import check_install
from zeroshop_steps.runtime.errors import StepError


def test_missing_libraries_are_named_by_their_packages():
    packages = {"libc.so.6": "libc6", "libnot-there.so.9": "libnot9", "libnor-this.so.1": "libnor1"}
    assert check_install.missing_packages(packages) == ["libnot9", "libnor1"]


def test_a_user_is_told_the_command(monkeypatch):
    monkeypatch.setattr(check_install.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(check_install.subprocess, "run", lambda *_, **__: pytest.fail("only root installs"))
    with pytest.raises(StepError, match="sudo apt-get install --yes --no-install-recommends libgl1 libegl1$"):
        check_install.install_missing(["libgl1", "libegl1"])


def test_root_installs_and_a_failure_tells_the_command(monkeypatch):
    calls = []

    class Finished:
        returncode = 0

    def run(command, **_):
        calls.append(command[:2])
        return Finished

    monkeypatch.setattr(check_install.os, "geteuid", lambda: 0)
    monkeypatch.setattr(check_install.shutil, "which", lambda _: "apt-get")
    monkeypatch.setattr(check_install.subprocess, "run", run)
    check_install.install_missing(["libgl1"])
    assert calls == [["apt-get", "update"], ["apt-get", "install"]]
    Finished.returncode = 100
    with pytest.raises(StepError, match="apt-get install"):
        check_install.install_missing(["libgl1"])


def test_a_module_that_does_not_load_is_named(monkeypatch):
    monkeypatch.setattr(check_install, "MODULES", ("json", "no_such_module"))
    with pytest.raises(StepError, match="no_such_module is installed but does not load"):
        check_install.check_imports()
