"""The HTTP server of the explorer: loopback only, and fast enough that one may drag.

Two settings decide the speed. Without Nagle's algorithm and with one write for each response a round trip takes
0.2 ms; with Python's defaults it takes 44 ms. Connections are kept open.
"""

from __future__ import annotations

import json
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from vsgdesign.artifacts.files import plain
from vsgdesign.errors import VsgDesignError
from vsgdesign.report.explore.wire import HOST, POLICY, Gate, RefusedError, as_bytes, body_length, wish_of

if TYPE_CHECKING:
    from vsgdesign.report.explore.session import Session


TABS = 256
"""Pairs of tab and kind that are remembered. Beyond this, the one that was silent longest is forgotten."""


class Latest:
    """The newest sequence number of every tab and kind. Tabs count on their own, or two would starve each other."""

    def __init__(self) -> None:
        self._newest: OrderedDict[tuple[str, str], int] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Number of pairs of tab and kind."""
        return len(self._newest)

    def arrived(self, tab: str, kind: str, seq: int) -> Callable[[], bool]:
        """Notes a request, and returns a function that says whether a newer one has arrived since."""
        key = tab, kind
        with self._lock:
            self._newest[key] = max(seq, self._newest.get(key, seq))
            self._newest.move_to_end(key)
            while len(self._newest) > TABS:
                self._newest.popitem(last=False)

        def stale() -> bool:
            with self._lock:
                return seq < self._newest.get(key, seq)

        return stale


PAGE = Path(__file__).with_name("page")
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    "": "text/plain; charset=utf-8",
}
KINDS = ("linear", "modes", "emt", "map")
POSTED = (*KINDS, "save")
NOTHING_HERE = RefusedError(404, "There is nothing here.")
ALWAYS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every response. No address, and no token in it, goes to another site."""
BINARY, JSON = "application/octet-stream", "application/json"
WAIT_S = 2.0
"""How long a request for the study waits before it says that the study is not ready."""
IDLE_S = 300.0
"""A connection without requests is closed after this time."""
POLL_S = 0.1
"""How often the server looks whether it is to end."""
DRAINED = 2**20
"""Bytes of a refused body that are read, so that the browser gets to read why."""


def page_files(folder: Path = PAGE) -> dict[str, Path]:
    """Every file of the page by its name in an address; nothing else is served."""
    found = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix in TYPES and not path.name.startswith((".", "_"))
    }
    return {"": found["index.html"], **found} if "index.html" in found else found


class Opening:
    """The session once it is ready; until then, what is being done."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._session: Session | None = None
        self._words = "Loading."
        self._failure = ""
        self.told = threading.Event()
        """Set once a page was told that there will be no answers."""

    def say(self, words: str) -> None:
        """What is being done, for the page that waits."""
        with self._changed:
            self._words = words
            self._changed.notify_all()

    def open(self, session: Session) -> None:
        """From now on there are answers."""
        with self._changed:
            self._session, self._words = session, ""
            self._changed.notify_all()

    def fail(self, text: str) -> None:
        """There will be no answers, and why."""
        with self._changed:
            self._failure = text
            self._changed.notify_all()

    def session(self, seconds: float) -> Session:
        """The session, for which this waits at most ``seconds``. Raises RefusedError."""
        with self._changed:
            self._changed.wait_for(lambda: self._session is not None or self._failure != "", seconds)
            if self._session is None:
                raise RefusedError(503, self._failure or self._words)
            return self._session

    def study(self) -> dict[str, Any]:
        """What the page learns of the study; while it waits, what is being done."""
        with self._changed:
            before = self._words
            self._changed.wait_for(lambda: self._session is not None or self._failure or self._words != before, WAIT_S)
            if self._session is None:
                if self._failure:
                    self.told.set()
                return {"ready": False, "words": self._failure or self._words, "failed": bool(self._failure)}
            session = self._session
        return {"ready": True, "words": session.words, **session.info()}


class ExplorerServer(ThreadingHTTPServer):
    """One page, one session, on one port of the loopback address. ``port`` 0 takes a free one."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 32

    def __init__(
        self,
        opening: Opening,
        port: int = 0,
        *,
        pages: Mapping[str, Path] | None = None,
        complain: Callable[[str], None] | None = None,
    ) -> None:
        """``complain`` takes the traceback of an answer that failed. Raises OSError if the port is taken."""
        super().__init__((HOST, port), _Handler)
        self.gate = Gate.at(self.server_port)
        self.opening = opening
        self.latest = Latest()
        self.pages = page_files() if pages is None else dict(pages)
        self.complain = complain or (lambda _text: None)
        self.locks = {kind: threading.Lock() for kind in KINDS}

    def begin(self) -> None:
        """Serve in a thread of its own until :meth:`end`."""
        threading.Thread(target=self.serve_forever, args=(POLL_S,), name="explorer", daemon=True).start()

    def end(self) -> None:
        """Stop serving, and free the port."""
        self.shutdown()
        self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away in the middle of an answer is no error."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    wbufsize = 2**16
    timeout = IDLE_S

    @property
    def explorer(self) -> ExplorerServer:
        """The server, which is one of this page."""
        return cast(ExplorerServer, self.server)

    def do_GET(self) -> None:
        self._answer({"study": self._study}, self._page)

    def do_POST(self) -> None:
        self._answer(dict.fromkeys(KINDS, self._numbers) | {"save": self._save}, self._nothing)

    def _answer(self, answers: Mapping[str, Callable[[str], None]], otherwise: Callable[[str], None]) -> None:
        self._read = self.command == "GET" and "Content-Length" not in self.headers
        try:
            gate, headers = self.explorer.gate, self.headers
            name = gate.enter(self.path, headers.get_all("Host", []), headers.get_all("Origin", []))
            answers.get(name, otherwise)(name)
        except RefusedError as refused:
            self._refuse(refused)
        except (ConnectionError, TimeoutError):
            self.close_connection = True

    def _page(self, name: str) -> None:
        path = self.explorer.pages.get(name)
        if path is None:
            raise RefusedError(405, "POST is needed.") if name in POSTED else NOTHING_HERE
        self._send(200, path.read_bytes(), TYPES[path.suffix])

    def _nothing(self, name: str) -> None:
        raise RefusedError(405, "GET is needed.") if name == "study" or name in self.explorer.pages else NOTHING_HERE

    def _study(self, _name: str) -> None:
        self._send_json(200, self.explorer.opening.study())

    def _numbers(self, kind: str) -> None:
        wish = wish_of(self._body())
        stale = self.explorer.latest.arrived(wish.tab, kind, wish.seq)
        session = self.explorer.opening.session(IDLE_S)

        def found() -> tuple[bytes, str] | None:
            with self.explorer.locks[kind]:
                if stale():
                    return None
                begin = time.perf_counter()
                answer = session.answer(kind, wish.state, stale)
                spent = 1e3 * (time.perf_counter() - begin)
            if answer is None or stale():
                return None
            return as_bytes(answer, seq=wish.seq, ms=spent), BINARY

        self._send_found(found)

    def _save(self, _name: str) -> None:
        wish = wish_of(self._body())
        session = self.explorer.opening.session(IDLE_S)
        self._send_found(lambda: (_json(session.save(wish.state)), JSON))

    def _send_found(self, find: Callable[[], tuple[bytes, str] | None]) -> None:
        """Sends what is found: nothing where the request is stale, and the faults of a state that is wrong."""
        try:
            found = find()
        except VsgDesignError as error:
            from vsgdesign.report.explore.state import StateError  # loaded long ago: a state was read

            words = {"field": None, "value": None, "limit": "", "unit": "", "text": str(error)}
            faults = error.faults if isinstance(error, StateError) else [words]
            self._send_json(422, {"faults": faults})
        except Exception as error:
            self.explorer.complain(traceback.format_exc())
            raise RefusedError(500, f"{type(error).__name__}: {str(error)[:300]}") from error
        else:
            body, kind = (b"", BINARY) if found is None else found
            self._send(204 if found is None else 200, body, kind)

    def _body(self) -> bytes:
        headers = self.headers
        length = body_length(headers.get_all("Content-Length", []), headers.get_all("Transfer-Encoding", []))
        body = self.rfile.read(length)
        self._read = True
        if len(body) < length:
            raise RefusedError(400, "The body is shorter than its Content-Length.")
        return body

    def _refuse(self, refused: RefusedError) -> None:
        if not self._read:  # what is left of the request is not worth reading, and must not be taken for the next one
            self.close_connection = True
            self._drain()
        self._send_json(refused.status, {"error": str(refused)})

    def _drain(self) -> None:
        lengths = self.headers.get_all("Content-Length", [])
        if len(lengths) == 1 and lengths[0].isascii() and lengths[0].isdigit() and len(lengths[0]) < 10:
            left = min(int(lengths[0]), DRAINED)
            while left > 0 and (read := self.rfile.read1(min(left, 2**16))):
                left -= len(read)

    def _send_json(self, status: int, document: Any) -> None:
        self._send(status, _json(document), JSON)

    def _send(self, status: int, body: bytes, kind: str) -> None:
        self.send_response(status)
        if status != 204:
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
        for name, value in ALWAYS.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)
        self.wfile.flush()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the library refuses by itself, such as an unknown method, in the form of every other refusal."""
        self.close_connection = True
        self._send_json(code, {"error": explain or message or self.responses.get(code, ("It is not answered.",))[0]})

    def version_string(self) -> str:
        return "vsgdesign"

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not written to the terminal."""


def _json(document: Any) -> bytes:
    return json.dumps(plain(document), ensure_ascii=False, allow_nan=False).encode()
