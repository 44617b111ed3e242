"""The controllers' colours stay apart for people who see fewer of them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from vsgdesign.explore.colours import COLOURS

SEEN = {
    "all colours": np.eye(3),
    "no red (protanopia)": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green (deuteranopia)": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue (tritanopia)": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""Linear RGB as it is seen (Machado, Oliveira and Fernandes 2009, severity 1)."""
WHITE = np.array([0.95047, 1.0, 1.08883])
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def lab(colour: str, seen: np.ndarray) -> np.ndarray:
    """CIELAB of a colour as it is seen."""
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    share = TO_XYZ @ np.clip(seen @ linear, 0.0, 1.0) / WHITE
    f = np.where(share > (6 / 29) ** 3, np.cbrt(share), share * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("who", list(SEEN))
def test_colours_of_controllers_differ_for_everybody(who: str) -> None:
    """2.3 is just noticeable; lines that cross need several times that. Markers differ beside it."""
    distances = {
        (a, b): float(np.linalg.norm(lab(a, SEEN[who]) - lab(b, SEEN[who]))) for a, b in combinations(COLOURS[:4], 2)
    }
    assert min(distances.values()) > 10.0, distances


def test_a_pair_that_is_easily_confused_is_found() -> None:
    red, green = "#C00000", "#5A7A00"
    assert np.linalg.norm(lab(red, SEEN["all colours"]) - lab(green, SEEN["all colours"])) > 60.0
    assert (
        np.linalg.norm(lab(red, SEEN["no green (deuteranopia)"]) - lab(green, SEEN["no green (deuteranopia)"])) < 40.0
    )
