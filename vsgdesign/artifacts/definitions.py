"""What a figure is called and what it means: one name and one meaning in every file and on every page.

The keys are the names in JSON, CSV and gain tables, and the titles are the words of pages and terminals. A page takes
its words from here. docs/definitions.md explains each figure and lists where it is shown.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

MORE_THAN_HARDWARE = "more than hardware carries"
"""What is said beside "survived" of a current above :data:`vsgdesign.metrics.survival.HARDWARE_PU`."""


@dataclass(frozen=True)
class Definition:
    """One figure: its words, its unit, what it means, and the one function that computes it."""

    title: str
    unit: str
    meaning: str
    function: str
    """Its dotted name."""

    @property
    def heading(self) -> str:
        """The title as a heading or as the name of a column."""
        return self.title[:1].upper() + self.title[1:]


_MARGINS = "vsgdesign.linear.stability.margins.margins_named"
_DAMPING = "vsgdesign.metrics.modes.least_damping"

DEFINITIONS: Mapping[str, Definition] = {
    "disk_margin_output": Definition(
        "disk margin at the output",
        "1",
        "disk margin of both loops at once, broken at the measured P and Q; a specification asks for this one",
        _MARGINS,
    ),
    "disk_margin_input": Definition(
        "disk margin at the input",
        "1",
        "the same, broken at the angle and the magnitude of the voltage, with which the power loops move the plant",
        _MARGINS,
    ),
    "disk_margin_smaller": Definition(
        "smaller disk margin",
        "1",
        "the smaller of those at the output and at the input, which gain tables of earlier versions hold",
        _MARGINS,
    ),
    "disk_margin_bridge": Definition(
        "disk margin at the bridge",
        "1",
        "disk margin of the inner loops alone, broken at the two components of the bridge voltage",
        "vsgdesign.design.inner.frozen.margins",
    ),
    "damping_power_loops": Definition(
        "damping ratio of the power loops",
        "1",
        "least damping ratio over the modes of the reduced model, which are those of the power loops, the power "
        "filters and the transient impedance with ideal inner loops; a specification asks for this one",
        _DAMPING,
    ),
    "damping_all_modes": Definition(
        "damping ratio of all modes",
        "1",
        "least damping ratio over all modes of the full-order model, those of filter, grid and inner loops included",
        _DAMPING,
    ),
    "damping_inner_loops": Definition(
        "damping ratio of the inner loops",
        "1",
        "least damping ratio over the modes of inner loops, filter and grid, while the angle and the voltage reference "
        "stand",
        _DAMPING,
    ),
}
"""Every figure by its name."""

NAMES_OF_BEFORE: Mapping[str, str] = {
    "disk_margin": "disk_margin_smaller",
    "worst_disk_margin": "worst_disk_margin_output",
    "least_damping": "damping_power_loops",
    "worst_least_damping": "worst_damping_power_loops",
}
"""Names in gain tables of earlier versions, which did not say where a disk margin is, and of which modes a damping."""

ASKED: Mapping[str, str] = {
    "settling_time": "settling time",
    "disk_margin": DEFINITIONS["disk_margin_output"].title,
    "damping_ratio": DEFINITIONS["damping_power_loops"].title,
    "H": "inertia constant",
    "H_min": "least inertia constant",
    "H_max": "largest inertia constant",
    "bandwidth_max": "largest k_2 and d_1",
    "differential_decay": "decay of the differential mode",
    "inner_loops": "inner loops",
}
"""What a field of a specification asks for, and what else limits a cell of a table, in words."""
_FIELD = re.compile(rf"\b({'|'.join(sorted(ASKED, key=len, reverse=True))})\b")


def in_words(text: str) -> str:
    """A text with the fields of a specification in words: what limits a cell, or what it misses."""
    return _FIELD.sub(lambda field: ASKED[field[0]], text)


REDUCED, FULL_ORDER = "reduced model", "full order"
"""The two linear models, in words."""
NOMINAL, WORST, BETWEEN = "design point", "worst of the box", "between the nodes"
"""Where a figure of a table is found, in words: at the table's P_design and Q_design on the exact grid; the worst over
the powers, the sources and the error set of the specification, in both models; on random grids between the nodes."""


def damping_of(model: str) -> str:
    """The name of the least damping ratio in a linear model, ``reduced`` or ``full_order``."""
    return {"reduced": "damping_power_loops", "full_order": "damping_all_modes"}[model]
