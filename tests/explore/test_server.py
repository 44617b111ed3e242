"""The explorer's server: who gets in, what is refused, and which answers are too old to be sent."""

from __future__ import annotations

import http.client
import json
import socket
import struct
import threading
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.report.explore.server import ALWAYS, PAGE, ExplorerServer, Opening, page_files
from vsgdesign.report.explore.state import StateError
from vsgdesign.report.explore.wire import BODY_LIMIT, Answer

_FAULTS = [{"field": "scr", "value": 0, "limit": "0.1 to 1000", "unit": "", "text": "scr = 0: outside"}]


class _Session:
    """Answers what a test wants: a state says by ``do`` what happens to it."""

    words = ""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.go_on = threading.Event()

    def info(self) -> dict[str, Any]:
        return {"study": {"name": "fake"}}

    def answer(self, kind: str, document: Mapping[str, Any], stale: Any) -> Answer | None:
        what = document.get("do")
        if what == "wait":
            self.begun.append(document["n"])
            self.go_on.wait(60.0)
            return None if stale() else Answer({"kind": kind})
        if what == "wrong":
            raise StateError(_FAULTS)
        if what == "cannot":
            raise InfeasibleStudyError("there is no such rest")
        if what == "break":
            raise ZeroDivisionError("a defect")
        return Answer(
            {"kind": kind, "none": float("nan")}, {"a": np.arange(6.0).reshape(2, 3), "b": np.array([np.nan])}
        )

    def save(self, document: Mapping[str, Any]) -> dict[str, str]:
        return {"name": "x.toml", "toml": str(document)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("explorer") / "page"
    folder.mkdir()
    (folder / "index.html").write_text("<p>page</p>", encoding="utf-8")
    (folder / "main.js").write_text("1", encoding="utf-8")
    (folder / ".hidden.js").write_text("hidden", encoding="utf-8")
    (folder / "code.py").write_text("code", encoding="utf-8")
    (folder.parent / "secret.html").write_text("secret", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def complaints() -> list[str]:
    return []


@pytest.fixture(scope="module")
def served(folder: Path, complaints: list[str]) -> Iterator[ExplorerServer]:
    opening = Opening()
    server = ExplorerServer(opening, pages=page_files(folder), complain=complaints.append)
    opening.open(_Session())  # pyright: ignore[reportArgumentType]
    server.begin()
    yield server
    server.end()


def _ask(
    server: ExplorerServer,
    method: str,
    name: str,
    body: Any = None,
    headers: Mapping[str, str] | None = None,
    path: str | None = None,
) -> tuple[int, bytes, http.client.HTTPMessage]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60.0)
    sent = body if body is None or isinstance(body, str | bytes) else json.dumps(body)
    connection.request(method, f"/{server.gate.token}/{name}" if path is None else path, sent, dict(headers or {}))
    response = connection.getresponse()
    found = response.status, response.read(), response.headers
    connection.close()
    return found


def _until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def _wish(number: int = 1, tab: str = "a", **state: Any) -> dict[str, Any]:
    return {"tab": tab, "seq": number, "state": state}


def test_the_page_and_its_files_are_served(served: ExplorerServer) -> None:
    status, body, headers = _ask(served, "GET", "")
    assert (status, body) == (200, b"<p>page</p>")
    assert headers["Content-Type"].startswith("text/html")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"  # the address contains the token
    assert headers["X-Content-Type-Options"] == "nosniff"
    status, body, headers = _ask(served, "GET", "main.js?x=1")
    assert (status, body) == (200, b"1")
    assert headers["Content-Type"].startswith("text/javascript")


OF_A_FILE = (
    *("file.js", "cells.js", "columns.js", "live.js", "live_map.js", "worker.js"),
    *("engine.js", "loops.js", "verdict.js", "rests.js", "words.js", "modes_of_rest.js", "linear.js"),
)


def test_the_whole_page_is_packaged_and_small() -> None:
    files = {path for name, path in page_files().items() if name}
    assert files == {path for path in PAGE.rglob("*") if path.is_file()}
    root = Path(__file__).resolve().parents[2]
    data = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-data"]
    packaged = {path for pattern in data["vsgdesign.report.explore"] for path in PAGE.parent.glob(pattern)}
    assert files == packaged
    # No server is asked for these.
    of_a_file = {PAGE / name for name in OF_A_FILE}
    assert of_a_file < files
    assert sum(path.stat().st_size for path in files - of_a_file) <= 150_000
    assert sum(path.stat().st_size for path in of_a_file) <= 120_000


def test_the_address_is_on_the_loopback_interface_and_its_token_is_random(served: ExplorerServer) -> None:
    assert served.server_address[0] == "127.0.0.1"
    other = ExplorerServer(Opening(), pages={})
    try:
        assert other.gate.token != served.gate.token
        assert len(other.gate.token) >= 22  # 128 bits in base 64
    finally:
        other.server_close()


@pytest.mark.parametrize("path", ["/", "/study", "/wrong/study", "/wrong/", "//study", ""])
def test_a_wrong_token_is_refused(served: ExplorerServer, path: str) -> None:
    status, body, _ = _ask(served, "GET", "", path=path)
    assert status == 404
    assert b"fake" not in body


def test_the_token_alone_is_no_address(served: ExplorerServer) -> None:
    assert _ask(served, "GET", "", path=f"/{served.gate.token}")[0] == 404


@pytest.mark.parametrize(
    "name",
    [
        "../secret.html",
        "..%2fsecret.html",
        "%2e%2e/secret.html",
        "./../secret.html",
        "page/../../secret.html",
        "..\\secret.html",
        "/etc/passwd",
        ".hidden.js",
        "code.py",
        "index.html%00.js",
    ],
)
def test_only_listed_files_are_served(served: ExplorerServer, name: str) -> None:
    status, body, _ = _ask(served, "GET", name)
    assert status == 404
    assert b"secret" not in body


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1", "localhost.evil.example", "[::1]"])
def test_another_host_is_refused(served: ExplorerServer, host: str) -> None:
    # A name of somebody else that points to this machine: the browser then says that name.
    assert _ask(served, "GET", "study", headers={"Host": host})[0] == 403
    assert _ask(served, "POST", "linear", _wish(), {"Host": host})[0] == 403


def test_both_names_of_this_machine_are_taken(served: ExplorerServer) -> None:
    for host in ("127.0.0.1", "localhost", "LOCALHOST"):
        assert _ask(served, "GET", "study", headers={"Host": f"{host}:{served.server_port}"})[0] == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"])
def test_another_origin_is_refused(served: ExplorerServer, origin: str) -> None:
    origin = origin.format(port=served.server_port)
    assert _ask(served, "POST", "linear", _wish(), {"Origin": origin})[0] == 403
    assert _ask(served, "GET", "study", headers={"Origin": origin})[0] == 403


def test_the_same_origin_is_taken(served: ExplorerServer) -> None:
    headers = {"Origin": f"http://127.0.0.1:{served.server_port}"}
    assert _ask(served, "POST", "linear", _wish(100), headers)[0] == 200


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"tab": "a", "seq": 1}',
        b'{"tab": "a", "seq": 1, "state": []}',
        b'{"tab": "a", "seq": "1", "state": {}}',
        b'{"tab": "a", "seq": true, "state": {}}',
        b'{"tab": "a", "seq": -1, "state": {}}',
        b'{"tab": "", "seq": 1, "state": {}}',
        b'{"tab": "a", "seq": 1, "state": {}, "more": 1}',
        b'{"tab": "a", "seq": 1, "state": {"scr": NaN}}',
        b'{"tab": "a", "seq": 1, "state": {"scr": Infinity}}',
        b'{"tab": "a", "seq": 1, "state": {"scr": 1e999}}',
        b'{"tab": "a", "seq": 1, "state": {"scr": ' + b"9" * 5000 + b"}}",
        b'{"tab": "a", "seq": 1, "state": {"scr": ' + b"[" * 20000 + b"}}",
        json.dumps({"tab": "a" * 65, "seq": 1, "state": {}}).encode(),
    ],
)
def test_a_malformed_body_is_refused(served: ExplorerServer, body: bytes, complaints: list[str]) -> None:
    status, answer, _ = _ask(served, "POST", "linear", body)
    assert status == 400
    assert json.loads(answer)["error"]
    assert complaints == []


def test_a_body_that_is_too_large_is_refused(served: ExplorerServer) -> None:
    body = json.dumps(_wish(1, text="x" * BODY_LIMIT))
    status, answer, headers = _ask(served, "POST", "linear", body)
    assert status == 413
    assert str(BODY_LIMIT) in json.loads(answer)["error"]
    assert headers["Connection"] == "close"


def test_a_body_needs_one_length(served: ExplorerServer) -> None:
    def raw(*headers: str) -> bytes:
        with socket.create_connection(("127.0.0.1", served.server_port), timeout=60.0) as one:
            lines = [f"POST /{served.gate.token}/linear HTTP/1.1", f"Host: 127.0.0.1:{served.server_port}", *headers]
            one.sendall("\r\n".join([*lines, "", ""]).encode())
            one.shutdown(socket.SHUT_WR)
            return one.recv(65536).partition(b"\r\n")[0]

    assert b"411" in raw()
    assert b"411" in raw("Transfer-Encoding: chunked")
    assert b"411" in raw("Content-Length: 2", "Content-Length: 3")
    assert b"400" in raw("Content-Length: -1")
    assert b"413" in raw("Content-Length: 99999999999")
    assert b"400" in raw("Content-Length: 10")  # and then nothing


@pytest.mark.parametrize(("method", "name"), [("POST", "study"), ("POST", ""), ("GET", "linear"), ("GET", "save")])
def test_another_method_is_refused(served: ExplorerServer, method: str, name: str) -> None:
    assert _ask(served, method, name, b"{}" if method == "POST" else None)[0] == 405


def test_unknown_methods_and_names_are_refused(served: ExplorerServer) -> None:
    assert _ask(served, "POST", "other", _wish())[0] == 404
    assert _ask(served, "OPTIONS", "linear")[0] == 501  # no other page learns that it may ask


@pytest.mark.parametrize("method", ["DELETE", "BREW", "HEAD"])
def test_what_the_library_refuses_has_the_form_of_every_refusal(served: ExplorerServer, method: str) -> None:
    """It was Python's own page, without the headers of the policy."""
    status, body, headers = _ask(served, method, "study")
    assert status == 501
    assert ALWAYS.items() <= dict(headers.items()).items()
    assert headers["Content-Type"] == "application/json"
    assert body == b"" if method == "HEAD" else "error" in json.loads(body)
    assert _ask(served, "GET", "study")[0] == 200


@pytest.mark.parametrize("line", [b"GET /x HTTP/7.0", b"GET " + b"x" * 70_000 + b" HTTP/1.1", b"a b c d HTTP/1.1"])
def test_a_request_that_is_none_is_refused_in_the_same_form(served: ExplorerServer, line: bytes) -> None:
    with socket.create_connection(("127.0.0.1", served.server_port), timeout=60.0) as one:
        one.sendall(line + b"\r\n\r\n")
        one.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: one.recv(65536), b""))
    assert "error" in json.loads(answer.partition(b"\r\n\r\n")[2] or answer)
    assert b"<html" not in answer.lower()


def test_an_answer_is_a_header_and_floats(served: ExplorerServer) -> None:
    status, body, headers = _ask(served, "POST", "map", _wish(7))
    assert status == 200
    assert headers["Content-Type"] == "application/octet-stream"
    (length,) = struct.unpack_from("<I", body)
    header = json.loads(body[4 : 4 + length])
    assert length % 4 == 0
    assert (header["kind"], header["seq"], header["none"]) == ("map", 7, None)
    assert header["arrays"][0] == {"name": "a", "shape": [2, 3], "offset": 0}
    a = np.frombuffer(body, "<f4", 6, 4 + length + header["arrays"][0]["offset"])
    b = np.frombuffer(body, "<f4", 1, 4 + length + header["arrays"][1]["offset"])
    np.testing.assert_array_equal(a, np.arange(6.0))
    assert np.isnan(b[0])


def test_the_faults_of_a_state_are_sent(served: ExplorerServer) -> None:
    status, body, _ = _ask(served, "POST", "linear", _wish(101, do="wrong"))
    assert status == 422
    assert json.loads(body) == {"faults": _FAULTS}


def test_an_error_without_a_field_is_a_fault_too(served: ExplorerServer) -> None:
    status, body, _ = _ask(served, "POST", "linear", _wish(102, do="cannot"))
    (fault,) = json.loads(body)["faults"]
    assert (status, fault["field"], fault["text"]) == (422, None, "there is no such rest")


def test_a_defect_is_said_and_the_server_goes_on(served: ExplorerServer, complaints: list[str]) -> None:
    status, body, _ = _ask(served, "POST", "emt", _wish(1, do="break"))
    assert status == 500
    assert "a defect" in json.loads(body)["error"]
    assert "Traceback" in complaints.pop()
    assert _ask(served, "POST", "emt", _wish(2))[0] == 200


def test_connections_stay_open_and_are_fast(served: ExplorerServer) -> None:
    # With Nagle's algorithm or with header and body in two writes a round trip takes 40 ms.
    connection = http.client.HTTPConnection("127.0.0.1", served.server_port, timeout=60.0)
    connection.connect()
    socket_before, spent = connection.sock, []
    for number in range(12):
        begin = time.perf_counter()
        connection.request("POST", f"/{served.gate.token}/linear", json.dumps(_wish(1000 + number)))
        response = connection.getresponse()
        assert response.status == 200
        response.read()
        spent.append(time.perf_counter() - begin)
    assert connection.sock is socket_before
    assert min(spent) < 0.02
    connection.close()


def test_an_overtaken_request_gets_no_answer(folder: Path) -> None:
    opening, session = Opening(), _Session()
    server = ExplorerServer(opening, pages=page_files(folder))
    opening.open(session)  # pyright: ignore[reportArgumentType]
    server.begin()
    found: dict[tuple[str, int], int] = {}

    def ask(number: int, tab: str) -> threading.Thread:
        def run() -> None:
            found[tab, number] = _ask(server, "POST", "emt", _wish(number, tab, do="wait", n=number))[0]

        thread = threading.Thread(target=run)
        thread.start()
        return thread

    try:
        first = [ask(1, "a")]
        _until(lambda: session.begun == [1])
        rest = [ask(2, "a"), ask(3, "a"), ask(1, "b")]
        for tab, number in (("a", 2), ("b", 0)):
            _until(server.latest.arrived(tab, "emt", number))
        session.go_on.set()
        for thread in first + rest:
            thread.join(10.0)
        # The first was at work and the second waited when the third came; the other tab counts on its own.
        assert found == {("a", 1): 204, ("a", 2): 204, ("a", 3): 200, ("b", 1): 200}
        assert 2 not in session.begun
    finally:
        server.end()


def test_until_the_study_is_ready_the_page_learns_what_is_done(folder: Path) -> None:
    opening = Opening()
    server = ExplorerServer(opening, pages=page_files(folder))
    server.begin()
    try:
        assert _ask(server, "GET", "")[0] == 200  # the page itself does not wait
        threading.Timer(0.05, opening.say, ["Designing the gain table of x."]).start()
        found = json.loads(_ask(server, "GET", "study")[1])
        assert found == {"ready": False, "failed": False, "words": "Designing the gain table of x."}
        threading.Timer(0.05, opening.fail, ["The study is wrong."]).start()
        found = json.loads(_ask(server, "GET", "study")[1])
        assert (found["failed"], found["words"]) == (True, "The study is wrong.")
        assert _ask(server, "POST", "linear", _wish())[0] == 503
        opening.open(_Session())  # pyright: ignore[reportArgumentType]
        found = json.loads(_ask(server, "GET", "study")[1])
        assert (found["ready"], found["study"]) == (True, {"name": "fake"})
    finally:
        server.end()
