"""Headless Chromium, driven through its debugging pipe with the standard library alone."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

__all__ = ["BROWSER", "Browser", "Page"]

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
          "--disable-component-update", "--disable-dev-shm-usage", "--remote-debugging-pipe")  # fmt: skip


class Browser:
    """One browser; close it when done."""

    def __init__(self, folder: Path) -> None:
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        self._profile, self._left, self._last = folder / "profile", b"", 0
        # The browser reads commands from descriptor 3 and answers on 4.
        shell = f'exec "$@" 3<&{to_browser} 4>&{from_browser}'
        command = ["bash", "-c", shell, "bash", str(BROWSER), *_FLAGS, f"--user-data-dir={self._profile}"]
        self._process = subprocess.Popen(
            command, pass_fds=(to_browser, from_browser), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(to_browser)
        os.close(from_browser)
        self.events: list[dict[str, Any]] = []

    def close(self) -> None:
        """Close the browser, and kill it if it does not end."""
        try:
            self.call("Browser.close")
            self._process.wait(10)
        except (OSError, RuntimeError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._write)
        os.close(self._read)

    def call(self, method: str, session: str | None = None, **arguments: Any) -> dict[str, Any]:
        """Return the answer to one command; events in between are recorded."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": arguments} | (
            {"sessionId": session} if session else {}
        )
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._last:
            self.events.append(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def _next(self, seconds: float = 30) -> dict[str, Any]:
        while b"\0" not in self._left:
            if not select.select([self._read], [], [], seconds)[0]:
                raise RuntimeError(f"no answer from the browser for {seconds} s")
            part = os.read(self._read, 1 << 20)
            if not part:
                raise RuntimeError("the browser ended")
            self._left += part
        first, self._left = self._left.split(b"\0", 1)
        return json.loads(first)


class Page:
    """One tab that shows a file."""

    def __init__(self, browser: Browser, path: Path, width: int = 1200, height: int = 900, **media: str) -> None:
        self._browser = browser
        target = browser.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = browser.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=2, mobile=False)
        features = [{"name": name.replace("_", "-"), "value": value} for name, value in media.items()]
        self.call("Emulation.setEmulatedMedia", features=features)
        self.call("Page.navigate", url=path.as_uri())
        self.until("document.documentElement?.dataset.ready", 20)
        self.frames()

    def call(self, method: str, **arguments: Any) -> dict[str, Any]:
        """Return the answer to a command to this tab."""
        return self._browser.call(method, self._session, **arguments)

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression, awaited."""
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def until(self, script: str, seconds: float = 5) -> Any:
        """Return the value of an expression once it is true."""
        end = time.monotonic() + seconds
        while not (value := self.run(script)):
            if time.monotonic() > end:
                raise RuntimeError(f"not true within {seconds} s: {script}")
            time.sleep(0.02)
        return value

    def frames(self, count: int = 2) -> None:
        """Wait for ``count`` drawn frames."""
        self.run(f"(async () => {{ for (let n = 0; n < {count}; n++) await new Promise(requestAnimationFrame); }})()")

    def state(self) -> dict[str, Any]:
        """Return the state reported by the page, after drawing it."""
        self.frames()
        return self.run("uplift.state()")

    def key(self, name: str, shift: bool = False) -> dict[str, Any]:
        """Press one key and return the state after it."""
        text = {"text": name} if len(name) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=name, modifiers=8 * shift, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=name)
        return self.state()

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Send one real mouse event at page coordinates."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def swipe(self, element: str, across: float = 0, down: float = 0) -> None:
        """Drag one finger over an element, from its middle, slowly enough for the browser to tell what is meant."""
        self.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        x, y = self.middle(element)
        for kind, share in (("touchStart", 0.0), *(("touchMove", step / 10) for step in range(1, 11))):
            at = {"x": x + share * across, "y": y + share * down, "id": 0}
            self.call("Input.dispatchTouchEvent", type=kind, touchPoints=[at])
            time.sleep(0.02)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        self.frames()

    def small_targets(self, least: float = 44) -> list[str]:
        """Return the controls that are shown and that a finger may miss: less than ``least`` px wide or high."""
        return self.run(
            "[...document.querySelectorAll('button, select, input')].filter((e) => { const b = e.getBoundingClientRect();"
            f"return e.checkVisibility() && Math.min(b.width, b.height) < {least} - 0.01; }}).map((e) => e.id || e.outerHTML)"
        )

    def middle(self, element: str) -> tuple[float, float]:
        """Return the middle of an element, scrolled into view."""
        return tuple(self.run(
            f"(() => {{ const e = document.getElementById('{element}'); e.scrollIntoView({{block: 'center'}});"
            "const b = e.getBoundingClientRect(); return [b.left + b.width / 2, b.top + b.height / 2]; })()"
        ))  # fmt: skip

    def ink(self, canvas: str) -> tuple[int, int]:
        """Return how many pixels of a canvas are painted, and a checksum of them."""
        self.frames()
        return tuple(self.run(
            f"(() => {{ const c = document.getElementById('{canvas}'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            "let n = 0, s = 0; for (let k = 0; k < d.length; k += 4) if (d[k + 3]) { n++; s = (s * 31 + d[k] + 3 * d[k + 1] + k) % 1e9; }"
            "return [n, s]; })()"
        ))  # fmt: skip

    def troubles(self) -> list[str]:
        """Return every request except that of the page, every exception and every logged error of this tab."""
        self.frames()
        found = []
        for event in self._browser.events:
            if event.get("sessionId") != self._session:
                continue
            method, about = event["method"], event["params"]
            if method == "Network.requestWillBeSent" and not (
                about["type"] == "Document" and about["request"]["url"].startswith("file:")
            ):
                found.append(f"request {about['request']['url']}")
            if method == "Runtime.exceptionThrown" or (
                method == "Log.entryAdded" and about["entry"]["level"] == "error"
            ):
                found.append(json.dumps(about))
        return found
