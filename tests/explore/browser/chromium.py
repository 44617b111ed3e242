"""A headless Chromium over the DevTools protocol on a pipe: what tests, benchmarks and screenshots need of a browser.

The standard library is enough. Mouse and keys are dispatched by the browser itself, so that pages get the events of a
real user (``isTrusted``). Only the names of the loopback address are resolved: no request can leave the machine.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless",
    "--remote-debugging-pipe",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--hide-scrollbars",
    "--mute-audio",
    "--no-default-browser-check",
    "--no-first-run",
    "--no-proxy-server",
    "--force-color-profile=srgb",
    "--disable-features=Translate,OptimizationHints,MediaRouter,DialMediaRouteProvider",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1 , EXCLUDE localhost",
)
# The protocol's pipe is on the descriptors 3 and 4.
STARTER = """
import os, sys
read, write = os.dup(int(sys.argv[1])), os.dup(int(sys.argv[2]))
spare = [os.dup(read), os.dup(write)]
os.dup2(spare[0], 3); os.dup2(spare[1], 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
WATCH = """new Promise((done) => {
  const read = () => { try { return (%s); } catch { return null; } };
  const end = performance.now() + %f;
  const look = () => {
    const value = read();
    if (value) done(value instanceof Node ? true : value);
    else if (performance.now() > end) done(null);
    else setTimeout(look, 15);
  };
  look();
})"""
ON_TOP = """((element, hit) => element.contains(hit) || hit.closest("label")?.control === element)(
  document.querySelector(%s), document.elementFromPoint(%f, %f))"""
"""Whether a click at a point hits an element, or its label."""
KEYS = {
    "Tab": 9,
    "Enter": 13,
    "Escape": 27,
    " ": 32,
    "End": 35,
    "Home": 36,
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
}
MODIFIERS = {"Alt": 1, "Control": 2, "Meta": 4, "Shift": 8}


def program() -> str | None:
    """Where Chromium is; None where it is not installed."""
    return next((found for name in PROGRAMS if (found := shutil.which(name))), None)


class BrowserError(RuntimeError):
    """The browser or the page did not do what was asked of it."""


@dataclass(frozen=True)
class Box:
    """Where an element is, in CSS pixels of the window."""

    x: float
    y: float
    width: float
    height: float

    def at(self, across: float = 0.5, down: float = 0.5) -> tuple[float, float]:
        """A point of it, as shares of its width and height."""
        return self.x + across * self.width, self.y + down * self.height


class Chromium:
    """One running browser. Use it through :func:`chromium`."""

    def __init__(self, path: str, profile: Path) -> None:
        to_read, to_write = os.pipe(), os.pipe()
        command = [sys.executable, "-I", "-S", "-c", STARTER, str(to_write[0]), str(to_read[1]), path, *FLAGS]
        self._process = subprocess.Popen(
            [*command, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(to_write[0], to_read[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_write[0])
        os.close(to_read[1])
        self._read, self._write = to_read[0], to_write[1]
        self._buffer = bytearray()
        self._number = 0
        self._replies: dict[int, dict[str, Any]] = {}
        self._pages: dict[str, Page] = {}
        self.downloads = profile / "downloads"
        self.downloads.mkdir()

    def call(self, method: str, session: str | None = None, /, timeout_s: float = 60.0, **given: Any) -> dict[str, Any]:
        """One command of the protocol and its result."""
        self._number += 1
        number = self._number
        message: dict[str, Any] = {"id": number, "method": method, "params": given}
        if session is not None:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._write, data) :]
        until = time.monotonic() + timeout_s
        while number not in self._replies:
            self.read(until, method)
        reply = self._replies.pop(number)
        if "error" in reply:
            raise BrowserError(f"{method}: {reply['error']['message']}")
        return reply["result"]

    def read(self, until: float, what: str) -> None:
        """Take in what the browser has sent; wait for it until a time of the monotonic clock."""
        ready, _, _ = select.select([self._read], [], [], max(until - time.monotonic(), 0.0))
        if not ready:
            raise BrowserError(f"{what}: no answer of the browser in time")
        data = os.read(self._read, 1 << 20)
        if not data:
            raise BrowserError(f"{what}: the browser has ended")
        self._buffer += data
        *messages, rest = bytes(self._buffer).split(b"\0")
        self._buffer = bytearray(rest)
        for text in messages:
            message = json.loads(text)
            if "id" in message:
                self._replies[message["id"]] = message
            elif (page := self._pages.get(message.get("sessionId", ""))) is not None:
                page.note(message["method"], message["params"])

    def page(self, width: int = 1280, height: int = 800, *, dark: bool = False, scale: float = 1.0) -> Page:
        """An empty page in a context of its own, which shares nothing with other pages."""
        context = self.call("Target.createBrowserContext")["browserContextId"]
        return self.page_in(context, width, height, dark=dark, scale=scale)

    def page_in(
        self, context: str, width: int = 1280, height: int = 800, *, dark: bool = False, scale: float = 1.0
    ) -> Page:
        """A further page of a context: another tab."""
        target = self.call("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = Page(self, context, target, session)
        self._pages[session] = page
        for domain in ("Page", "Runtime", "Network", "Log"):
            page.call(f"{domain}.enable")
        self.call(
            "Browser.setDownloadBehavior", behavior="allow", browserContextId=context, downloadPath=str(self.downloads)
        )
        page.call("Emulation.setFocusEmulationEnabled", enabled=True)
        page.look(dark=dark)
        page.size(width, height, scale)
        return page

    def close(self) -> None:
        """End the browser and its processes."""
        try:
            self.call("Browser.close", timeout_s=2.0)
            self._process.wait(3.0)
        except (BrowserError, OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._read)
        os.close(self._write)


class Page:
    """One tab. ``urls`` are all addresses that it asked for, ``faults`` what its console complained about."""

    def __init__(self, browser: Chromium, context: str, target: str, session: str) -> None:
        self.browser, self.context, self._target, self._session = browser, context, target, session
        self.urls: list[str] = []
        self.faults: deque[str] = deque()
        self._document = ""
        self._traced: list[dict[str, Any]] | None = None
        """Events of a trace; None where the browser has told all."""

    def call(self, method: str, /, **given: Any) -> dict[str, Any]:
        """One command of the protocol to this page."""
        return self.browser.call(method, self._session, **given)

    def note(self, method: str, said: dict[str, Any]) -> None:
        """Keep what the tests ask for of the page's events."""
        if method == "Page.frameNavigated" and "parentId" not in said["frame"]:
            self._document = said["frame"]["loaderId"]
        elif method == "Network.requestWillBeSent":
            self.urls.append(said["request"]["url"])
        elif method == "Tracing.dataCollected" and self._traced is not None:
            self._traced += said["value"]
        elif method == "Tracing.tracingComplete":
            self._traced = None
        elif method == "Network.webSocketCreated":
            self.urls.append(said["url"])
        elif method == "Runtime.exceptionThrown":
            details = said["exceptionDetails"]
            self.faults.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
            self.faults.append(" ".join(str(value.get("value", "")) for value in said["args"]))
        elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.faults.append(f"{said['entry']['text']} ({said['entry'].get('url', '')})")

    @contextmanager
    def tasks(self) -> Iterator[tuple[list[float], list[float]]]:
        """How long every task of the pages' main threads within the block lasted, and its processor time, in ms, when
        the block is left."""
        lasted, busy = found = ([], [])
        self._traced = events = []
        categories = ["__metadata", "disabled-by-default-devtools.timeline", "devtools.timeline", "toplevel"]
        self.call("Tracing.start", transferMode="ReportEvents", traceConfig={"includedCategories": categories})
        yield found
        self.call("Tracing.end")
        until = time.monotonic() + 60.0
        while self._traced is not None:
            self.browser.read(until, "the trace")
        main = {
            (one["pid"], one["tid"])
            for one in events
            if one["name"] == "thread_name" and one["args"]["name"] == "CrRendererMain"
        }
        for one in events:
            if one["name"] == "RunTask" and (one["pid"], one["tid"]) in main:
                lasted.append(one["dur"] / 1e3)
                busy.append(one["tdur"] / 1e3)

    def goto(self, url: str) -> None:
        """Go to an address. When this returns, the document is the new one, and not yet loaded.

        Chromium answers before that: what was asked next could be asked of the old document, or be lost with it.
        """
        reply = self.call("Page.navigate", url=url)
        if reply.get("errorText"):
            raise BrowserError(f"{url}: {reply['errorText']}")
        until = time.monotonic() + 60.0
        while reply.get("loaderId", self._document) != self._document:
            self.browser.read(until, f"{url} takes the place of the page before")

    def front(self) -> None:
        """Show this tab, as a user does who goes on there: the browser lets a hidden one draw seldom."""
        self.call("Page.bringToFront")

    def size(self, width: int, height: int, scale: float = 1.0) -> None:
        """Size of the window, in CSS pixels, and pixels of the screen for each of them."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=scale,
            mobile=width < 600,
        )

    def look(self, *, dark: bool) -> None:
        """The scheme that the user's system asks for, and no animation."""
        features = [
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"},
            {"name": "prefers-reduced-motion", "value": "reduce"},
        ]
        self.call("Emulation.setEmulatedMedia", features=features)

    def evaluate(self, expression: str) -> Any:
        """The value of an expression of the page, waited for where it is a promise."""
        reply = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in reply:
            details = reply["exceptionDetails"]
            raise BrowserError(f"{expression}: {details.get('exception', {}).get('description', details['text'])}")
        return reply["result"].get("value")

    def wait(self, expression: str, timeout_s: float = 40.0) -> Any:
        """Wait until an expression of the page is true. Looked at in each frame; its value."""
        watch = WATCH % (expression, 1e3 * timeout_s)
        found = self.evaluate(watch)
        if not found:
            raise BrowserError(f"after {timeout_s:g} s not true: {expression}; the page's faults: {list(self.faults)}")
        return found

    def box(self, selector: str) -> Box:
        """Where the first element of a selector is, scrolled into view."""
        found = self.evaluate(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); if (!e) return null;"
            "e.scrollIntoView({block: 'nearest'}); const b = e.getBoundingClientRect();"
            "return [b.x, b.y, b.width, b.height]; })()"
        )
        if found is None:
            raise BrowserError(f"there is no {selector} on the page")
        return Box(*found)

    def still(self, selector: str) -> Box:
        """:meth:`box` once a frame has passed in which it did not move: a click on what moves hits something else."""
        before = self.box(selector)
        for _ in range(60):
            self.evaluate("new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
            now = self.box(selector)
            if now == before:
                return now
            before = now
        raise BrowserError(f"{selector} does not come to rest")

    def mouse(self, kind: str, x: float, y: float, buttons: int = 0) -> None:
        """One event of the mouse: mousePressed, mouseMoved or mouseReleased."""
        button = "left" if kind != "mouseMoved" or buttons else "none"
        self.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            button=button,
            buttons=buttons,
            clickCount=int(button == "left"),
        )

    def click(self, at: str | tuple[float, float]) -> None:
        """Click on an element of a selector, once it lies still and nothing is above it, or at a point."""
        x, y = self.still(at).at() if isinstance(at, str) else at
        if isinstance(at, str):
            self.wait(ON_TOP % (json.dumps(at), x, y))
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, 1)
        self.mouse("mouseReleased", x, y)

    def drag(self, points: list[tuple[float, float]]) -> None:
        """Press at the first point, move over the others, release at the last."""
        self.mouse("mouseMoved", *points[0])
        self.mouse("mousePressed", *points[0], 1)
        for point in points[1:]:
            self.mouse("mouseMoved", *point, 1)
        self.mouse("mouseReleased", *points[-1])

    def key(self, name: str, *modifiers: str) -> None:
        """Press and release a key of the keyboard."""
        mask = sum(MODIFIERS[modifier] for modifier in modifiers)
        code = KEYS.get(name) or ord(name.upper())
        text = {"Enter": "\r"}.get(name, name if len(name) == 1 else "")
        given: dict[str, Any] = {"key": name, "windowsVirtualKeyCode": code, "modifiers": mask}
        given["code"] = f"Key{name.upper()}" if len(name) == 1 and name.isalpha() else name
        if name == "a" and "Control" in modifiers:
            given["commands"] = ["selectAll"]
        typed = {"text": text} if text and not mask & ~MODIFIERS["Shift"] else {}
        self.call("Input.dispatchKeyEvent", type="keyDown" if typed else "rawKeyDown", **given, **typed)
        self.call("Input.dispatchKeyEvent", type="keyUp", **given)

    def type(self, selector: str, text: str) -> None:
        """Replace what is in a field by typing, and leave it with Enter."""
        self.click(selector)
        if not self.evaluate(f"document.activeElement === document.querySelector({json.dumps(selector)})"):
            raise BrowserError(f"a click on {selector} does not give it the focus")
        self.key("a", "Control")
        self.call("Input.insertText", text=text)
        self.key("Enter")

    def choose(self, selector: str, value: str) -> None:
        """Choose in a closed list with the keyboard."""
        name = json.dumps(selector)
        self.evaluate(f"document.querySelector({name}).focus()")
        order = self.evaluate(f"[...document.querySelector({name}).options].map((option) => option.value)")
        self.key("Home")
        for _ in range(order.index(value)):
            self.key("ArrowDown")

    def downloaded(self, name: str, timeout_s: float = 40.0) -> Path:
        """A file that the page has saved, when it is there."""
        path = self.browser.downloads / name
        until = time.monotonic() + timeout_s
        while not (path.exists() and path.stat().st_size):
            if time.monotonic() > until:
                raise BrowserError(f"no download {name}; there are {sorted(p.name for p in path.parent.iterdir())}")
            time.sleep(0.02)
        return path

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """The window, or the whole page, as PNG."""
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def close(self) -> None:
        """Close the tab."""
        self.browser.call("Target.closeTarget", targetId=self._target)


@contextmanager
def chromium() -> Iterator[Chromium]:
    """A browser with an empty profile. BrowserError where none is installed."""
    path = program()
    if path is None:
        raise BrowserError("Chromium is not installed (Debian: apt-get install chromium)")
    with tempfile.TemporaryDirectory(prefix="vsgdesign-chromium-", ignore_cleanup_errors=True) as folder:
        browser = Chromium(path, Path(folder))
        try:
            yield browser
        finally:
            browser.close()
