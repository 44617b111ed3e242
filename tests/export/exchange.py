"""Random and edge inputs for Python and C, and how far apart their answers are."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.artifacts.networks import random_weights
from tests.compilers import objects_of
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.equations.scheduler_data import (
    DOUBT,
    FALLBACK,
    FRESH,
    NO_ESTIMATE,
    NO_REASON,
    PARTLY,
    TOLD_CHANGED,
    TOLD_LIMITED,
    TOLD_SURPRISED,
    SchedulerState,
)
from vsgdesign.export import CompiledC, export_c_files
from vsgdesign.export.compiled import run_compiler
from vsgdesign.export.known_answers import gain_sizes
from vsgdesign.runtime import Scheduler
from vsgdesign.runtime.updating import Answer, Covariance, advance, first_state, given_input, told_state

KINDS = ("published", "poles"), ("decoupled", "poles"), ("angle_damped", "poles"), ("angle_damped", "inertia")


def written(folder: Path, structure: str = "angle_damped", law: str = "poles", **changes: Any) -> tuple[Path, Path]:
    """A table of 12 × 10 shaped cells and a network of 200–8–2, as files."""
    scr, x_over_r = np.geomspace(1.5, 20.0, 12), np.geomspace(0.3, 20.0, 10)
    bend = 1.0 + 0.2 * np.sin(np.arange(120.0)).reshape(12, 10)
    shaped = {"H": 2.0 * bend, "zeta": 0.7 * bend} if law == "inertia" else {"k_1": 15.8 * bend, "d_1": 6.6 * bend}
    shaped |= {"k_2": 4.0 * bend[::-1]} | ({} if structure == "published" else {"share_P": np.minimum(bend, 1.0)})
    made = table(structure, law, scr=scr, x_over_r=x_over_r, parameters=shaped, **changes)
    table_file, weights_file = folder / f"{structure}-{law}.json", folder / "weights.json"
    write_table_file(made, table_file)
    write_network_weights(random_weights(5), weights_file)
    return table_file, weights_file


def exported(folder: Path, structure: str = "angle_damped", law: str = "poles", **changes: Any) -> Path:
    """The same as C."""
    table_file, weights_file = written(folder, structure, law, **changes)
    return export_c_files(table_file, folder / f"{structure}-{law}-c", weights=weights_file).folder


def self_test_of(folder: Path, compiler: str = "gcc", *flags: str) -> int:
    """What the self-test says of a folder."""
    objects = objects_of([compiler, "-std=c99", "-w", *flags], sorted(folder.glob("*.c")), [folder])
    main, program = folder / "main.txt", folder / "selftest.bin"
    main.write_text("unsigned short vsg_selftest(void); int main(void) { return vsg_selftest(); }", encoding="utf-8")
    run_compiler([compiler, "-x", "c", str(main), "-x", "none", *objects, "-lm", "-o", str(program)])
    return subprocess.run([program], check=False).returncode


@dataclass(frozen=True)
class Calls:
    """Inputs of updates. Numbers are what single precision holds, so that both precisions get the same."""

    said: list[int]
    told: list[int]
    values: np.ndarray
    """(N, 5): R_g, L_g, P, Q, V."""
    ticks: list[int]
    covariances: list[Covariance | None]
    """Of the estimates; None: not known."""


def random_calls(scheduler: Scheduler, count: int, seed: int) -> Calls:
    """Walks through the box and beyond, with jumps, limits to the last bit, and what is no number."""
    rng, c, lookup = np.random.default_rng(seed), scheduler.settings, scheduler.lookup
    scr = np.exp(rng.uniform(np.log(0.7 * c.scr[0]), np.log(1.4 * c.scr[1]), count))
    ratio = np.exp(rng.uniform(np.log(0.5 * c.r_over_x[0]), np.log(1.5 * c.r_over_x[1]), count))
    stay = rng.random(count) < 0.9  # grids last for some windows, estimates of them scatter
    last = np.maximum.accumulate(np.where(stay, 0, np.arange(count)))
    grids = np.array([lookup.grid(scr[k], ratio[k]) for k in range(count)])[last]
    grids *= np.exp(rng.choice([0.003, 0.03, 0.3], count)[:, None] * rng.normal(size=(count, 2)))
    P, Q, V = (
        rng.uniform(1.15 * low - 0.15 * high, 1.15 * high - 0.15 * low, count) for low, high in (c.P, c.Q, c.V_rms)
    )
    values = np.column_stack([grids, P, Q, V])
    edges = [
        *c.R_g, *c.L_g, *c.P, *c.Q, *c.V_rms, c.power_range, -c.power_range, c.voltage_range, 0.0, -0.0, np.nan,
        np.inf, -np.inf, 1e-45, -1e-40, 3.4e38, -3.4e38,
    ]  # fmt: skip
    near = [float(np.nextafter(np.float32(edge), np.float32(side))) for edge in edges for side in (-np.inf, np.inf)]
    hit = rng.random(values.shape) < 0.02
    values = np.where(hit, rng.choice([*edges, *near], values.shape), values)
    with np.errstate(over="ignore"):
        values = values.astype(np.float32).astype(float)
    steps = rng.choice(
        [20_000, 19_999, 0, 1, 55_000, 600_000, -5, 2**31 - 1, 2**31],
        count,
        p=[0.9, 0.03, 0.01, 0.01, 0.02, 0.01, 0.01, 0.005, 0.005],
    )
    said = np.where(rng.random(count) < 0.03, NO_ESTIMATE, NO_REASON)
    # Now and then nothing for a while, with something that was told before it.
    silent = np.repeat(rng.random(-(-count // 80)) < 0.1, 80)[:count]
    said = np.where(silent, NO_ESTIMATE, said)
    told = np.where(rng.random(count) < 0.05, rng.integers(0, 8, count), 0)
    covariances = random_covariances(values, lookup.omega, rng)
    return Calls(said.tolist(), told.tolist(), values, (np.cumsum(steps) % 2**32).tolist(), covariances)


def random_covariances(values: np.ndarray, omega: float, rng: np.random.Generator) -> list[Covariance | None]:
    """Of estimates that know their error for a while: from far more precise than needed to useless, and now and then
    what is no covariance."""
    count = len(values)
    with np.errstate(all="ignore"):
        size = np.nan_to_num(np.hypot(values[:, 0], omega * values[:, 1]), nan=1.0, posinf=1.0)
        sigma = size[:, None] * np.exp(rng.uniform(np.log(1e-3), np.log(2.0), (count, 2)))
        rho = rng.choice([0.0, 0.9, -0.9, 1.2], count, p=[0.4, 0.3, 0.27, 0.03])
        sigma[:, 1] /= omega
        given = np.column_stack([sigma[:, 0] ** 2, rho * sigma[:, 0] * sigma[:, 1], sigma[:, 1] ** 2])
        spoilt = rng.random(given.shape) < 0.005
        given = np.where(spoilt, rng.choice([0.0, np.nan, np.inf, -1.0, 1e-45], given.shape), given).astype(np.float32)
    known = np.repeat(rng.random(-(-count // 25)) < 0.6, 25)[:count]
    numbers = given.astype(float).tolist()
    return [(a, b, c) if has else None for (a, b, c), has in zip(numbers, known.tolist(), strict=True)]


@dataclass
class Difference:
    """The worst over all calls."""

    calls: int = 0
    statuses: int = 0
    """Calls whose status or reason differs."""
    fresh: int = 0
    doubtful: int = 0
    """Calls with a doubt that is not over, and not yet too old."""
    partly: int = 0
    gains: float = 0.0
    """Relative, as :func:`vsgdesign.export.known_answers.gain_sizes` says."""
    place: float = 0.0

    def add(self, a: Answer, b: Answer) -> None:
        self.calls += 1
        self.fresh += a.status & FRESH
        self.partly += a.status & PARTLY == PARTLY
        self.doubtful += a.status & (DOUBT | FALLBACK) == DOUBT
        self.statuses += (a.status, a.reason) != (b.status, b.reason)
        for want, got, size in zip(a.gains, b.gains, gain_sizes(a.gains), strict=True):
            if want != got:
                self.gains = max(self.gains, abs(want - got) / size)
        self.place = max(self.place, abs(b.scr / a.scr - 1.0), abs(b.r_over_x / a.r_over_x - 1.0))


def compare(scheduler: Scheduler, compiled: CompiledC, calls: Calls, *, each_afresh: bool = False) -> Difference:
    """C against Python, each on its own state, or C every time from Python's."""
    lookup, c = scheduler.lookup, scheduler.settings
    state, difference = first_state(lookup, c), Difference()
    compiled.load_state(state)
    rows = zip(calls.said, calls.told, calls.values.tolist(), calls.ticks, calls.covariances, strict=True)
    for said, told, values, ticks, covariance in rows:
        if each_afresh:
            state = rounded(state, scheduler)
            compiled.load_state(state)
        changed = bool(told & TOLD_CHANGED)
        compiled.tell(limited=bool(told & TOLD_LIMITED), surprised=bool(told & TOLD_SURPRISED))
        given = given_input(said, *values, ticks=ticks, covariance=covariance)
        state, answer = advance(lookup, c, told_state(state, told), given)
        if said == NO_REASON:
            got = compiled.update_estimate(*values, ticks=ticks, covariance=covariance, changed=changed)
        else:
            compiled.tell(changed=changed)
            got = compiled.hold(*values[2:], ticks=ticks)
        difference.add(answer, got)
    return difference


def rounded(state: SchedulerState, scheduler: Scheduler) -> SchedulerState:
    """The state as single precision holds it, within the box."""
    c = scheduler.settings
    numbers = {
        name: float(np.float32(getattr(state, name)))
        for name in SchedulerState._fields
        if isinstance(getattr(state, name), float)
    }
    numbers["scr"] = min(max(numbers["scr"], c.scr[0]), c.scr[1])
    numbers["r_over_x"] = min(max(numbers["r_over_x"], c.r_over_x[0]), c.r_over_x[1])
    return state._replace(**numbers)


def windows(count: int, seed: int) -> np.ndarray:
    """(N, 2, 100) of sine waves with harmonics and noise, as single precision holds them."""
    rng = np.random.default_rng(seed)
    t = 200e-6 * np.arange(100) * 2.0 * np.pi * 50.0
    phase = rng.uniform(0.0, 2.0 * np.pi, (count, 2, 1))
    size = rng.uniform(0.7, 1.3, (count, 2, 1)) * np.array([155.0, 21.0])[:, None]
    waves = size * (np.sin(t + phase) + 0.03 * np.sin(5.0 * t + 2.0 * phase))
    return (waves + 0.01 * size * rng.normal(size=waves.shape)).astype(np.float32).astype(float)
