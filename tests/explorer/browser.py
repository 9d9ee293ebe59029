"""A real browser without a window, driven over the WebDriver protocol by the standard library alone."""

import base64
import json
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


class Browser:
    """Chromium under chromedriver; a context manager."""

    def __init__(self, driver: str, browser: str, width: int, height: int) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen([driver, f"--port={port}"], stdout=quiet, stderr=quiet)
        self._root = f"http://127.0.0.1:{port}"
        # A container has neither a sandbox nor shared memory for it.
        words = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"]
        options = {"binary": browser, "args": [*words, f"--window-size={width},{height}"]}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        try:
            self._await_driver()
            found = self._call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
            self._session = f"/session/{found['sessionId']}"
            metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self.devtools("Emulation.setDeviceMetricsOverride", metrics)
        except Exception:
            self._process.kill()
            raise

    def open(self, url: str) -> None:
        """Load a page."""
        self._call("POST", f"{self._session}/url", {"url": url})

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        return self._call("POST", f"{self._session}/execute/sync", {"script": f"return {script}", "args": []})

    def devtools(self, command: str, parameters: dict) -> Any:
        """The answer to a command of the DevTools protocol."""
        content = {"cmd": command, "params": parameters}
        return self._call("POST", f"{self._session}/goog/cdp/execute", content)

    def wait_for(self, script: str, timeout_s: float = 60.0) -> Any:
        """The value of an expression as soon as it is true."""
        end = time.monotonic() + timeout_s
        while not (value := self.run(script)):
            if time.monotonic() > end:
                raise TimeoutError(f"not true after {timeout_s:g} s: {script}")
            time.sleep(0.1)
        return value

    def drag(self, places: list[tuple[float, float]], step_ms: int) -> None:
        """Press the mouse at the first place [CSS px], move it through the others and let go."""
        moves = [{"type": "pointerMove", "duration": step_ms, "x": round(x), "y": round(y)} for x, y in places]
        press, let_go = {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}
        self._act([{**moves[0], "duration": 0}, press, *moves[1:], let_go], "pointer")

    def press(self, key: str, times: int = 1) -> None:
        """Press a key on the page."""
        strokes = [{"type": kind, "value": key} for _ in range(times) for kind in ("keyDown", "keyUp")]
        self._act(strokes, "key")

    def click(self, selector: str) -> None:
        """Click in the middle of an element."""
        box = self.run(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")
        self.drag([(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)], 0)

    def log(self) -> list[str]:
        """What the page has logged as warnings or errors since the last call, exceptions included."""
        entries = self._call("POST", f"{self._session}/se/log", {"type": "browser"})
        return [entry["message"] for entry in entries if entry["level"] in ("SEVERE", "WARNING")]

    def screenshot(self, path: Path) -> Path:
        """Write the page as a PNG file."""
        path.write_bytes(base64.b64decode(self._call("GET", f"{self._session}/screenshot")))
        return path

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._call("DELETE", self._session)
        finally:
            self._process.terminate()
            self._process.wait(timeout=10)

    def _act(self, actions: list[dict], kind: str) -> None:
        source = {"type": kind, "id": kind, "actions": actions}
        if kind == "pointer":
            source["parameters"] = {"pointerType": "mouse"}
        self._call("POST", f"{self._session}/actions", {"actions": [source]})

    def _await_driver(self) -> None:
        for _ in range(200):
            try:
                if self._call("GET", "/status")["ready"]:
                    return
            except OSError:
                time.sleep(0.05)
        raise TimeoutError("chromedriver did not start within 10 s")

    def _call(self, method: str, path: str, content: dict | None = None) -> Any:
        body = None if content is None else json.dumps(content).encode()
        request = urllib.request.Request(self._root + path, body, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(json.load(error)["value"]["message"]) from error


def find() -> tuple[str, str] | None:
    """Paths of chromedriver and of a browser; None where one of them is missing."""
    driver, browser = shutil.which("chromedriver"), next(filter(None, map(shutil.which, BROWSERS)), None)
    return (driver, browser) if driver and browser else None
