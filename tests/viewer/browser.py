"""A real browser for tests: headless Chromium, steered through pipes by the protocol of its developer tools.

Debian's package and the standard library suffice, so nothing is downloaded and no driver has to fit the browser's
version.
"""

import base64
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome") or ""
needs_chromium = pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed")
PATIENCE = 120.0  # seconds


class Browser:
    """A Chromium process with one page. `errors` has what its console and its loader complained about."""

    def __init__(self, profile: Path, *flags: str) -> None:
        to_browser, ours_out = os.pipe()
        ours_in, from_browser = os.pipe()
        quiet = ["background-networking", "component-update", "sync", "extensions", "dev-shm-usage"]
        command = [
            CHROMIUM, "--headless=new", "--no-sandbox", "--no-first-run", *(f"--disable-{name}" for name in quiet),
            "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--in-process-gpu", "--hide-scrollbars",
            "--force-device-scale-factor=1", f"--user-data-dir={profile}", "--remote-debugging-pipe", *flags,
            "about:blank",
        ]  # fmt: skip
        # The protocol's pipes are the descriptors 3 and 4 of the browser.
        plumbing = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        self._process = subprocess.Popen(
            ["bash", "-c", plumbing, "bash", *command], pass_fds=(to_browser, from_browser),
            stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_browser)
        os.close(from_browser)
        self._in, self._out = os.fdopen(ours_in, "rb"), os.fdopen(ours_out, "wb")
        self._number = 0
        self._session: str | None = None
        self._unread = b""
        self.errors: list[str] = []
        target = next(t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")
        self.size(1400, 1000)

    def call(self, method: str, **parameters: object) -> Any:
        """Send a command and return its result; what comes in between is looked through for errors."""
        self._number += 1
        message: dict[str, object] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._out.write(json.dumps(message).encode() + b"\0")
        self._out.flush()
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._listen(answer)

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._unread:
            chunk = os.read(self._in.fileno(), 1 << 20)
            assert chunk, "Chromium has ended"
            self._unread += chunk
        text, _, self._unread = self._unread.partition(b"\0")
        found: dict[str, Any] = json.loads(text)
        return found

    def _listen(self, event: dict[str, Any]) -> None:
        given = event.get("params", {})
        if event["method"] == "Runtime.exceptionThrown":
            self.errors.append(given["exceptionDetails"]["exception"].get("description", "exception"))
        elif event["method"] == "Runtime.consoleAPICalled" and given["type"] in ("error", "warning", "assert"):
            self.errors.append(str([value.get("value", value.get("description")) for value in given["args"]]))
        elif event["method"] == "Log.entryAdded" and given["entry"]["level"] in ("error", "warning"):
            self.errors.append(f"{given['entry']['text']} {given['entry'].get('url', '')}")

    def open(self, page: Path, fragment: str = "") -> None:
        """Open a page from disk and wait until its first picture is drawn."""
        self.errors.clear()
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=page.resolve().as_uri() + fragment)
        self.wait("document.readyState === 'complete' && document.querySelector('header') !== null")
        self.wait("(document.querySelector('.stage')?.ariaBusy ?? 'false') === 'false'")

    def run(self, script: str) -> Any:
        """Evaluate an expression in the page, waiting for a promise; return its value."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, f"{script}: {found['exceptionDetails']}"
        return found["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until an expression is true in the page."""
        end = time.monotonic() + PATIENCE
        while not self.run(condition):
            assert time.monotonic() < end, f"still not true: {condition}; {self.errors}"
            time.sleep(0.05)

    def settle(self) -> None:
        """Wait until what was asked for is loaded and drawn."""
        self.run("new Promise(done => requestAnimationFrame(() => setTimeout(done)))")
        self.wait("document.querySelector('.stage').ariaBusy === 'false'")

    def size(self, width: int, height: int) -> None:
        """Set the size of the window."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def dark(self, wanted: bool) -> None:
        """Prefer the dark or the light colours."""
        value = "dark" if wanted else "light"
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": value}])

    def press(self, key: str, code: str = "", shift: bool = False) -> None:
        """Press a key and let go of it."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, modifiers=8 * shift)

    def mouse(self, kind: str, x: float, y: float, **more: object) -> None:
        """Move the mouse to a place in the window, or press or release its left button there."""
        names = {"move": "mouseMoved", "press": "mousePressed", "release": "mouseReleased", "wheel": "mouseWheel"}
        if kind != "wheel":
            more = {"button": "left", "buttons": int(kind == "press" or bool(more.pop("held", False))), **more}
            if kind != "move":
                more["clickCount"] = 1
            elif not more["buttons"]:
                more["button"] = "none"
        self.call("Input.dispatchMouseEvent", type=names[kind], x=x, y=y, **more)

    def box(self, selector: str) -> dict[str, float]:
        """Return x, y, width and height of an element in the window."""
        found: dict[str, float] = self.run(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")
        return found

    def picture(self, selector: str = "") -> bytes:
        """Take a screenshot of an element as PNG; "" takes the whole page."""
        part = {"clip": {**self.box(selector), "scale": 1}} if selector else {"captureBeyondViewport": True}
        data: str = self.call("Page.captureScreenshot", format="png", **part)["data"]
        return base64.b64decode(data)

    def close(self) -> None:
        """End the browser."""
        try:
            self._session = None
            self.call("Browser.close")
            self._process.wait(10)
        except (AssertionError, OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        self._in.close()
        self._out.close()
