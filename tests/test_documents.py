"""The documents: short, no link that leads nowhere, no target that Snakemake does not know, no figure but the committed ones."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.paths import REPOSITORY
from helpers.running import run_snakemake
from results_tables import PAGE, TABLES, fill

MAX_CHARACTERS = 120
README_LINES = 100
MAX_WORDS = 35_000
COMMAND = re.compile(r"(?:^    |`)snakemake ([^#`\n]*)", re.MULTILINE)
TARGET = re.compile(r"results/[a-z0-9_./-]+")
"""Without capital letters: those stand for a name of the reader's own."""
SKIPPED_FOLDERS = {".venv", ".snakemake", ".git", "node_modules", "resources", "results", ".pytest_cache", ".hypothesis", "build"}


def documents() -> list[Path]:
    """Every Markdown file of the project."""
    found = REPOSITORY.rglob("*.md")
    return sorted(path for path in found if not SKIPPED_FOLDERS & set(path.relative_to(REPOSITORY).parts))


@pytest.mark.parametrize("document", documents(), ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_no_line_is_too_long(document):
    long = [number for number, line in enumerate(document.read_text().splitlines(), start=1) if len(line) > MAX_CHARACTERS]
    assert not long, f"lines of more than {MAX_CHARACTERS} characters: {long}"


def test_the_site_has_every_document_and_no_broken_link(tmp_path):
    pytest.importorskip("mkdocs", reason="make installs mkdocs from requirements.lock")
    words = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--config-file", REPOSITORY / "mkdocs.yml", "--site-dir", tmp_path]
    run = subprocess.run(words, capture_output=True, text=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"})
    assert run.returncode == 0, run.stderr
    assert len(list(tmp_path.rglob("index.html"))) == len(documents())


def test_all_documents_together_are_short():
    assert sum(len(document.read_text().split()) for document in documents()) <= MAX_WORDS


def test_the_tables_of_results_are_those_of_the_committed_figures():
    text = PAGE.read_text()
    assert text.count("<!-- end -->") == len(TABLES)
    assert fill(text) == text, "run: python benchmarks/results_tables.py"


def test_the_readme_is_short():
    assert len((REPOSITORY / "README.md").read_text().splitlines()) <= README_LINES


@pytest.mark.slow
def test_every_target_can_be_planned(tmp_path):
    words = {word for document in documents() for command in COMMAND.findall(document.read_text()) for word in command.split()}
    # da3 and vggt need weights; mine is a dataset or a method of the reader's own; results/thesis and results/views_4 are of other configs.
    targets = sorted(
        word for word in words if TARGET.fullmatch(word) and not {"da3", "vggt", "mine", "thesis", "views_4"} & set(word.split("/"))
    )
    assert len(targets) > 10
    run = run_snakemake(tmp_path, *targets, "-n", "--quiet", "all")
    assert run.returncode == 0, run.stdout


def test_tests_that_a_page_of_reports_names_exist():
    named = set(re.findall(r"`(test_\w+|\w+/[\w/]+\.py)`", (REPOSITORY / "docs/reports.md").read_text()))
    written = {
        name for path in (REPOSITORY / "tests").rglob("test_*.py") for name in re.findall(r"^def (test_\w+)", path.read_text(), re.M)
    }
    assert len(named) > 40 and {name for name in named if "/" not in name} <= written
    assert all((REPOSITORY / "tests" / name).is_file() for name in named if "/" in name)
