"""The equations that an export needs as C, and the table's own structure and law among them."""

from __future__ import annotations

import functools
import typing
from collections.abc import Callable
from typing import Any

from vsgdesign.codegen import CText, c_functions
from vsgdesign.equations.controller import ControllerSettings, ControllerState, controller_step, power_stage
from vsgdesign.equations.following import part_of_the_way, share_that_fits
from vsgdesign.equations.grid import (
    error_half_widths,
    grid_from_scr_impedance,
    grid_from_scr_reactance,
    scr_impedance,
    scr_reactance,
)
from vsgdesign.equations.guarded_controller import LARGEST_STATE, TIMES_NOMINAL, plausible, skipped_step, sound
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.equations.limiters import Limiter, limiter_named
from vsgdesign.equations.power_filter import notch
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import PowerLoopGains, References, frequency_at_rest, gain_transfer
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.equations.synchronising import in_step, synchronised, watch_grid

NAMES = {
    PowerLoopGains: "gains",
    References: "references",
    InnerLoopGains: "inner_gains",
    NormalisedGains: "normalised",
}
"""What the public header calls a NamedTuple, where it is not its own name."""

PUBLIC = (
    "vsg_gains_t",
    "vsg_references_t",
    "vsg_inner_gains_t",
    "vsg_grid_estimate_t",
    "vsg_measurement_t",
    "vsg_controller_settings_t",
    "vsg_controller_state_t",
    "vsg_controller_state_lost_t",
    "vsg_controller_output_t",
    "vsg_grid_watch_t",
)
"""Structs of the public header; the others are those of the functions alone."""

_GRID = {
    "impedance": (scr_impedance, grid_from_scr_impedance),
    "reactance": (scr_reactance, grid_from_scr_reactance),
}


def laws(structure: str, law: str, scr_basis: str, limiter: str) -> CText:
    """C99 of the grid's functions on a basis, the scheduled Jacobian, the gains of a structure under a law, the power
    loops and the whole controller with a current limiter."""
    return _laws(STRUCTURES[structure].gains, law == "inertia", scr_basis, limiter_named(limiter))


@functools.lru_cache(16)
def _laws(structure_gains: Callable[..., Any], by_inertia: bool, scr_basis: str, chosen: Limiter) -> CText:
    """Read once: a run exports the table of each of its controllers, most of them with the same equations."""
    memory, constants = (typing.get_type_hints(made)["return"] for made in (chosen.at_rest, chosen.build))
    functions = [
        *_GRID[scr_basis],
        error_half_widths,
        share_that_fits,
        part_of_the_way,
        scheduled_jacobian,
        structure_gains,
        within_a_turn,
        frequency_at_rest,
        notch,
        power_stage,
        controller_step,
        plausible,
        skipped_step,
        sound,
        gain_transfer,
        watch_grid,
        synchronised,
        in_step,
        *([chosen.at_rest] if memory._fields else []),
    ]
    kinds = {ControllerState: {"limiter": memory}, ControllerSettings: {"limiter": constants}}
    fixed = {"by_inertia": by_inertia, "limiter": chosen.law}
    return c_functions(functions, fixed=fixed, names=NAMES, kinds=kinds)


def laws_content(structure: str, law: str, scr_basis: str, limiter: str) -> dict[str, Any]:
    """What the templates take of it."""
    text = laws(structure, law, scr_basis, limiter)
    public = text.needed_by(PUBLIC)
    scr, grid = _GRID[scr_basis]
    at_rest = limiter_named(limiter).at_rest
    remembered = typing.get_type_hints(at_rest)["return"]._fields
    return {
        "state_fields": [*ControllerState._fields[:-1], *(f"limiter.{name}" for name in remembered)],
        "largest_state": repr(LARGEST_STATE),
        "times_nominal": repr(TIMES_NOMINAL),
        "public_structs": "\n".join(text.structs[name] for name in public).rstrip(),
        "private_structs": "\n".join(body for name, body in text.structs.items() if name not in public).rstrip(),
        "law_constants": text.constants.rstrip(),
        "law_functions": text.functions.rstrip(),
        "scr_function": f"vsg_{scr.__name__}",
        "grid_function": f"vsg_{grid.__name__}",
        "gains_function": f"vsg_{STRUCTURES[structure].gains.__name__}",
        "limiter_at_rest": f"vsg_{at_rest.__name__}" if f"vsg_{at_rest.__name__}(" in text.functions else "",
    }
