"""The documents: no line too long, no link that leads nowhere, no target that Snakemake does not know."""

import re
from pathlib import Path

import pytest

from helpers.paths import REPOSITORY
from helpers.running import run_snakemake

MAX_CHARACTERS = 120
README_LINES = 100
LINK = re.compile(r"\]\(([^)\s]+)\)")
COMMAND = re.compile(r"(?:^    |`)snakemake ([^#`\n]*)", re.MULTILINE)
TARGET = re.compile(r"results/[a-z0-9_./-]+")
"""Without capital letters: those stand for a name of the reader's own."""
SKIPPED_FOLDERS = {".venv", ".snakemake", ".git", "node_modules", "resources", "results", ".pytest_cache", ".hypothesis"}


def documents() -> list[Path]:
    """Every Markdown file of the project."""
    found = REPOSITORY.rglob("*.md")
    return sorted(path for path in found if not SKIPPED_FOLDERS & set(path.relative_to(REPOSITORY).parts))


def anchors_of(document: Path) -> set[str]:
    """The anchors that GitHub gives to the headings of a document."""
    headings = re.findall(r"^#+ (.*)$", document.read_text(), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", documents(), ids=lambda path: str(path.relative_to(REPOSITORY)))
def test_a_document_is_well_formed(document):
    text = document.read_text()
    long = [number for number, line in enumerate(text.splitlines(), start=1) if len(line) > MAX_CHARACTERS]
    assert not long, f"lines of more than {MAX_CHARACTERS} characters: {long}"
    for link in LINK.findall(text):
        if link.startswith("http"):
            continue
        name, _, anchor = link.partition("#")
        target = document.parent / name if name else document
        assert target.exists(), f"{link} leads nowhere"
        assert not anchor or anchor in anchors_of(target), f"{link}: no such heading"


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
