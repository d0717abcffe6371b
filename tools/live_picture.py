"""The page of `sim-heating live --demo` as a reader sees it during the manoeuvre: docs/images/live_page.png."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from tests.support.chromium import Browser

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "live_page.png"
PORT, WIDTH, HEIGHT = 8765, 1400, 1000
SHOWN_AT_S = 890.0
"""Flight time of the picture [s]: in the pull-up."""


def main() -> None:
    """Fly the demonstration, and draw its page when the flight has come to the manoeuvre."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "sim_heating", "live", "--demo", "--port", str(PORT), "--out", f"{folder}/out"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=os.environ | {"BROWSER": "true"})
        try:
            taken_s = _draw()
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(120)
    print(f"{PICTURE.name}: {taken_s:.0f} s of the flight")


def _draw() -> float:
    _flown_to(0.0)
    with Browser() as browser:
        page = browser.open(f"http://127.0.0.1:{PORT}/", WIDTH, HEIGHT)
        taken_s = _flown_to(SHOWN_AT_S)
        page.screenshot(PICTURE, whole=False)
        return taken_s


def _flown_to(time_s: float) -> float:
    """Wait until the link's newest frame is of a flight time or a later one [s]; that of the frame."""
    while True:
        with contextlib.suppress(OSError):
            with urllib.request.urlopen(f"http://127.0.0.1:{PORT}/state.json", timeout=5.0) as answer:
                state = json.load(answer)
            if state and (now := state.get("time_s")) is not None and now >= time_s:
                return float(now)
        time.sleep(0.2)


if __name__ == "__main__":
    main()
