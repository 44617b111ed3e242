"""The file of a full-order proof: what it keeps is what the search decided, and a changed file is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.design.full_order_problems import closed_form
from vsgdesign.artifacts.proof_file import CUTS, EMPTY, LEFT, PROOF_FILE, PROVED, ProofFile, packed, unpacked
from vsgdesign.certificate.full_order.cells import Arcs
from vsgdesign.certificate.full_order.record import arrays_of
from vsgdesign.certificate.full_order.search import Found, beginning, search
from vsgdesign.errors import ArtifactError


def boxes_of(arrays: dict[str, Any]) -> list[tuple[Any, Any, int]]:
    """Limits and symbol of every leaf, one box after another."""
    level = [(row[:6].copy(), row[6:].copy()) for row in arrays["roots"]]
    symbols, leaves = iter(arrays["tree"].tolist()), []
    while level:
        following = []
        for low, high in level:
            symbol = next(symbols)
            if symbol >= CUTS:
                leaves.append((low, high, symbol))
                continue
            middle = 0.5 * (low[symbol] + high[symbol])
            for side in range(2):
                own_low, own_high = low.copy(), high.copy()
                (own_high if side == 0 else own_low)[symbol] = middle
                following.append((own_low, own_high))
        level = following
    assert next(symbols, None) is None
    return leaves


def test_the_tree_has_every_box_of_the_search_and_the_rest_is_left() -> None:
    _, problem = closed_form()
    roots = [one for one in beginning(problem) if 0.4 < one.low[0] <= 0.45][:2]
    found = Found()
    search(problem, roots, found, most_looks=300)
    coarse = Arcs.coarsest(problem.loop.T_s).edges
    arrays = unpacked(packed(arrays_of(roots, problem.pieces, found, coarse)))
    leaves = boxes_of(arrays)
    for symbol, parts in ((PROVED, found.boxes), (EMPTY, found.nothing)):
        wanted = {tuple(np.round([*a, *b], 10)) for part in parts for a, b in zip(part.low, part.high, strict=True)}
        own = {tuple(np.round([*a, *b], 10)) for a, b, label in leaves if label == symbol}
        assert own == wanted
    assert {label for _, _, label in leaves} == {PROVED, EMPTY, LEFT}
    # Every cell with a proved box has its arcs, which end where those of the beginning end.
    cells = {tuple(np.round([*a[:2], *b[:2]], 10)) for a, b, label in leaves if label == PROVED}
    assert len(arrays["cells"]) == len(cells)
    share = 0.5 ** arrays["arcs"].astype(float)
    assert share.sum() == pytest.approx(len(cells) * (len(coarse) - 1))


def a_file() -> ProofFile:
    arrays = {"roots": np.zeros((1, 12)), "estimates": np.ones((1, 4)), "tree": [PROVED]}
    block = packed(
        {name: np.array(value) for name, value in (arrays | {"cells": np.zeros((1, 5)), "arcs": [0, 0]}).items()}
    )
    return ProofFile(
        study="s",
        study_hash="h",
        scr_basis="impedance",
        table="",
        statement={"decay": 0.5},
        coarse_arcs=(0.0, 1.0, 9.0),
        blocks=(block,),
    )


def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.proof"
    PROOF_FILE.write(a_file(), path)
    assert PROOF_FILE.read(path) == a_file()
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"decay": 0.5', '"decay": 0.6'), encoding="utf-8")
    with pytest.raises(ArtifactError, match="does not match its sha256"):
        PROOF_FILE.read(path)
    with pytest.raises(ArtifactError, match="is not a full-order proof as it was written"):
        PROOF_FILE.check_target(path)


def test_arrays_that_are_none_are_named() -> None:
    broken = ProofFile(**(vars(a_file()) | {"blocks": ({**a_file().blocks[0], "arcs": "!"},), "coarse_arcs": (1.0,)}))
    with pytest.raises(ArtifactError, match=r"(?s)coarse_arcs: must increase.*blocks\[0\].arcs: is not a packed array"):
        PROOF_FILE.write(broken, "out/never.proof")
