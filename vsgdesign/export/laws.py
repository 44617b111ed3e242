"""The equations that an export needs as C, and the table's own structure and law among them."""

from __future__ import annotations

import functools
import inspect
import typing
from collections.abc import Callable
from typing import Any

from vsgdesign.codegen import CText, c_functions
from vsgdesign.codegen.vector_math import PLAIN, SINGLE
from vsgdesign.equations.controller import (
    LARGEST_STATE,
    TIMES_NOMINAL,
    ControllerSettings,
    ControllerState,
    controller_step,
    in_step,
    plausible,
    power_stage,
    skipped_step,
    sound,
    synchronised,
    watch_grid,
)
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.equations.limiters import Limiter, limiter_named
from vsgdesign.equations.power_loops import PowerLoopGains, References, frequency_at_rest, gain_transfer, notch
from vsgdesign.equations.scheduler_data import ScheduleLaw, SchedulerState, grid_at, normalised_at
from vsgdesign.equations.scheduling import start_place, state_at, told_state, updated
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains

NAMES = {
    PowerLoopGains: "gains",
    References: "references",
    InnerLoopGains: "inner_gains",
    NormalisedGains: "normalised",
    SchedulerState: "scheduler",
}
"""What the public header calls a NamedTuple, where it is not its own name."""

PUBLIC = (
    "vsg_gains_t",
    "vsg_scheduler_t",
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

DATA = "vsg_schedule_table_t", "vsg_scheduler_limits_t"
"""Structs of the data's header."""

REASON_NAMES = (
    "NONE",
    "TIME",
    "NOT_FINITE",
    "RANGE",
    "SATURATED",
    "NO_ESTIMATE",
    "IMPLAUSIBLE",
    "JUMP",
    "UNDESIGNED",
)
"""What the public header calls the reasons of :mod:`vsgdesign.equations.scheduler_data`, behind VSG_REASON_."""

_BITS = (
    *("FRESH", "HELD", "CLAMPED", "LIMITED", "FALLBACK", "REFUSED", "DOUBT", "PARTLY"),
    *("TOLD_LIMITED", "TOLD_SURPRISED", "TOLD_CHANGED"),
)
MACROS = {name: f"VSG_{name}" for name in _BITS} | {name: f"VSG_REASON_{name}" for name in REASON_NAMES[1:]}
MACROS["NO_REASON"] = "VSG_REASON_NONE"
"""Constants that the public header has."""


def laws(structure: str, law: str, scr_basis: str, limiter: str) -> CText:
    """C99 of the scheduler with the gains of a structure under a law and SCR on a basis, of the power loops, and of the
    whole controller with a current limiter."""
    return _laws(STRUCTURES[structure].gains, law == "inertia", scr_basis, limiter_named(limiter))


@functools.lru_cache(16)
def _laws(structure_gains: Callable[..., Any], by_inertia: bool, scr_basis: str, chosen: Limiter) -> CText:
    """Read once: a run exports the table of each of its controllers, most of them with the same equations."""
    memory, constants = (typing.get_type_hints(made)["return"] for made in (chosen.at_rest, chosen.build))
    basis = SCR_BASES[scr_basis]
    functions = [
        updated,
        told_state,
        start_place,
        state_at,
        grid_at,
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
    law = ScheduleLaw(basis.scr, basis.grid, normalised_at, structure_gains, by_inertia)
    fixed = {"law": law, "nearest": False, "limiter": chosen.law}
    return c_functions(functions, fixed=fixed, names=NAMES, kinds=kinds, macros=MACROS, printed=SINGLE)


@functools.cache
def printed_math() -> dict[str, dict[str, Any]]:
    """What vsg_math.c has in each precision: C99 of the functions, and what they take the place of."""

    def arguments(name: str) -> list[str]:
        return list(inspect.signature(SINGLE[name]).parameters)

    found = {}
    for precision, functions in (("double", PLAIN), ("single", SINGLE)):
        text = c_functions(functions[name] for name in SINGLE)
        found[precision] = {
            "constants": text.constants,
            "functions": text.functions,
            "names": {
                name: {
                    "name": functions[name].__name__,
                    "arguments": ", ".join(f"vsg_real_t {one}" for one in arguments(name)),
                    "given": ", ".join(arguments(name)),
                }
                for name in SINGLE
            },
        }
    return found


def laws_content(structure: str, law: str, scr_basis: str, limiter: str) -> dict[str, Any]:
    """What the templates take of it."""
    text = laws(structure, law, scr_basis, limiter)
    public = text.needed_by(PUBLIC)
    data = [name for name in text.needed_by(DATA) if name not in public]
    private = [name for name in text.structs if name not in (*public, *data)]
    at_rest = limiter_named(limiter).at_rest
    remembered = typing.get_type_hints(at_rest)["return"]._fields
    return {
        "state_fields": [*ControllerState._fields[:-1], *(f"limiter.{name}" for name in remembered)],
        "kept_fields": [name for name in ControllerState._fields[:-1] if name not in ("theta", "u_alpha", "u_beta")],
        "largest_state": repr(LARGEST_STATE),
        "times_nominal": repr(TIMES_NOMINAL),
        "public_structs": "\n".join(text.structs[name] for name in public).rstrip(),
        "data_structs": "\n".join(text.structs[name] for name in data).rstrip(),
        "private_structs": "\n".join(text.structs[name] for name in private).rstrip(),
        "law_constants": text.constants.rstrip(),
        "law_functions": text.functions.rstrip(),
        "limiter_at_rest": f"vsg_{at_rest.__name__}" if f"vsg_{at_rest.__name__}(" in text.functions else "",
    }
