"""The objective of one cell (:eq:`cell-objective`), for the smooth program and for the search with exact results.

There is one formula and one set of weights. Its terms ``broken`` and ``reserve`` are measured in two ways, because the
two users have different needs. The program (:mod:`vsgdesign.design.nlp`) needs quantities that are smooth in the gains:
a slack for each requirement, and one share of the reserve. The settling time is not smooth, so the program holds the
response in a band at fixed times instead, in six scenarios. The search (:mod:`vsgdesign.design.search`) compares
designs from different starts by their exact results in all scenarios. With the program's measures, a design that leaves
the band between two of its instants would be preferred; with the search's measures, IPOPT would have no derivative
where the settling time jumps.
"""

from __future__ import annotations

from typing import Any

MARGIN_AIM = 1.15
"""More margin than this multiple of the least disk margin is not traded against inertia."""

GUARD_MARGIN = 1.03
"""Multiple of the required disk margin that a design has at a node, because filters and delay reduce it by 1 to 2 %."""

MARGIN_RESERVE = 0.015
"""Largest reduction of this factor where a requirement would be violated otherwise."""

WEIGHT_BROKEN, WEIGHT_MARGIN = 300.0, 30.0
"""Weights w_s of what is violated and w_α of missing margin; inertia, in natural logarithms, has the weight 1."""

WEIGHT_DAMPING = 0.2
"""Weight of the logarithms of damping and bandwidth with ``aim = "inertia"``: no more of both than needed."""


def cell_objective(price: Any, broken: Any, reserve: Any, short: Any, away: Any) -> Any:
    """The objective from its five terms (:eq:`cell-objective`), numbers or CasADi expressions.

    ``price``: −ln H, or WEIGHT_DAMPING times the logarithms of damping and bandwidth. ``broken``: the sum of what the
    requirements are violated by, relative. ``reserve``: the used reserve, weighted. ``short``: the missing margin.
    ``away``: the weighted squared distance to the centre.
    """
    return price + WEIGHT_BROKEN * broken + reserve + WEIGHT_MARGIN * short + away
