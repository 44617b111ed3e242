"""A proof over a region of grids, operating points and estimate errors, or a counterexample. Names are imported when
they are first used: Numba takes long to load.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vsgdesign.certificate.asked import beyond_table, on_basis_of_table, region_of
    from vsgdesign.certificate.certifying import certify, largest_rate
    from vsgdesign.certificate.full_order.record import LeftPart
    from vsgdesign.certificate.full_order.statement import FullOrderProof, proof_file, prove_full_order
    from vsgdesign.certificate.moving.statement import MovingProof, moving_proof_file, prove_moving
    from vsgdesign.certificate.places import by_place, of_a_pair
    from vsgdesign.certificate.region import MeasuredSchedule, Region
    from vsgdesign.certificate.results import (
        Certificate,
        Counterexample,
        Gap,
        NoFunctionError,
        Places,
        Trajectory,
        refusal_record,
    )
    from vsgdesign.certificate.step_certificates import certified_steps, step_budget, with_steps

_HOMES = {
    "Certificate": "results",
    "Counterexample": "results",
    "FullOrderProof": "full_order.statement",
    "Gap": "results",
    "LeftPart": "full_order.record",
    "MeasuredSchedule": "region",
    "MovingProof": "moving.statement",
    "NoFunctionError": "results",
    "Places": "results",
    "Region": "region",
    "Trajectory": "results",
    "beyond_table": "asked",
    "by_place": "places",
    "certified_steps": "step_certificates",
    "certify": "certifying",
    "largest_rate": "certifying",
    "moving_proof_file": "moving.statement",
    "of_a_pair": "places",
    "on_basis_of_table": "asked",
    "proof_file": "full_order.statement",
    "prove_full_order": "full_order.statement",
    "prove_moving": "moving.statement",
    "refusal_record": "results",
    "region_of": "asked",
    "step_budget": "step_certificates",
    "with_steps": "step_certificates",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


__all__ = [
    "Certificate",
    "Counterexample",
    "FullOrderProof",
    "Gap",
    "LeftPart",
    "MeasuredSchedule",
    "MovingProof",
    "NoFunctionError",
    "Places",
    "Region",
    "Trajectory",
    "beyond_table",
    "by_place",
    "certified_steps",
    "certify",
    "largest_rate",
    "moving_proof_file",
    "of_a_pair",
    "on_basis_of_table",
    "proof_file",
    "prove_full_order",
    "prove_moving",
    "refusal_record",
    "region_of",
    "step_budget",
    "with_steps",
]
