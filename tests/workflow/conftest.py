"""Fixtures of the workflow's tests."""

from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from helpers.running import run_snakemake


@pytest.fixture
def snakemake(tmp_path: Path) -> Callable[..., CompletedProcess[str]]:
    """Snakemake in an empty folder."""
    return lambda *arguments: run_snakemake(tmp_path, *arguments)
