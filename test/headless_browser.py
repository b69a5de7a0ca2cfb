"""A headless Chromium, driven through its DevTools protocol."""

import base64
import contextlib
import json
import shutil
import signal
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from patience import PATIENCE
from websockets.sync.client import ClientConnection, connect

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    "--remote-debugging-port=0",
)

KEYS = {"Enter": 13, "ArrowRight": 39}

TOLD = """
window.told = [];
new MutationObserver(() => {
  for (const one of document.querySelectorAll(".q-notification")) window.told.push(one.innerText);
}).observe(document, { childList: true, subtree: true });
"""
"""Records the page's notifications, which disappear after a few seconds."""


class Tab:
    """One page of the browser."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._number = 0
        self.requested: list[str] = []
        self.complaints: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.command(f"{domain}.enable")
        self.command("Page.addScriptToEvaluateOnNewDocument", source=TOLD)

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE))
            if message.get("id") == self._number:
                assert "error" not in message, message["error"]
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requested.append(parameters["request"]["url"])
        if message.get("method") == "Network.webSocketCreated":
            self.requested.append(parameters["url"])
        if message.get("method") == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", details["text"]))
        if message.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.complaints.append(f"{parameters['entry']['text']} {parameters['entry'].get('url', '')}")

    def evaluate(self, expression: str) -> Any:
        done = self.command("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done["exceptionDetails"]
        return done["result"].get("value")

    def until(self, expression: str, seconds: float = PATIENCE) -> Any:
        """Wait until an expression is true, and return its value."""
        deadline = time.monotonic() + seconds
        while not (value := self.evaluate(expression)):
            shown = "document.body.innerText.slice(0, 800)"
            assert time.monotonic() < deadline, f"{expression} did not come true: {self.complaints} {self.evaluate(shown)}"
            time.sleep(0.05)
        return value

    def go(self, address: str) -> None:
        self.command("Page.navigate", url=address)
        self.until("document.readyState === 'complete'")

    def click(self, selector: str) -> None:
        self.until(f"!!document.querySelector({json.dumps(selector)})")
        self.evaluate(f"document.querySelector({json.dumps(selector)}).click()")

    def type_into(self, selector: str, text: str) -> None:
        """Replace the text of a field, as a user would, and press Enter."""
        self._write(selector, text)
        self._press("Enter")

    def choose(self, selector: str, text: str) -> None:
        """Type into a selection field, and take the matching entry of its list."""
        self._write(selector, text)
        entry = f"[...document.querySelectorAll('.q-menu .q-item')].find(i => i.innerText.includes({json.dumps(text)}))"
        self.until(f"({entry}?.click(), !!{entry})")

    def _write(self, selector: str, text: str) -> None:
        self.until(f"!!document.querySelector({json.dumps(selector)})")
        self.evaluate(f"(f => {{ f.focus(); f.select(); }})(document.querySelector({json.dumps(selector)}))")
        self.command("Input.insertText", text=text)

    def press(self, selector: str, key: str) -> None:
        """Focus an element and press a key."""
        self.until(f"!!document.querySelector({json.dumps(selector)})")
        self.evaluate(f"document.querySelector({json.dumps(selector)}).focus()")
        self._press(key)

    def _press(self, key: str) -> None:
        for kind in ("rawKeyDown", "keyUp"):
            self.command("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=KEYS[key])

    def is_told(self, words: str) -> None:
        """Wait for a notification."""
        self.until(f"window.told.some(text => text.includes({json.dumps(words)}))")

    def text(self, name: str) -> str:
        return self.evaluate(f"document.querySelector('[data-name=\"{name}\"]')?.innerText ?? ''")

    def resize(self, width: int, height: int) -> None:
        self.command("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def prefer(self, scheme: str) -> None:
        """Set the system's preference, dark or light."""
        self.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def picture(self) -> bytes:
        return base64.b64decode(self.command("Page.captureScreenshot", format="png")["data"])


class Browser:
    """The browser's process."""

    def __init__(self, port: int) -> None:
        self.port = port

    @contextlib.contextmanager
    def tab(self, address: str) -> Iterator[Tab]:
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            made = json.load(answer)
        with connect(made["webSocketDebuggerUrl"], max_size=None, open_timeout=PATIENCE, ping_interval=None) as socket:
            tab = Tab(socket)
            tab.go(address)
            yield tab
            tab.command("Page.close")


@contextlib.contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """Run Chromium with a separate profile."""
    assert CHROMIUM is not None
    command = [CHROMIUM, *ARGUMENTS, f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        file = profile / "DevToolsActivePort"
        deadline = time.monotonic() + PATIENCE
        while not file.exists() or len(file.read_text(encoding="utf-8").splitlines()) < 2:
            assert process.poll() is None, "Chromium ended"
            assert time.monotonic() < deadline, "Chromium did not come up"
            time.sleep(0.05)
        yield Browser(int(file.read_text(encoding="utf-8").splitlines()[0]))
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
