"""Cases without an EMT: drawn and answered by formulas, so that a million of them take seconds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.campaigns.verification.blocks import Batch, SingleRun, VerificationJob
from vsgdesign.campaigns.verification.counting import MapAxes, Promise
from vsgdesign.simulation.lanes.cases import LaneCases, no_events
from vsgdesign.simulation.lanes.results import STATUSES
from vsgdesign.study.parameters.study import ControllerSpec, Study

FAMILIES = ("step", "jump")
AXES = MapAxes(scr=(1.5, 20.0), x_over_r=(0.3, 20.0), scr_basis="impedance")
PROMISES = (
    Promise(name="overshoot", figure="overshoot", limit=0.05, families=("step",)),
    Promise(name="settling", figure="settling_s", limit=1.3, families=("step",)),
    Promise(name="survival", figure="recovery_s", limit=2.8, families=FAMILIES, survival=True),
    Promise(name="current", figure="peak_pu", limit=1.26, families=FAMILIES),
)
SEED = 11


def uniforms(first: int, count: int, each: int = 8) -> np.ndarray:
    """(count, each): row k depends on the seed and first + k alone."""
    generator = np.random.Philox(key=SEED)
    generator.advance(first * each // 4)
    return np.random.Generator(generator).random((count, each))


def draw(
    study: Study, spec: ControllerSpec, first: int, count: int, ready: Ready = NOTHING
) -> tuple[LaneCases, np.ndarray]:
    """Cases by number."""
    return cases_of(study, spec, uniforms(first, count), None, ready)


def cases_of(
    study: Study, spec: ControllerSpec, u: np.ndarray, family: int | None = None, ready: Ready = NOTHING
) -> tuple[LaneCases, np.ndarray]:
    """Grids over the box; a jump halves the impedance."""
    del spec, ready
    c, count = study.converter, len(u)
    scr = AXES.scr[0] * (AXES.scr[1] / AXES.scr[0]) ** u[:, 0]
    x_over_r = AXES.x_over_r[0] * (AXES.x_over_r[1] / AXES.x_over_r[0]) ** u[:, 1]
    kind = (u[:, 2] < 0.5).astype(np.int8) if family is None else np.full(count, family, np.int8)
    R_g = c.Z_base / scr / np.hypot(1.0, x_over_r)
    L_g = R_g * x_over_r / c.omega_n
    events = no_events(count)
    events.t_s[:] = 0.1
    events.P_ref[kind == 0, 0] = 0.05 * c.S_rated
    events.R_g[kind == 1, 0] = R_g[kind == 1] / 2.0
    events.L_g[kind == 1, 0] = L_g[kind == 1] / 2.0
    zero = np.zeros(count)
    cases = LaneCases(
        R_g=R_g,
        L_g=L_g,
        V_g_rms=zero + study.grid_source.V_g_rms,
        omega_g=zero + c.omega_n,
        P_ref=c.S_rated * (1.8 * u[:, 3] - 0.9),
        Q_ref=zero,
        events=events,
        error_R=zero,
        error_X=zero,
        silent_s=zero,
        cleared_s=zero + 0.1,
        kind=kind.copy(),
        signal=np.zeros(count, np.int8),
    )
    return cases, kind


def run(study: Study, spec: ControllerSpec, ready: Any, cases: LaneCases, *, bridge: str, strict: bool) -> Any:
    """Figures by formula: some break a promise, some are not asked for, one in two hundred is lost."""
    del spec, ready, bridge, strict
    count = len(cases)
    x = np.abs(cases.P_ref) / (0.9 * study.converter.S_rated)
    y = np.mod(1e6 * cases.R_g, 1.0)
    status = np.full(count, STATUSES.index("judged"), np.int8)
    status[y < 0.03] = 0
    status[(y > 0.03) & (y < 0.05)] = 1
    status[y > 0.995] = STATUSES.index("slipped")
    step = cases.kind == 0
    return SimpleNamespace(
        status=status,
        fault=(status == 0).astype(np.int8),
        overshoot=np.where(step, 0.0507 * np.mod(1e4 * cases.L_g, 1.0), np.nan),
        settling_s=np.where(step, np.where(y > 0.99, np.nan, 0.4 + 0.8 * y), np.nan),
        recovery_s=0.3 + 2.0 * y,
        peak_pu=1.0 + 0.2 * x,
        first_peak_pu=1.0 + 0.3 * x,
        above_s=0.001 * x,
        limited_s=0.002 * x,
        swing_rad=0.5 * y,
        noise=np.zeros(len(y)),
    )


def where() -> str:
    """No machine's instructions matter here."""
    return "none"


def written(study: Study, spec: Any, ready: Any, cases: LaneCases, index: int, place: Any, bridge: str) -> str:
    """Not a study, but something to be kept."""
    del study, spec, ready, place, bridge
    return f"R_g = {cases.R_g[index]!r}\n"


def simulated(path: Any, ready: Any) -> SingleRun:
    """Nothing is simulated again."""
    del ready
    assert path.is_file()
    return SingleRun({}, 1.0, 2.0, float("nan"))


BATCH = Batch(draw, cases_of, run, where, written, simulated)


def job(study: Study, runs: int, **changed: Any) -> VerificationJob:
    """A job over the stand-in."""
    parts: dict[str, Any] = {
        "spec": study.controllers[-1],
        "tables": {},
        "families": FAMILIES,
        "promises": PROMISES,
        "axes": AXES,
        "batch": BATCH,
    }
    return VerificationJob(study=study, runs=runs, **(parts | changed))
