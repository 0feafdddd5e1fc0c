"""Two users who share one cache: what one has made serves the other, whatever the umask; what is damaged spoils nothing of either."""

import os
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from runtime.test_cache import STEP, Step, arguments
from zeroshop_steps.runtime import cache
from zeroshop_steps.runtime.cache import Cached, run_cached

ANN, BOB = 4001, 4002
pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as two users")


def act_as(user: int, umask: int, act: Callable[[], object]) -> None:
    """Do something in a process of another user."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setgroups([])
            os.setgid(user)
            os.setuid(user)
            os.umask(umask)
            act()
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a cache that all may write to, reached by everybody: pytest's own folders are closed to others."""
    with tempfile.TemporaryDirectory(prefix="users.") as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "shared").mkdir()
        (folder / "shared").chmod(0o1777)
        monkeypatch.setenv(cache.LOCATION, str(folder / "shared"))
        yield folder


def run_once(place: Path, user: int, name: str, umask: int, runs: int) -> None:
    """Run a step as a user in a folder of its own; it must run so many times, and its result be right."""
    home = place / name
    home.mkdir()
    os.chown(home, user, user)

    def act() -> None:
        step = Step(Cached(("images",), ("threads",)))
        run_cached(STEP, step, arguments(home))
        assert step.runs == runs, step.runs
        assert (home / "out/words.txt").read_text() == "one twoone two"

    act_as(user, umask, act)


def test_what_one_user_has_made_serves_the_other(place: Path) -> None:
    run_once(place, ANN, "ann", 0o077, runs=1)
    run_once(place, BOB, "bob", 0o022, runs=0)


def test_a_cache_that_is_closed_to_others_stays_closed(place: Path) -> None:
    (place / "shared").chmod(0o1733)
    run_once(place, ANN, "ann", 0o077, runs=1)
    assert all(path.stat().st_mode & 0o077 == 0 for path in (place / "shared").rglob("*"))


def test_a_damaged_entry_of_the_other_is_not_used(place: Path) -> None:
    run_once(place, ANN, "ann", 0o022, runs=1)
    [words] = (place / "shared").rglob("words.txt")
    words.write_text("damaged")
    run_once(place, BOB, "bob", 0o022, runs=1)
    run_once(place, ANN, "ann again", 0o022, runs=1)
    run_once(place, BOB, "bob again", 0o022, runs=0)
