"""For mkdocs: the documents lie all over the repository, and keep their places in the site, so that links hold in both."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

LINKED = ("LICENSE", "CITATION.cff", "config/thesis.yaml", "src/zeroshop_steps/networks/weights.csv", "benchmarks/captures/captures.csv")
"""What documents link to beside pages and pictures."""
FOLDERS = ("", "docs/**/", "config/", "tests/parity/", "benchmarks/captures/masks/")
"""Of pages."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The theme's files, and those of the repository that are shown."""
    root = Path(config.config_file_path).parent
    found = {path for folder in FOLDERS for path in root.glob(f"{folder}*.md")} | {root / name for name in LINKED}
    found |= {path for pattern in ("jpg", "png", "csv") for path in root.glob(f"docs/*.{pattern}")}
    names = sorted(str(path.relative_to(root)) for path in found)
    own = [File(name, str(root), config.site_dir, config.use_directory_urls) for name in names]
    return Files([file for file in files if file.src_dir != config.docs_dir] + own)
