"""A headless Chromium for tests, spoken to over its own pipe: no driver, no package, no port.

The DevTools protocol runs over file descriptors 3 (to the browser) and 4 (from it), messages parted by a zero byte
(``--remote-debugging-pipe``). Whichever Chromium or Chrome is installed is used; MANTIS_BROWSER names another.
"""

from __future__ import annotations

import base64
import fcntl
import itertools
import json
import os
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
APPLICATIONS = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--hide-scrollbars",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-extensions",
    "--disable-sync",
    "--force-color-profile=srgb",
    "--remote-debugging-pipe",
)
#: Puts two descriptors where the browser looks for them, then becomes the browser.
_BECOME = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); os.execv(sys.argv[3], sys.argv[3:])"
)
#: Key -> DevTools' code and virtual key code.
_KEYS = {
    "ArrowRight": ("ArrowRight", 39),
    "ArrowLeft": ("ArrowLeft", 37),
    "ArrowDown": ("ArrowDown", 40),
    "Tab": ("Tab", 9),
    "Home": ("Home", 36),
    "End": ("End", 35),
    " ": ("Space", 32),
    "Enter": ("Enter", 13),
}


def find_browser() -> str | None:
    """Path of a Chromium or Chrome; None where there is none."""
    chosen = os.environ.get("MANTIS_BROWSER")
    candidates = (chosen,) if chosen else (*map(shutil.which, NAMES), *APPLICATIONS)
    return next((path for path in candidates if path and Path(path).is_file()), None)


class Browser:
    """One page of a headless browser; a context manager that ends the browser with itself."""

    def __init__(self, executable: str, profile: Path) -> None:
        to_browser, write = os.pipe()
        read, from_browser = os.pipe()
        # Not 3 or 4 themselves, which the copies would overwrite.
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in (to_browser, from_browser)]
        command = [executable, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(
            [sys.executable, "-c", _BECOME, *map(str, high), *command], pass_fds=high, start_new_session=True, **quiet
        )
        for fd in (to_browser, from_browser, *high):
            os.close(fd)
        self._write, self._read, self._buffer = write, read, b""
        self._numbers, self._session = itertools.count(1), ""
        #: What the page wrote to its console as an error or threw, since the last `open`.
        self.errors: list[str] = []
        target = self._send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._send(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._write)  # the browser ends when its pipe does
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._read)

    def open(self, url: str, width: int = 1280, height: int = 720, *, mobile: bool = False) -> None:
        """Load a page at a window size [CSS px] and wait until it has loaded."""
        self.resize(width, height, mobile=mobile)
        self.errors.clear()
        self._send("Page.navigate", url="about:blank")  # another fragment of the same address would not load anew
        self._send("Page.navigate", url=url)
        self.wait_for("document.readyState === 'complete' && location.href !== 'about:blank'")

    def resize(self, width: int, height: int, *, mobile: bool = False) -> None:
        """Give the page another window size [CSS px]."""
        self._send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression, awaited where it is a promise.

        Raises:
            RuntimeError: when it throws.
        """
        found = self._send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(f"{script}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def wait_for(self, script: str, seconds: float = 20.0) -> Any:
        """The first true value of an expression.

        Raises:
            TimeoutError: when there is none in time.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if value := self.run(script):
                return value
            time.sleep(0.02)
        raise TimeoutError(f"{script}: not within {seconds:g} s; errors of the page: {self.errors}")

    def press(self, key: str) -> None:
        """Press and release a key: a name of `_KEYS`."""
        code, number = _KEYS[key]
        text = {"text": "\r" if key == "Enter" else key} if key in (" ", "Enter") else {}
        event = {"key": key, "code": code, "windowsVirtualKeyCode": number}
        self._send("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", **event, **text)
        self._send("Input.dispatchKeyEvent", type="keyUp", **event)

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Write what is seen, or the whole page, as PNG."""
        shot = self._send("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def print_pdf(self, path: Path) -> None:
        """Write the page as it prints on A4."""
        made = self._send("Page.printToPDF", paperWidth=8.27, paperHeight=11.69, preferCSSPageSize=True)
        path.write_bytes(base64.b64decode(made["data"]))

    def _send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and wait for its answer; events on the way are noted."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._note(answer)

    def _receive(self, seconds: float = 30.0) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._read], [], [], seconds)[0]:
                raise TimeoutError(f"the browser is silent for {seconds:g} s")
            part = os.read(self._read, 1 << 16)
            if not part:
                raise RuntimeError("the browser has ended")
            self._buffer += part
        message, self._buffer = self._buffer.split(b"\0", 1)
        return json.loads(message)

    def _note(self, event: dict[str, Any]) -> None:
        parameters = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            self.errors.append(str(parameters["exceptionDetails"]))
        elif event.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(f"{parameters['entry']['text']} {parameters['entry'].get('url', '')}")
        elif event.get("method") == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            self.errors.append(str(parameters["args"]))
