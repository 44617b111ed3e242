"""A headless Firefox over WebDriver BiDi, for what a second browser makes of a page. The standard library is enough."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.explore.browser.chromium import WATCH, BrowserError

PROGRAMS = ("firefox-esr", "firefox")
LISTENS = re.compile(r"WebDriver BiDi listening on ws://127\.0\.0\.1:(\d+)")
# Nothing but the page itself may ask for anything.
SETTINGS = """
user_pref("network.dns.disabled", true);
user_pref("app.normandy.enabled", false);
user_pref("app.update.enabled", false);
user_pref("browser.safebrowsing.malware.enabled", false);
user_pref("browser.safebrowsing.phishing.enabled", false);
user_pref("network.captive-portal-service.enabled", false);
user_pref("network.connectivity-service.enabled", false);
user_pref("services.settings.server", "data:,");
user_pref("toolkit.telemetry.enabled", false);
"""
EVENTS = ["log.entryAdded", "network.beforeRequestSent"]


def program() -> str | None:
    """Where Firefox is; None where it is not installed."""
    return next((found for name in PROGRAMS if (found := shutil.which(name))), None)


class _Socket:
    """A web socket to this machine: whole texts in both directions."""

    def __init__(self, port: int, path: str) -> None:
        self._stream = socket.create_connection(("127.0.0.1", port), timeout=60.0)
        key = base64.b64encode(os.urandom(16)).decode()
        head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        self._stream.sendall(f"{head}Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
        self._reader = self._stream.makefile("rb")
        if b" 101 " not in self._reader.readline():
            raise BrowserError("Firefox refuses the web socket")
        while self._reader.readline().strip():
            pass

    def send(self, text: str) -> None:
        data, mask = text.encode(), os.urandom(4)
        size = len(data)
        length = bytes([0x80 | size]) if size < 126 else b"\xfe" + size.to_bytes(2, "big")
        if size > 0xFFFF:
            length = b"\xff" + size.to_bytes(8, "big")
        masked = bytes(one ^ mask[k % 4] for k, one in enumerate(data))
        self._stream.sendall(b"\x81" + length + mask + masked)

    def receive(self) -> str:
        whole = b""
        while True:
            first, second = self._reader.read(2)
            size = second & 0x7F
            if size >= 126:
                size = int.from_bytes(self._reader.read(2 if size == 126 else 8), "big")
            data = self._reader.read(size)
            if first & 0x0F <= 2:  # a part of a text; what is left are signs of life
                whole += data
                if first & 0x80:
                    return whole.decode()

    def close(self) -> None:
        self._reader.close()
        self._stream.close()


class Firefox:
    """One running browser with one tab. ``urls`` are all addresses that it asked for, ``faults`` what its console
    complained about."""

    def __init__(self, port: int) -> None:
        self._socket = _Socket(port, "/session")
        self._number = 0
        self.urls: list[str] = []
        self.faults: list[str] = []
        self.version = self.call("session.new", capabilities={})["capabilities"]["browserVersion"]
        self.call("session.subscribe", events=EVENTS)
        self._context = self.call("browsingContext.getTree")["contexts"][0]["context"]

    def call(self, method: str, **given: Any) -> dict[str, Any]:
        """One command of the protocol and its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": given}))
        while True:
            message = json.loads(self._socket.receive())
            if message.get("id") == self._number:
                if message["type"] == "error":
                    raise BrowserError(f"{method}: {message['message']}")
                return message["result"]
            if message.get("method") == "network.beforeRequestSent":
                self.urls.append(message["params"]["request"]["url"])
            elif message.get("method") == "log.entryAdded" and message["params"]["level"] == "error":
                self.faults.append(str(message["params"]["text"]))

    def goto(self, url: str) -> None:
        """Go to an address, until it is loaded."""
        self.call("browsingContext.navigate", context=self._context, url=url, wait="complete")

    def size(self, width: int, height: int) -> None:
        """Size of the window, in CSS pixels."""
        self.call("browsingContext.setViewport", context=self._context, viewport={"width": width, "height": height})

    def evaluate(self, expression: str) -> Any:
        """The value of an expression of the page, waited for where it is a promise."""
        reply = self.call(
            "script.evaluate",
            expression=f"Promise.resolve({expression}).then((value) => JSON.stringify(value ?? null))",
            target={"context": self._context},
            awaitPromise=True,
        )
        if reply["type"] == "exception":
            raise BrowserError(f"{expression}: {reply['exceptionDetails']['text']}")
        return json.loads(reply["result"]["value"])

    def wait(self, expression: str, timeout_s: float = 40.0) -> Any:
        """Wait until an expression of the page is true."""
        found = self.evaluate(f"{WATCH % (expression, 1e3 * timeout_s)}.then((value) => Boolean(value))")
        if not found:
            raise BrowserError(f"after {timeout_s:g} s not true: {expression}; the page's faults: {self.faults}")
        return found

    def screenshot(self, path: Path) -> None:
        """The window as PNG."""
        shot = self.call("browsingContext.captureScreenshot", context=self._context)
        path.write_bytes(base64.b64decode(shot["data"]))

    def close(self) -> None:
        self._socket.close()


@contextmanager
def firefox() -> Iterator[Firefox]:
    """A browser with an empty profile. BrowserError where none is installed."""
    path = program()
    if path is None:
        raise BrowserError("Firefox is not installed (Debian: apt-get install firefox-esr)")
    with tempfile.TemporaryDirectory(prefix="vsgdesign-firefox-", ignore_cleanup_errors=True) as folder:
        Path(folder, "user.js").write_text(SETTINGS, encoding="utf-8")
        command = [path, "--headless", "--no-remote", "--remote-debugging-port=0", "--profile", folder, "about:blank"]
        said = Path(folder, "said.txt")
        with said.open("w", encoding="utf-8") as stream:
            process = subprocess.Popen(command, stderr=stream, stdout=subprocess.DEVNULL)
        try:
            browser = Firefox(_port(said))
            try:
                yield browser
            finally:
                browser.close()
        finally:
            process.kill()
            process.wait()


def _port(said: Path) -> int:
    """The port on which a browser listens, once it says so."""
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        if found := LISTENS.search(said.read_text(encoding="utf-8")):
            return int(found[1])
        time.sleep(0.05)
    raise BrowserError("Firefox does not say where WebDriver BiDi listens")
