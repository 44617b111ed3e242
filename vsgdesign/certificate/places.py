"""A proof with a function of its own for every place of the grid, where one for all places does not exist or is slow.

While the grid stays in a place, that place's function falls whatever the estimate, its gains and the powers do. A move
of the grid to another place takes over at most ``factor`` times the value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.certifying import certify
from vsgdesign.certificate.lyapunov import move_factor
from vsgdesign.certificate.region import Region
from vsgdesign.certificate.results import (
    GAP_FREE,
    Certificate,
    Counterexample,
    NoFunctionError,
    Places,
    refusal_record,
)
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_RATIO = 2.0
"""Largest over least SCR of a place to begin with."""

_NARROW = 1.3
"""The same below which a place is cut along X/R and no longer along its SCR."""

_HALVINGS = 4
"""How often a place is cut in half where it has no function, or none that is proved."""

_SHARES = (0.6,)
"""Shares of the decay at the points that are tried in the proof between the points of a place."""

_BUDGET = 400_000
"""Boxes for one place; where they are not enough, its halves need fewer."""

_NODES, _FRESH = 5, 4_000
"""Nodes per axis and random points at which a place is verified."""


def by_place(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    *,
    budget: int = 1_500_000,
    progress: Callable[[str, float], None] | None = None,
    **options: Any,
) -> Certificate | Places | Counterexample:
    """A proof over the region with a function for every place (:eq:`place-certificate`); the certificate itself where
    one place is enough, or where the grid moves slowly.

    Places are bands of the SCR of equal ratio. One that has no function, or none that is proved between the points, is
    cut in half. ``budget``: boxes for all of them. ``options`` are those of
    :func:`~vsgdesign.certificate.certify`, and so are the errors.
    """
    if np.isfinite(region.rate):
        return certify(study, spec, region, budget=budget, progress=progress, **options)
    waiting = [(part, 0) for part in reversed(_bands(region))]
    proved: list[Certificate] = []
    left, whole = budget, float(np.log(region.scr[1] / region.scr[0])) or 1.0
    while waiting:
        part, halvings = waiting.pop()
        boxes = min(_BUDGET, left)
        again = halvings < _HALVINGS and _halves(part) is not None
        found: Any = None
        try:
            settings = {"nodes_per_axis": _NODES, "fresh": _FRESH, "shares": _SHARES, "placed": True} | options
            found = certify(study, spec, part, budget=boxes, **settings)
        except InfeasibleStudyError:
            if not again:
                raise
        if isinstance(found, Counterexample):
            return replace(found, region=region)
        if found is not None:
            left = max(left - 2 * found.boxes, 0)
        if found is None or (again and found.boxes and found.proof != GAP_FREE):
            waiting += [(half, halvings + 1) for half in reversed(_halves(part) or ())]
            continue
        proved.append(found)
        if progress is not None:
            done = sum(float(np.log(one.region.scr[1] / one.region.scr[0])) for one in proved)
            progress("certificate", min(done / whole, 1.0))
    if len(proved) == 1:
        return proved[0]
    functions, factor = joined([part.P[0] for part in proved])
    parts = (replace(part, P=P[None]) for part, P in zip(proved, functions, strict=True))
    return Places(region=region, parts=tuple(parts), factor=factor)


def of_a_pair(
    study: Study, spec: ControllerSpec, region: Region, **options: Any
) -> Certificate | Places | Counterexample:
    """What is proved of the units of a plant together, and of the units against each other (:eq:`plant-certificate`):
    ``differential`` of the result. ``options`` and errors: of :func:`by_place`."""
    found = by_place(study, spec, region, **options)
    if isinstance(found, Counterexample):
        return found
    try:
        apart = by_place(study, spec, region, apart=True, **options).as_record()
    except NoFunctionError as error:
        apart = refusal_record(str(error), region, error.slowest)
    return replace(found, differential=apart)


def _bands(region: Region) -> list[Region]:
    """The region cut along its SCR into bands of equal ratio."""
    low, high = region.scr
    count = max(int(np.ceil(np.log(high / low) / np.log(_RATIO) - 1e-9)), 1)
    cuts = [low, *(float(cut) for cut in np.geomspace(low, high, count + 1)[1:-1]), high]
    return [replace(region, scr=pair) for pair in pairwise(cuts)]


def _halves(region: Region) -> list[Region] | None:
    """Both halves of a place; None where there is nothing to cut."""
    name = "scr" if region.scr[1] > _NARROW * region.scr[0] else "x_over_r"
    low, high = getattr(region, name)
    if not high > low:
        return None
    middle = float(np.sqrt(low * high))
    return [replace(region, **{name: pair}) for pair in ((low, middle), (middle, high))]


def joined(functions: list[Array]) -> tuple[list[Array], float]:
    """Functions P (n, n) with factors of their own such that a move from any of them to any other takes over at most
    μ times the value, μ as small as any factors make it; and μ (:eq:`place-move`)."""
    from scipy.optimize import linprog

    count = len(functions)
    rows, bounds = [], []
    for i, here in enumerate(functions):
        half = np.linalg.inv(np.linalg.cholesky(here))
        for k, there in enumerate(functions):
            if i != k:
                # ln μ_ik + s_k − s_i ≤ ln μ for a move from i to k
                row = np.zeros(count + 1)
                row[i], row[k], row[-1] = -1.0, 1.0, -1.0
                rows.append(row)
                bounds.append(-float(np.log(np.linalg.eigvalsh(half @ there @ half.T)[-1])))
    cost = np.zeros(count + 1)
    cost[-1] = 1.0
    limits = [(0.0, 0.0), *[(None, None)] * (count - 1), (0.0, None)]
    found = linprog(cost, np.array(rows), np.array(bounds), bounds=limits)
    scaled = [P * float(np.exp(s)) for P, s in zip(functions, found.x[:-1], strict=True)]
    return scaled, move_factor(scaled)  # what the solver returns is not believed
