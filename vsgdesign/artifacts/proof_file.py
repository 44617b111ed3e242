"""The file of a proof of the sampled full-order loop: the tree of boxes and the arcs behind what a statement says."""

from __future__ import annotations

import base64
import binascii
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import sorted_plain
from vsgdesign.artifacts.gain_table import GainTable, table_document
from vsgdesign.artifacts.guarded_file import GuardedFile, content_hash, is_number

KIND = "vsgdesign full-order proof"
SCHEMA = 1
SUFFIX = ".proof"

CUTS = 6
"""Symbols of a tree below it are cuts, in the coordinate of this number."""
PROVED, EMPTY, LEFT = 6, 7, 8
"""The symbols of a tree's leaves: proved, without a point that counts, or not decided."""

COLUMNS: dict[str, tuple[str, int]] = {
    "roots": ("<f8", 12),
    "estimates": ("<f8", 4),
    "tree": ("u1", 1),
    "cells": ("<i4", 5),
    "arcs": ("u1", 1),
}
"""Arrays of a block: their type, and how many numbers a row has (docs/gain-table-file.md)."""

_MOST_UNPACKED = 500_000_000


@dataclass(frozen=True, kw_only=True)
class ProofFile:
    """A statement with what proves it.

    ``statement`` is that of :class:`vsgdesign.certificate.FullOrderProof`. ``table``: hash of what a gain table makes
    its gains of (:func:`proved_table`); empty where they are those of a closed form. ``coarse_arcs``: edges in rad/s of
    the arcs that cells begin with. ``blocks``: arrays of COLUMNS, packed by :func:`packed`.
    """

    study: str
    study_hash: str
    scr_basis: str
    table: str
    statement: dict[str, Any]
    coarse_arcs: tuple[float, ...]
    blocks: tuple[dict[str, str], ...]
    apart: tuple[dict[str, str], ...] = ()
    """The same of units against each other; none where there is one converter."""


def packed(arrays: dict[str, NDArray[Any]]) -> dict[str, str]:
    """The arrays of a block as text."""
    found = {}
    for name, (kind, _) in COLUMNS.items():
        data = np.ascontiguousarray(arrays[name], dtype=kind).tobytes()
        found[name] = base64.b64encode(zlib.compress(data, 9)).decode()
    return found


def unpacked(block: dict[str, str]) -> dict[str, NDArray[Any]]:
    """The arrays of a block: (rows,) or (rows, numbers). Raises ValueError where a text is none of :func:`packed`."""
    found = {}
    for name, (kind, width) in COLUMNS.items():
        try:
            unpack = zlib.decompressobj()
            data = unpack.decompress(base64.b64decode(block[name], validate=True), _MOST_UNPACKED)
        except (binascii.Error, zlib.error) as error:
            raise ValueError(f"{name}: is not a packed array ({error})") from error
        array = np.frombuffer(data, dtype=kind)
        found[name] = array.reshape(-1, width) if width > 1 else array
    return found


def _document(value: ProofFile) -> dict[str, Any]:
    document = {"kind": KIND, "schema": SCHEMA, **vars(value)}
    if not value.apart:  # the same of one converter
        del document["apart"]
    return sorted_plain(document)


def _build(document: dict[str, Any]) -> ProofFile:
    names = ("study", "study_hash", "scr_basis", "table")
    texts = {name: document[name] for name in names}
    if not all(isinstance(text, str) for text in texts.values()):
        raise ValueError(f"{', '.join(names)} must be text")
    statement, arcs, blocks = (document[name] for name in ("statement", "coarse_arcs", "blocks"))
    apart = document.get("apart", ())
    if not isinstance(statement, dict) or not all(map(is_number, arcs)):
        raise ValueError("statement must be a table, and coarse_arcs numbers")
    if not all(isinstance(block[name], str) for block in (*blocks, *apart) for name in COLUMNS):
        raise ValueError("blocks must hold packed arrays")
    return ProofFile(
        statement=statement,
        coarse_arcs=tuple(map(float, arcs)),
        blocks=tuple(dict(b) for b in blocks),
        apart=tuple(dict(b) for b in apart),
        **texts,
    )


def _faults(value: ProofFile) -> Iterator[str]:
    edges = np.array(value.coarse_arcs)
    if len(edges) < 2 or edges[0] != 0.0 or not (np.diff(edges) > 0.0).all():
        yield "coarse_arcs: must increase from 0 rad/s"
    for name in ("blocks", "apart"):
        for k, block in enumerate(getattr(value, name)):
            try:
                unpacked(block)
            except ValueError as error:
                yield f"{name}[{k}].{error}"


PROOF_FILE: GuardedFile[ProofFile] = GuardedFile(
    kind=KIND,
    schema=SCHEMA,
    what="a full-order proof",
    origin='written by "vsgdesign certify --model full"',
    again="prove it again",
    document=_document,
    build=_build,
    faults=_faults,
)


def proof_of(file: str | Path) -> Path:
    """Where the proof of a gain table's file is: beside it."""
    return Path(file).with_suffix(SUFFIX)


_OF_GAINS = (
    *("structure", "law", "base", "D_p", "D_q", "P_design", "Q_design", "time_scale", "scr", "x_over_r", "columns"),
    *("validity", "safe_place"),
)
"""Of a gain table, what its gains and its scheduler's limits are made of, beside the region of its certificate."""


def proved_table(table: GainTable | None) -> str:
    """What a proof calls a table, by its gains alone: a certificate and a verification may come later. Empty for
    none."""
    if table is None:
        return ""
    document = table_document(table)
    own = {name: document.get(name) for name in _OF_GAINS}
    certificate = table.certificate
    if certificate is not None and certificate.certified:
        own["certified"] = certificate.document.get("region")
    return content_hash(own)


def content_of(value: ProofFile) -> str:
    """sha256 of a proof's file."""
    return content_hash(_document(value))
