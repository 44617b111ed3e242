"""Writes the generated C again that is kept for reviews: ``python -m tests.export.golden``."""

from __future__ import annotations

from pathlib import Path

from vsgdesign.export.laws import laws

PLACE = Path(__file__).with_name("laws.h")


def text() -> str:
    """The laws of an angle-damped table with constant poles, SCR on the impedance."""
    return laws("angle_damped", "poles", "impedance", "circular").text


if __name__ == "__main__":
    PLACE.write_text(text(), encoding="ascii")
