"""The colours of curves, of the map and of its marks stay apart for people who see fewer of them."""

from __future__ import annotations

import re
from itertools import combinations, pairwise

import numpy as np
import pytest

from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import COLOURS, OWN_COLOUR

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


DRAW, MAP = ((PAGE / name).read_text(encoding="utf-8") for name in ("draw.js", "map.js"))
SCHEMES = {"LIGHT": "ON_LIGHT", "DARK": "ON_DARK"}
APART = 10.0
"""CIELAB distance: 2.3 is just noticeable, and lines that cross or cells that touch need several times that."""


def constants(name: str) -> dict[str, str]:
    """Colours of a constant of the page's script, by name."""
    body = re.search(rf"const {name} = {{(.*?)}};", DRAW, re.DOTALL)
    assert body is not None, name
    found = {}
    for key, text, numbers in re.findall(r'"?([#\w]+)"?: (?:"(#\w{6})"|\[([\d, ]+)\])', body[1]):
        found[key] = text or "#{:02x}{:02x}{:02x}".format(*(int(one) for one in numbers.split(",")))
    return found


def curves(scheme: str) -> list[str]:
    """The controllers' colours as the page draws them."""
    drawn = constants(SCHEMES[scheme])
    return [drawn.get(colour.upper(), colour) for colour in (*COLOURS, OWN_COLOUR)]


def levels(scheme: str) -> list[str]:
    """The map's colours from the worst value over the promise to the best, an eighth of the scale apart (map.js)."""
    theme = constants(scheme)
    knots = [theme[name] for name in ("bad", "badHalf", "middle", "goodHalf", "good")]
    found = []
    for share in np.linspace(0.0, 4.0, 9):
        k = min(int(share), 3)
        a, b = ([int(knots[n][c : c + 2], 16) for c in (1, 3, 5)] for n in (k, k + 1))
        mixed = (round(x + (y - x) * (share - k)) for x, y in zip(a, b, strict=True))
        found.append("#{:02x}{:02x}{:02x}".format(*mixed))
    return found


def apart(a: str, b: str, who: str) -> float:
    return float(np.linalg.norm(lab(a, SEEN[who]) - lab(b, SEEN[who])))


def luminance(colour: str) -> float:
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return float(np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722))


everybody = pytest.mark.parametrize("who", list(SEEN))
both = pytest.mark.parametrize("scheme", list(SCHEMES))


@everybody
@both
def test_colours_of_controllers_differ_for_everybody(scheme: str, who: str) -> None:
    """Before, for one without green: 2.1 between the second and the fifth. Markers differ beside it."""
    distances = {(a, b): apart(a, b, who) for a, b in combinations(curves(scheme), 2)}
    assert min(distances.values()) > APART, sorted(distances.items(), key=lambda one: one[1])[:3]


@both
def test_curves_have_a_contrast_to_their_ground(scheme: str) -> None:
    ground = luminance(constants(scheme)["back"])
    for colour in curves(scheme):
        low, high = sorted((luminance(colour), ground))
        assert (high + 0.05) / (low + 0.05) >= 3.0, colour


@everybody
@both
def test_levels_of_the_map_differ_for_everybody(scheme: str, who: str) -> None:
    """Neighbouring levels, and those as far on both sides of the promise: worse is never taken for better."""
    shades = levels(scheme)
    for a, b in [*pairwise(shades), *zip(shades[:4], shades[:4:-1], strict=True)]:
        assert apart(a, b, who) > APART, (a, b)


@everybody
@both
def test_cells_without_a_figure_are_no_level(scheme: str, who: str) -> None:
    """Before: 6.6 between no operating point and the promise."""
    theme = constants(scheme)
    for one in (theme["none"], theme["unstable"]):
        for shade in levels(scheme):
            assert apart(one, shade, who) > APART, (one, shade)
    assert apart(theme["none"], theme["unstable"], who) > APART


@everybody
@both
def test_marks_are_seen_on_every_cell(scheme: str, who: str) -> None:
    """The line of the promise, nodes and the proved region on the cells themselves; the red line of the static limit
    has a casing. Before: 1.5 between this line and the worst cells."""
    theme = constants(scheme)
    cells = [*levels(scheme), theme["none"], theme["unstable"]]
    for shade in cells:
        assert apart(theme["black"], shade, who) > APART, shade
        assert apart(theme["text"], shade, who) > APART, shade
        assert max(apart(theme["limit"], shade, who), apart(theme["back"], shade, who)) > APART, shade
    assert apart(theme["limit"], theme["back"], who) > 2 * APART
    assert "colour: t.limit, width: 2.2, casing: t.back" in MAP


def test_a_pair_that_is_easily_confused_is_found() -> None:
    red, green = "#C00000", "#5A7A00"
    assert np.linalg.norm(lab(red, SEEN["all colours"]) - lab(green, SEEN["all colours"])) > 60.0
    assert (
        np.linalg.norm(lab(red, SEEN["no green (deuteranopia)"]) - lab(green, SEEN["no green (deuteranopia)"])) < 40.0
    )
