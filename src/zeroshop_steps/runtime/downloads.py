"""Fetching one public file: retried, continued, written whole or not at all, and always the same bytes as the first time.

Pooch 1.9.0, tried instead, would replace the loop of `_download_once` alone, and does less for the user (800 MB from a local server):

| | here | pooch.retrieve |
|---|---|---|
| seconds, of CPU | 1.0, 0.3 | 9.5, 3.5; with chunks of 1 MiB 2.4, 0.9 |
| mode of the file | as the user's umask says | 0600: nobody else can read a shared resources/ |
| certificates | the system's | its own list: a company's proxy is refused |
| a file put there by hand with another checksum | refused, kept | downloaded again and overwritten |
| a failed attempt | why it failed; 404 and the like end at once | no reason; 404 is tried again, too |
| file: URLs, a lock between processes, room on the disk | yes | no |
"""

import contextlib
import hashlib
import http.client
import shutil
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError, remedy_for
from zeroshop_steps.runtime.files import atomic_write, locked
from zeroshop_steps.runtime.progress import ProgressReport

TIMEOUT_S = 30.0
"""Without a byte; hosts of weights answer within a few seconds."""


def download(
    url: str,
    path: Path,
    without: str,
    attempts: int = 3,
    pause_s: float = 3.0,
    sha256: str | None = None,
    size_bytes: int | None = None,
) -> Path:
    """Return `path`, downloaded from `url` first where it is missing, and verified against `path`.sha256.

    The sha256 is recorded beside the file at its first use, whether it was downloaded or put there by hand, and kept when the
    file is deleted: a later download must give the same bytes. Parallel calls wait for each other.

    Args:
        url: http, https or file URL.
        path: where the file belongs.
        without: what a user without access to `url` can do instead, for the error message.
        attempts: how often to try.
        pause_s: pause after the first failed attempt; doubles each time.
        sha256: what the file must have, where that is known.
        size_bytes: how much disk space it needs, for servers that do not say.

    Raises:
        StepError: the download failed, the disk has no room, or the bytes are not those expected or recorded.
    """
    path = Path(path)
    with locked(path.with_name(path.name + ".lock")):
        if not path.is_file():
            for attempt in range(1, attempts + 1):
                try:
                    _download_once(url, path, size_bytes)
                    break
                except (OSError, http.client.HTTPException) as error:
                    # HTTP answers that stay the same when asked again.
                    final = isinstance(error, urllib.error.HTTPError) and error.code in (400, 401, 403, 404, 410, 451)
                    if attempt < attempts and not final:
                        print(f"{url}: {error}; attempt {attempt} of {attempts}, trying again", file=sys.stderr)
                        time.sleep(pause_s * 2 ** (attempt - 1))
                        continue
                    raise StepError(
                        f"cannot download {url} ({error}). Check the network, or fetch that file elsewhere and put it at {path};"
                        f" or {without}"
                    ) from error
        verify(path, sha256)
    return path


def verify(path: Path, sha256: str | None = None) -> None:
    """Check a file against `sha256`, if given, and that recorded in `path`.sha256, or record it when there is none."""
    with open(path, "rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if sha256 and found != sha256:
        raise StepError(f"{path} has sha256 {found}, expected {sha256}: it is damaged or another file. Delete it to fetch it again.")
    record = path.with_name(path.name + ".sha256")
    if not record.exists():
        with atomic_write(record) as temporary:
            temporary.write_text(f"{found}  {path.name}\n")
        return
    expected = (record.read_text().split() or ["nothing"])[0]
    if found != expected:
        raise StepError(
            f"{path} has sha256 {found}, expected {expected} as recorded at first use in {record}: it is damaged or was replaced."
            f" Delete {path} to fetch it again; delete {record} too if the new file is wanted."
        )


def _download_once(url: str, path: Path, size_bytes: int | None = None) -> None:
    """Fetch a file, or what is lacking of it: an attempt that broke off leaves `path`.part, and beside it by which the server knows it."""
    part, mark = path.with_name(path.name + ".part"), path.with_name(path.name + ".part.mark")
    have = part.stat().st_size if part.is_file() and mark.is_file() else 0
    headers = {"User-Agent": "zeroshop"} | ({"Range": f"bytes={have}-", "If-Range": mark.read_text()} if have else {})
    with _open(urllib.request.Request(url, headers=headers), part) as response:
        continued = response.status == http.client.PARTIAL_CONTENT
        have = have if continued else 0
        announced = int(response.headers.get("Content-Length") or 0)
        needed = announced or size_bytes or 0
        if shutil.disk_usage(path.parent).free < needed:
            raise StepError(f"{path} needs {needed / 1e6:.0f} MB, more than {path.parent} has free; make room")
        # A weak mark, or none, does not tell whether the rest belongs to what is there: then a broken download starts again.
        known = response.headers.get("ETag") or ""
        if known and not known.startswith("W/"):
            mark.write_text(known)
        else:
            mark.unlink(missing_ok=True)
        received, whole = 0, have + announced
        with ProgressReport(f"download {path.name} (MB)", max(whole >> 20, 1)) as report, _writing(part, continued) as write:
            while chunk := _read(response):
                write(chunk)
                received += len(chunk)
                report.advance(((have + received) >> 20) - report.done)
        if announced and received != announced:
            raise http.client.IncompleteRead(b"", announced - received)
    part.rename(path)
    mark.unlink(missing_ok=True)


def _open(request: urllib.request.Request, part: Path) -> http.client.HTTPResponse:
    try:
        response: http.client.HTTPResponse = urllib.request.urlopen(request, timeout=TIMEOUT_S)
    except urllib.error.HTTPError as error:
        if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
            part.unlink(missing_ok=True)  # nothing comes after it: the next attempt starts again
        raise
    return response


@contextlib.contextmanager
def _writing(part: Path, continued: bool) -> Iterator[Callable[[bytes], object]]:
    """What writes to a file, at its end or from its start. A fault of the disk is told at once; another attempt would have it, too."""
    try:
        file = open(part, "ab" if continued else "wb")  # noqa: SIM115
    except OSError as error:
        raise StepError(f"{part}: {error.strerror}. {remedy_for(error)}") from error

    def write(chunk: bytes) -> None:
        try:
            file.write(chunk)
        except OSError as error:
            raise StepError(f"{part}: {error.strerror}. {remedy_for(error)}") from error

    with file:
        yield write


def _read(response: http.client.HTTPResponse) -> bytes:
    """The next bytes. A broken connection becomes an HTTPException."""
    try:
        return response.read(1 << 20)
    except OSError as error:
        raise http.client.HTTPException(str(error)) from error
