"""What goes between the page and its server: who may ask what, and an answer as bytes.

The server listens on the loopback address alone. Any page in the user's browser can still send requests there, and
any name can be made to point there. So every request needs the random token in its path, the ``Host`` of this server,
and, if it says an ``Origin``, this server's.

An answer has numbers for a table in a header, and curves as arrays. Of a run few rows are drawn, and every minimum and
maximum stays.
"""

from __future__ import annotations

import hmac
import json
import math
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import plain

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


LENGTH_BYTES = 4
"""Bytes before the header; they contain its length."""


def never() -> bool:
    """Nothing overtakes this answer."""
    return False


@dataclass(frozen=True)
class Answer:
    """What a session says about one state."""

    header: Mapping[str, Any]
    """Figures and words, in JSON's types. A number that is not finite becomes null."""
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Curves and maps by name. They are sent as 32-bit floats; NaN says that there is no value."""


def as_bytes(answer: Answer, **more: Any) -> bytes:
    """An answer as it is sent: the length of the header (uint32), the header as JSON, and the arrays one after another
    (float32). All numbers are little endian. ``more`` is added to the header.

    The header's ``arrays`` lists name, shape and offset (bytes from the end of the header) of every array. Blanks at
    the end of the header place the arrays at a multiple of four bytes, as a typed array of JavaScript needs it.
    """
    import numpy as np

    listed, blocks, offset = [], [], 0
    for name, values in answer.arrays.items():
        block = np.ascontiguousarray(values, dtype="<f4")
        listed.append({"name": name, "shape": list(block.shape), "offset": offset})
        blocks.append(block.tobytes())
        offset += block.nbytes
    document = plain({**answer.header, **more, "arrays": listed})
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % LENGTH_BYTES)
    return b"".join([len(text).to_bytes(LENGTH_BYTES, "little"), text, *blocks])


def joined_emt(parts: Sequence[tuple[Sequence[int], Answer]]) -> Answer:
    """The answer of its parts, each with its places."""
    listed = [pair for places, part in parts for pair in zip(places, part.header["controllers"], strict=True)]
    arrays = {name: values for _, part in parts for name, values in part.arrays.items()}
    rows = [row for _, row in sorted(listed, key=lambda pair: pair[0])]
    names = sorted(arrays, key=lambda name: int(name.partition("/")[0]))
    return emt_of_rows(rows, parts[0][1].header["bands"], {name: arrays[name] for name in names})


def emt_of_rows(rows: list[dict[str, Any]], limits: list[dict[str, Any]], arrays: dict[str, Any]) -> Answer:
    """The answer of the rows of the controllers, of bands and limits, and of curves."""
    reasons = {row["why"] for row in rows}
    words = reasons.pop() if not arrays and len(reasons) == 1 else ""
    return Answer({"event_s": 0.0, "controllers": rows, "bands": limits, "words": words}, arrays)


Array = NDArray[np.float64]

MOST = 800
"""Rows that are drawn at most."""

_BUCKETS = 320
_SMALLEST = 2e-3
"""A turning point that sticks out of its bucket's ends by less than this share of the whole range is not kept for
itself: it is a fraction of a pixel."""


def thinned(signals: Sequence[Array], most: int = MOST) -> NDArray[np.intp]:
    """Rows, in ascending order and at most ``most``, with which all ``signals`` (n each) can be drawn.

    The rows are divided into buckets of equal length. The first row of each bucket stays, and so do the rows of its
    minimum and maximum of a signal where these stick out of the bucket. The first and the last row and the rows of
    every signal's own minimum and maximum always stay, unless ``most`` is smaller than these.
    """
    n = len(signals[0])
    if n <= most:
        return np.arange(n)
    values = np.stack([np.asarray(signal, dtype=float) for signal in signals])
    always = np.unique([0, n - 1, *np.argmin(values, axis=1), *np.argmax(values, axis=1)])
    buckets = min(_BUCKETS, most // 2)
    while True:
        rows = np.union1d(always, _rows(values, max(-(-n // buckets), 2)))
        if len(rows) <= most or buckets <= 8:
            return rows if len(rows) <= most else always
        buckets = min(int(0.95 * buckets * most / len(rows)), buckets - 1)


def _rows(values: Array, length: int) -> NDArray[np.intp]:
    """First rows of the buckets of ``length`` rows, and those of their extremes that stick out of them."""
    signals, n = values.shape
    count = n // length
    parts = values[:, : count * length].reshape(signals, count, length)
    starts = np.arange(count) * length
    # A bucket is left towards the first row of the next one, which is drawn, too.
    following = np.minimum(starts + length, n - 1)
    ends = np.stack([values[:, starts], values[:, following]])
    slack = _SMALLEST * np.ptp(values, axis=1)[:, None]
    found = [starts, np.arange(count * length, n, length)]
    for pick, sticks in ((parts.argmin(axis=2), -1.0), (parts.argmax(axis=2), 1.0)):
        extreme = np.take_along_axis(parts, pick[:, :, None], axis=2)[:, :, 0]
        out = (sticks * extreme[None] > sticks * ends + slack).all(axis=0)
        found.append((starts[None, :] + pick)[out])
    return np.unique(np.concatenate(found))
