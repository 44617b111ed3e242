"""A converter for the tests of disturbances: the published one, angle-damped, with its inner loops made robust."""

from __future__ import annotations

from vsgdesign.simulation.survival import Subject
from vsgdesign.study.parameters import study_from_text

TEXT = """
base = "case:hoang2025_5kva"
[converter]
current_limit_pu = 1.2
[inner_loops]
transient_resistance_pu = 0.08
[power_loops]
structure = "angle_damped"
tau_P = "5 ms"
tau_Q = "5 ms"
P_droop = "5 %"
Q_droop = "5 %"
[grid]
scr_basis = "impedance"
scr = 5
x_over_r = 3
[simulation]
duration = "1 s"
P_ref = 0
Q_ref = 0
[[controllers]]
name = "scheduled"
kind = "scheduled"
[[controllers]]
name = "fixed"
kind = "fixed"
"""


def subject(text: str = TEXT, controller: int = 0, limit_pu: float = 1.2, **changed: str) -> Subject:
    """A subject of the text above; ``changed`` replaces lines of it by their keys."""
    for key, value in changed.items():
        text = "\n".join(f"{key} = {value}" if line.startswith(f"{key} =") else line for line in text.splitlines())
    study = study_from_text(text)
    return Subject(study=study, spec=study.controllers[controller], limit_pu=limit_pu)
