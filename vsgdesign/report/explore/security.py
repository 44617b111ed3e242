"""Who may ask the explorer what: a page of its own, on this machine, with the address that was printed.

The server listens on the loopback address alone. Any page in the user's browser can still send requests there, and
any name can be made to point there. So every request needs the random token in its path, the ``Host`` of this server,
and, if it says an ``Origin``, this server's.
"""

from __future__ import annotations

import hmac
import json
import math
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

HOST = "127.0.0.1"
BODY_LIMIT = 65_536
"""Largest body of a request, bytes. A state of the page has about one thousand."""
NAME_LIMIT = 64
"""Longest name of a browser tab."""
SEQUENCE_LIMIT = 2**53
"""Beyond this, JavaScript's numbers are no longer exact integers."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The content security policy of the page: nothing is loaded from anywhere else, and nobody shows it in a frame."""


class RefusedError(Exception):
    """A request that is not answered. ``status`` is that of HTTP."""

    def __init__(self, status: int, text: str) -> None:
        self.status = status
        super().__init__(text)


@dataclass(frozen=True)
class Gate:
    """What a request must say to come in."""

    port: int
    token: str

    @staticmethod
    def at(port: int) -> Gate:
        """A gate with a new random token of 128 bits."""
        return Gate(port, secrets.token_urlsafe(16))

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def enter(self, path: str, hosts: Sequence[str], origins: Sequence[str]) -> str:
        """What a request asks for: its path behind the token, without the query.

        ``hosts`` and ``origins`` are all values of these headers. Raises RefusedError.
        """
        own = (f"{HOST}:{self.port}", f"localhost:{self.port}")
        if len(hosts) != 1 or hosts[0].lower() not in own:
            raise RefusedError(403, f"The host must be {' or '.join(own)}.")
        if len(origins) > 1 or any(origin.lower() not in [f"http://{host}" for host in own] for origin in origins):
            raise RefusedError(403, "The request comes from another page.")
        token, slash, name = path.partition("?")[0].removeprefix("/").partition("/")
        if not slash or not hmac.compare_digest(token.encode(), self.token.encode()):
            raise RefusedError(404, "There is nothing here. Use the address that vsgdesign explore has printed.")
        return name


def body_length(lengths: Sequence[str], encodings: Sequence[str]) -> int:
    """The length of a body in bytes, from all values of the headers that tell it. Raises RefusedError."""
    if encodings or len(lengths) != 1:
        raise RefusedError(411, "The request must say its length once.")
    if not (lengths[0].isascii() and lengths[0].isdigit()) or len(lengths[0]) > 15:
        raise RefusedError(400, "Content-Length must be a number of bytes.")
    length = int(lengths[0])
    if length > BODY_LIMIT:
        raise RefusedError(413, f"The request has {length} bytes; the limit is {BODY_LIMIT}.")
    return length


@dataclass(frozen=True)
class Wish:
    """One request of a tab of the browser."""

    tab: str
    seq: int
    """It grows from wish to wish of a tab, so that a newer one is known."""
    state: dict[str, Any]
    """The state of the page. It is not checked yet."""


def wish_of(body: bytes) -> Wish:
    """The request in a body of JSON. Raises RefusedError for anything else."""
    try:
        document = json.loads(body.decode("utf-8"), parse_constant=_not_finite, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise RefusedError(400, f"The body is not JSON: {str(error)[:200]}.") from None
    if not isinstance(document, dict):
        raise RefusedError(400, 'The body must be a JSON object with "tab", "seq" and "state".')
    unknown = sorted(set(document) - {"tab", "seq", "state"})
    if unknown:
        raise RefusedError(400, f"Unknown in the body: {', '.join(name[:NAME_LIMIT] for name in unknown[:5])}.")
    tab, seq, state = document.get("tab"), document.get("seq"), document.get("state")
    if not isinstance(tab, str) or not 0 < len(tab) <= NAME_LIMIT:
        raise RefusedError(400, f'"tab" must be a text of 1 to {NAME_LIMIT} characters.')
    if isinstance(seq, bool) or not isinstance(seq, int) or not 0 <= seq < SEQUENCE_LIMIT:
        raise RefusedError(400, '"seq" must be an integer from 0 on.')
    if not isinstance(state, dict):
        raise RefusedError(400, '"state" must be an object.')
    return Wish(tab, seq, state)


def _not_finite(text: str) -> NoReturn:
    raise ValueError(f"{text} is no number of JSON")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is too large")
    return value
