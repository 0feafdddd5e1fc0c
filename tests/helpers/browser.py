"""A headless Chromium over its DevTools protocol (JSON messages through two pipes), for looking at pages as a person would."""

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FREE_DESCRIPTOR = 10  # the least that both pipes move to
LOCAL = ("file:", "data:", "blob:", "about:")
# Only WebGL without a GPU is switched on; --no-sandbox is for machines where tests run as root, on pages of their own.
OPTIONS = (
    *("--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--no-first-run", "--hide-scrollbars", "--mute-audio"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking", "--disable-component-update"),
)


def chromium() -> str | None:
    """The browser's program; None where the machine has none."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)


class Browser:
    """One tab. `requests` are the addresses that it asked for, `problems` the console's errors and warnings and uncaught exceptions."""

    def __init__(self, into: int, out: int) -> None:
        self.into, self.out, self.number, self.buffer = into, out, 0, b""
        self.requests: list[str] = []
        self.problems: list[str] = []
        self.session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters) -> dict:
        """Send a command and wait for its answer."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        message |= {"sessionId": self.session} if self.session else {}
        os.write(self.into, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + 60
        while True:
            answer = self._read(max(0.0, end - time.monotonic()))
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def open(self, path: Path, width_px: int = 1280, height_px: int = 900, dark: bool = False) -> None:
        """Open a page from disk and wait until it has loaded."""
        phone = width_px < 600
        self.call("Emulation.setDeviceMetricsOverride", width=width_px, height=height_px, deviceScaleFactor=2 if phone else 1, mobile=phone)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.wait_for("document.readyState === 'complete'")

    def value(self, script: str):
        """The value of a JavaScript expression; promises are waited for."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait_for(self, script: str, seconds: float = 60) -> None:
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + seconds
        while not self._holds(script):
            if time.monotonic() > end:
                raise TimeoutError(f"{script} did not become true; problems: {self.problems}")
            time.sleep(0.05)

    def _holds(self, script: str) -> bool:
        """Whether an expression is true; a page that is just being left answers nothing, so it is not."""
        try:
            return bool(self.value(f"Boolean({script})"))
        except RuntimeError as error:
            if "navigated or closed" in str(error):
                return False
            raise

    def picture(self, path: Path, whole: bool = False) -> None:
        """Save what is seen, or the whole page, as PNG."""
        data = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))

    def requests_that_left(self) -> list[str]:
        """Addresses of requests to anything but files and data."""
        return [url for url in self.requests if not url.startswith(LOCAL)]

    def _read(self, seconds: float) -> dict:
        end = time.monotonic() + seconds
        while b"\0" not in self.buffer:
            ready, _, _ = select.select([self.out], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise TimeoutError("the browser does not answer")
            read = os.read(self.out, 1 << 20)
            if not read:
                raise ConnectionError("the browser has ended")
            self.buffer += read
        text, _, self.buffer = self.buffer.partition(b"\0")
        message = json.loads(text)
        self._note(message.get("method"), message.get("params", {}))
        return message

    def _note(self, method: str | None, content: dict) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(content["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.problems.append(str(content["exceptionDetails"].get("exception", {}).get("description", content["exceptionDetails"])))
        elif method == "Runtime.consoleAPICalled" and content["type"] in ("error", "warning", "assert"):
            self.problems.append(" ".join(str(part.get("value", part.get("description", ""))) for part in content["args"]))
        elif method == "Log.entryAdded" and content["entry"]["level"] in ("error", "warning"):
            self.problems.append(f"{content['entry']['text']} {content['entry'].get('url', '')}")


@contextlib.contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """A browser that keeps what it must in the folder `profile`, closed at the end."""
    to_read, into = os.pipe()
    out, to_write = os.pipe()

    def as_three_and_four() -> None:
        # The protocol's pipes are descriptors 3 and 4; these two may be among those that are moved: so both go out of the way first.
        read, write = (fcntl.fcntl(end, fcntl.F_DUPFD, FREE_DESCRIPTOR) for end in (to_read, to_write))
        os.dup2(read, 3, True)
        os.dup2(write, 4, True)

    process = subprocess.Popen(
        [str(chromium()), *OPTIONS, f"--user-data-dir={profile}"],
        preexec_fn=as_three_and_four,
        close_fds=False,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=(profile.parent / f"{profile.name}.log").open("wb"),
    )
    os.close(to_read)
    os.close(to_write)
    try:
        yield Browser(into, out)
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        os.close(into)
        os.close(out)
