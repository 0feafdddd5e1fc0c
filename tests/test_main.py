"""The command `zeroshop`, and the version that the project's papers name."""

import re
from pathlib import Path

import pytest
import yaml

from zeroshop_steps import __version__
from zeroshop_steps.__main__ import main

REPOSITORY = Path(__file__).resolve().parent.parent


def test_it_says_its_version(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"zeroshop {__version__}\n"


def test_alone_it_prints_how_to_make_a_mesh(capsys):
    assert main([]) == 0
    assert "snakemake results/photos/NAME/2dgs.ply" in capsys.readouterr().out


def test_an_unknown_option_is_refused(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--no-such-option"])
    assert end.value.code == 2
    assert "unrecognized arguments" in capsys.readouterr().err


def test_the_changelog_and_the_citation_name_this_version():
    assert yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())["version"] == __version__
    newest = re.search(r"^## (\S+)", (REPOSITORY / "CHANGELOG.md").read_text(), flags=re.M)
    assert newest and newest.group(1) == __version__
