"""Download a package's source archive as pip finds it, with pip's own settings; a process of its own, as pip has no such interface.

`pip download` would run the package's code to ask it what it needs. Here nothing is unpacked or run.
"""

import sys
from pathlib import Path


def download_sources(folder: Path, requirement: str) -> Path:
    """The archive of NAME==VERSION in `folder`; SystemExit says why there is none."""
    from pip._internal.commands.download import DownloadCommand
    from pip._internal.network.download import Downloader
    from pip._vendor.packaging.requirements import Requirement

    wanted = Requirement(requirement)
    command = DownloadCommand("download", "")
    with command.main_context():
        options, _ = command.parse_args(["--disable-pip-version-check", "--no-binary", ":all:", requirement])
        session = command.get_default_session(options)
        finder = command._build_package_finder(options, session)
        found = finder.find_best_candidate(wanted.name, wanted.specifier).best_candidate
        if found is None:
            raise SystemExit(f"no source archive matches {requirement}")
        path, _ = Downloader(session, "off")(found.link, str(folder))
    return Path(path)


if __name__ == "__main__":
    download_sources(Path(sys.argv[1]), sys.argv[2])
