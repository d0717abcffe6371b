"""A page in a real browser, used as a reader uses it: clicks, keys, screen sizes, paper. Chromium's DevTools protocol.

    with Browser() as browser:
        page = browser.open(path, width=390)
        page.evaluate("document.title")

The protocol (https://chromedevtools.github.io/devtools-protocol/) goes through a pipe: no port, no driver.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
"""The browser's program; None where there is none."""


class Browser:
    """A headless browser with a profile of its own; closed at the end of the block."""

    def __enter__(self) -> Browser:
        assert CHROMIUM is not None
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        # the browser reads commands from descriptor 3 and writes answers to descriptor 4
        command_read, self._write = os.pipe()
        self._read, answer_write = os.pipe()
        flags = [
            "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe",
            f"--user-data-dir={self._profile.name}", "--no-first-run", "--disable-dev-shm-usage",
            "--proxy-server=127.0.0.1:9",  # a page that asked for the network would not get it
        ]  # fmt: skip
        shell = f'exec "$0" "$@" 3<&{command_read} 4>&{answer_write}'
        self._process = subprocess.Popen(
            ["/bin/bash", "-c", shell, CHROMIUM, *flags, "about:blank"],
            pass_fds=(command_read, answer_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(command_read)
        os.close(answer_write)
        self._buffer, self._number = b"", 0
        self.events: list[dict[str, Any]] = []
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(Exception):
            self.call("Browser.close")
        os.close(self._write)
        os.close(self._read)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._profile.cleanup()

    def call(self, method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        """The answer of the browser to one command; events that come before it are kept in `events`."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._write, data) :]
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return dict(answer["result"])
            self.events.append(answer)

    def wait_for(self, method: str, session: str) -> None:
        """Read events until one of this name has come."""
        while not any(e.get("method") == method and e.get("sessionId") == session for e in self.events):
            self.events.append(self._next())

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            piece = os.read(self._read, 1 << 20)
            if not piece:
                raise RuntimeError("the browser ended")
            self._buffer += piece
        message, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(message))

    def open(self, page: Path | str, width: int = 1400, height: int = 900, *, scripts: bool = True) -> OpenPage:
        """A page on a screen of this size [CSS pixels], once it has loaded.

        page    : a file, or the address of a server on this machine
        scripts : whether the reader's browser runs scripts
        """
        address = page if isinstance(page, str) else page.resolve().as_uri()
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        shown = OpenPage(self, session, address)
        for domain in ("Page", "Runtime", "Log", "Network"):
            shown.call(f"{domain}.enable")
        shown.call("Emulation.setScriptExecutionDisabled", value=not scripts)
        shown.resize(width, height)
        shown.call("Page.navigate", url=address)
        self.wait_for("Page.loadEventFired", session)
        return shown


class OpenPage:
    """A page that a browser shows."""

    def __init__(self, browser: Browser, session: str, address: str) -> None:
        self._browser, self._session = browser, session
        parts = urlsplit(address)
        self._own = ("file:", "data:") if parts.scheme == "file" else ("data:", f"{parts.scheme}://{parts.netloc}/")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to one command of the protocol."""
        return self._browser.call(method, self._session, **parameters)

    def resize(self, width: int, height: int = 900) -> None:
        """Show the page on a screen of another size [CSS pixels]; a narrow one is that of a phone."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression in the page; a promise is awaited."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"]["exception"].get("description", "exception"))
        return found["result"].get("value")

    def drag(self, x: float, y: float, to_x: float) -> None:
        """Press the mouse at a place of the screen, move it sideways and release it."""
        for kind, at in (("mouseMoved", x), ("mousePressed", x), ("mouseMoved", (x + to_x) / 2), ("mouseMoved", to_x)):
            self._mouse(kind, at, y)
        self._mouse("mouseReleased", to_x, y)

    def _mouse(self, kind: str, x: float, y: float) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def move(self, x: float, y: float) -> None:
        """Move the mouse to a place of the screen."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)

    def press(self, key: str) -> None:
        """Press a key, by its name or its character."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def complaints(self) -> list[str]:
        """Errors and warnings in the page's console, what it was forbidden, and addresses that it asked for."""
        self.evaluate("new Promise((done) => requestAnimationFrame(() => setTimeout(done, 20)))")
        found = []
        for event in self._browser.events:
            if event.get("sessionId") != self._session:
                continue
            method, about = event["method"], event["params"]
            if method == "Runtime.exceptionThrown":
                found.append(str(about["exceptionDetails"]))
            elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
                found.append(str(about["args"]))
            elif method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
                found.append(about["entry"]["text"])
            elif method == "Network.requestWillBeSent" and not about["request"]["url"].startswith(self._own):
                found.append(about["request"]["url"])
        return found

    def screenshot(self, path: Path, *, whole: bool = True) -> None:
        """The page as a PNG; whole, or the part on the screen."""
        self.evaluate("new Promise((done) => requestAnimationFrame(() => setTimeout(done, 100)))")
        image = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(image["data"]))

    def pdf(self, path: Path) -> None:
        """The page as a PDF file, as a reader prints it on A4."""
        size = {"paperWidth": 8.27, "paperHeight": 11.69}
        path.write_bytes(base64.b64decode(self.call("Page.printToPDF", printBackground=True, **size)["data"]))
