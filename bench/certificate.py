"""Certificates: from a study and a region to a verified Lyapunov function, on points and on boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from bench.timing import Row, figure, repeat
from vsgdesign.certificate import Certificate, Counterexample, Region, certify
from vsgdesign.study.parameters import ControllerSpec, Study, load_study

P, Q = (-4500.0, 4500.0), (-2000.0, 2000.0)
WIDE = Region((2.0, 20.0), (0.3, 20.0), P, Q, error=0.2)
WEAK = replace(WIDE, scr=(1.2, 20.0), Q=(-1000.0, 1000.0))
SLOW = Region((2.0, 20.0), (1.0, 20.0), P, Q, rate=0.05)


def _study() -> Study:
    return replace(load_study("studies/structures/study.toml"), scr_basis="impedance")


def _spec(study: Study, name: str, Q_droop: float) -> ControllerSpec:
    spec = next(spec for spec in study.controllers if spec.name == name)
    return replace(spec, target=replace(spec.target, Q_droop=Q_droop, follow_references=True))


def _row(name: str, region: Region, budget: int | None) -> Row:
    study = _study()
    spec = _spec(study, name, 0.5)

    def ask() -> Certificate | Counterexample:
        return certify(study, spec, region) if budget is None else certify(study, spec, region, budget=budget)

    found = ask()
    if isinstance(found, Counterexample):
        raise RuntimeError(f"{name}: the region has a counterexample, and nothing is left to time")
    seconds = repeat(ask, 3, 0)
    speed = "any speed" if region.rate == float("inf") else f"{region.rate:g}/s"
    kind = "on points" if budget == 0 else f"{found.proof}, {100.0 * (1.0 - found.gap.share):.3g} % on boxes"
    where = f"SCR {region.scr[0]:g} to 20, X/R {region.x_over_r[0]:g} to 20, Q to ±{region.Q[1] / 1e3:g} kvar"
    what = f"{name}, {where}, ±{100.0 * region.error:g} %, {speed}: decay {found.decay:.2f} 1/s, {kind}"
    limit = "38,000 eigenvalue problems a round" if budget == 0 else f"Taylor forms, {found.boxes} proved"
    return Row("certificate", what, figure(seconds), "s", target=30.0, limit=limit)


def certificate() -> list[Row]:
    """The regions of docs/theory/certificate.md."""
    return [
        _row("angle_damped", WIDE, 0),
        _row("published", SLOW, 0),
        _row("angle_damped", WIDE, None),
        _row("angle_damped", WEAK, None),
        _row("published", SLOW, None),
        _row("published", replace(SLOW, rate=float("inf")), None),
    ]


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"certificate": certificate}
