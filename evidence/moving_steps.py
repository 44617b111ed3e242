"""Small steps inside the level sets of functions for all gains: the distance from the rest falls as fast as is proved,
while the gains change every 20 ms, and no limit acts. All steps of a converter run in one loop, a lane each."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._tables import leave, table
from evidence.full_order import CASES
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import region_of
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.points import at_rest
from vsgdesign.certificate.moving.levels import STEPS, LevelSet, level_set
from vsgdesign.certificate.moving.places import with_estimates
from vsgdesign.certificate.region import random_points
from vsgdesign.equations.controller import ControllerState, Measurement, controller_step
from vsgdesign.equations.frames import rms_to_peak, rotate_back
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References, frequency_at_rest, gain_transfer
from vsgdesign.linear.operating_point.many import Lanes, many_steady_states
from vsgdesign.linear.operating_point.plant import plant_steps
from vsgdesign.study.parameters import Study, load_study

Array = NDArray[np.float64]

PROBLEMS = ("laboratory", "utility")
PLACES, RUNS = 20, 1000
"""Of each converter: places, and steps."""

MOST = 0.01
"""Largest step: of the rating, of V_g and of ω_g, and in rad."""

_UPDATE_S = 0.02
_ESTIMATES = 40
"""Estimates of a place among which every update draws."""

_DOWN_TO, _SECONDS = 0.01, 12.0

_CLOSELY, _APART = 200, 10
"""Samples after the step that are all looked at, and of how many later ones one is."""


@dataclass(frozen=True)
class Outcome:
    """The steps of one converter. ``slowest``: the least rate from the step to any later sample, over the proved rate;
    ``limited``: steps after which a limit acted; ``down``: steps whose distance fell to 1 % in the time."""

    problem: str
    places: int
    without: int
    """Places that were left out: they have no level set."""
    steps: int
    down: int
    limited: int
    slowest: float
    median: float
    rate: tuple[float, float]
    longest_s: float
    cpu_s: float


def outcome(name: str, places: int = PLACES, runs: int = RUNS, seed: int = 4) -> Outcome:
    """The steps of one converter, ``runs`` over its ``places``."""
    begin, rng = time.process_time(), np.random.default_rng(seed)
    file, controller, region, *_ = CASES[name]
    study: Study = load_study(file)
    spec, _ = region_of(study, controller, None, None)
    system, _ = prepared(study, spec, region, NOTHING, None, None)
    study = study.with_limit_of(spec)
    points = random_points(region, 40 * places, rng)
    points = points[system.within_limits(points)][:, :4]
    levels: list[LevelSet] = []
    without = 0
    for point in points:
        if (found := level_set(study, system, region, point)) is not None:
            levels.append(found)
        without += found is None
        if len(levels) == places:
            break
    own = rng.integers(len(levels), size=runs)
    steps = Steps.of(study, system, region, levels, own, rng)
    rates, down, limited, seconds = steps.run(rng)
    alpha = np.array([level.decay for level in levels])
    return Outcome(
        problem=name,
        places=len(levels),
        without=without,
        steps=runs,
        down=int(down.sum()),
        limited=int(limited.sum()),
        slowest=float((rates / alpha[own]).min()),
        median=float(np.median(rates / alpha[own])),
        rate=(float(alpha.min()), float(alpha.max())),
        longest_s=seconds,
        cpu_s=round(time.process_time() - begin, 1),
    )


@dataclass
class Steps:
    """Lanes of one converter in the frame of the source: what is at rest, and the state that moves."""

    study: Study
    levels: list[LevelSet]
    own: NDArray[np.intp]
    gains: PowerLoopGains
    """Of every place and estimate, (places, estimates)."""
    refs: References
    grid: GridEstimate
    lanes: Lanes
    plant: Any
    """(6, N)."""
    pending: Any
    controller: ControllerState
    rest: dict[str, Array]

    @classmethod
    def of(cls, study: Study, system: Any, region: Any, levels: list[LevelSet], own: Any, rng: Any) -> Steps:
        """Every lane at its rest before a random step to the rest of its place."""
        errors = rng.uniform(-region.error, region.error, (_ESTIMATES, 2))
        every = with_estimates(np.array([level.place for level in levels]), errors)
        at = at_rest(study, system, every)
        gains = PowerLoopGains(*(value.reshape(len(levels), _ESTIMATES) for value in at.gains))
        place = np.array([level.place for level in levels])[own]
        R, L, V = (value.reshape(len(levels), _ESTIMATES)[own, 0] for value in (at.R_g, at.L_g, at.V_rms))
        c, source, one = study.converter, study.grid_source, np.ones(len(own))
        lanes = Lanes(R, L, source.V_g_rms * one, source.omega_g * one, place[:, 2], place[:, 3],
                      source.omega_g * one, V)  # fmt: skip
        first = PowerLoopGains(*(value[own, 0] for value in gains))
        after = many_steady_states(study, lanes, first)
        kind, sign = rng.integers(len(STEPS), size=len(own)), rng.choice([-1.0, 1.0], len(own))
        sizes = np.array([level.sizes for level in levels])[own, kind]
        unit = np.array([c.S_rated, c.S_rated, 1.0, source.V_g_rms, 1.0])
        most = MOST * np.array([1.0, 1.0, 1.0, 1.0, source.omega_g])
        size = sign * rng.uniform(0.3, 1.0, len(own)) * np.minimum(0.999 * sizes, most[kind]) * unit[kind]
        moved = [size * (kind == k) for k in range(len(STEPS))]
        before = many_steady_states(
            study,
            lanes._replace(P_ref=lanes.P_ref - moved[0], Q_ref=lanes.Q_ref - moved[1],
                           V_g_rms=lanes.V_g_rms - moved[3], omega_g=lanes.omega_g - moved[4]),
            first,
        )  # fmt: skip
        if after.fault.any() or before.fault.any():
            raise ValueError("a lane has no rest")
        cosine, sine = np.cos(moved[2]), np.sin(moved[2])
        plant = before.plant.copy()
        for k in (0, 2, 4):
            plant[k], plant[k + 1] = rotate_back(before.plant[k], before.plant[k + 1], cosine, sine)
        pending = np.stack(rotate_back(before.pending[0], before.pending[1], cosine, sine))
        controller = before.controller._replace(
            theta=before.controller.theta - moved[2], u_alpha=pending[0], u_beta=pending[1]
        )
        return cls(
            study, levels, own, gains, References(*lanes[4:]), GridEstimate(R_g=R, L_g=L), lanes, plant, pending,
            controller, _named(after.plant, after.controller, after.pending),
        )  # fmt: skip

    def run(self, rng: Any) -> tuple[Array, Any, Any, float]:
        """Until the distance of every lane is 1 % of its start: for each the least rate, whether it got there, whether
        a limit acted; and the longest time, s."""
        study, c, own = self.study, self.study.converter, self.own
        settings, law, count = study.controller_settings(), study.limiter.law, len(own)
        step = plant_steps(study, self.lanes.R_g, self.lanes.L_g, c.T_s, self.lanes.omega_g)
        turn = np.cos(self.lanes.omega_g * c.T_s), np.sin(self.lanes.omega_g * c.T_s)
        source = step.source[:, 0].T * rms_to_peak(self.lanes.V_g_rms)
        halves: Any = np.array([np.linalg.cholesky(level.P).T for level in self.levels])[own]
        now = PowerLoopGains(*(value[own, 0] for value in self.gains))
        every = round(_UPDATE_S / c.T_s)
        least, down, limited = np.full(count, np.inf), np.zeros(count, bool), np.zeros(count, bool)
        start, k = self.distance(halves, now), 0
        while not down.all() and k * c.T_s < _SECONDS:
            if k % every == 0:
                new = PowerLoopGains(*(value[own, rng.integers(_ESTIMATES, size=count)] for value in self.gains))
                omega_i = gain_transfer(self.controller.omega_i, self.refs, now, new)
                self.controller, now = self.controller._replace(omega_i=omega_i), new
            limited |= self._sample(step, source, turn, settings, law, now) & ~down
            k += 1
            if k > _CLOSELY and k % _APART:
                continue
            ratio = self.distance(halves, now) / start
            rate = -np.log(ratio) / (k * c.T_s)
            least = np.where(down, least, np.minimum(least, rate))
            down |= ratio <= _DOWN_TO
        return least, down, limited, k * c.T_s

    def distance(self, halves: Array, gains: PowerLoopGains) -> Array:
        """√(xᵀPx) of every lane."""
        state, names = _named(self.plant, self.controller, self.pending), self.levels[0].states
        free = 1.0 - gains.k_P * gains.D_p
        omega_r = (state["omega_i"] - frequency_at_rest(self.refs, gains)) / free
        x = np.stack([omega_r if name == "omega_r" else state[name] - self.rest[name] for name in names], axis=-1)
        return np.linalg.norm(np.einsum("nij,nj->ni", halves, x), axis=1)

    def _sample(self, step: Any, source: Any, turn: Any, settings: Any, law: Any, gains: PowerLoopGains) -> Any:
        """One sample of controller and plant; returns where a limit acted."""
        study, state, plant = self.study, self.controller, self.plant
        v = [capacitor_node_voltage(plant[k], plant[k + 2], plant[k + 4], study.circuit()) for k in range(2)]
        measured = Measurement(v[0], v[1], plant[0], plant[1], plant[4], plant[5])
        after, output = controller_step(
            state, measured, self.grid, self.refs, gains, study.inner_gains, settings, law
        )  # fmt: skip
        fresh = np.stack([output.v_b_alpha, output.v_b_beta])
        applied = self.pending if study.converter.delay_samples else fresh
        moved = np.empty_like(plant)
        for k in range(2):
            moved[k::2] = np.einsum("nij,jn->in", step.transition, plant[k::2]) + step.bridge.T * applied[k]
            moved[k::2] += source.real if k == 0 else source.imag
        for k in (0, 2, 4):
            self.plant[k], self.plant[k + 1] = rotate_back(moved[k], moved[k + 1], *turn)
        self.pending = np.stack(rotate_back(fresh[0], fresh[1], *turn))
        self.controller = after._replace(
            theta=after.theta - study.converter.T_s * self.lanes.omega_g,
            u_alpha=self.pending[0],
            u_beta=self.pending[1],
        )
        at_most = np.hypot(*fresh) >= study.converter.v_max_pk * (1.0 - 1e-9)
        return (np.asarray(output.limited) > 0.0) | at_most


def _named(plant: Any, controller: ControllerState, pending: Any) -> dict[str, Array]:
    names = ("i_s_d", "i_s_q", "v_c_d", "v_c_q", "i_g_d", "i_g_q")
    own = {name: np.asarray(value) for name, value in controller._asdict().items() if name != "limiter"}
    return {**dict(zip(names, plant.copy(), strict=True)), "pending_d": pending[0], "pending_q": pending[1],
            **own, "delta": own["theta"]}  # fmt: skip


def main(folder: Path) -> None:
    """Prints what the steps of both converters did."""
    rows = [outcome(name) for name in PROBLEMS]
    head = (
        "converter",
        "places",
        "steps",
        "down to 1 %",
        "limit acted",
        "least rate over proved",
        "median",
        "proved, 1/s",
    )
    lines = table(head, [(row.problem, f"{row.places}", f"{row.steps}", f"{row.down}", f"{row.limited}",
                          f"{row.slowest:.3f}", f"{row.median:.2f}", f"{row.rate[0]:.2f} to {row.rate[1]:.2f}")
                         for row in rows])  # fmt: skip
    leave(folder, "moving_steps", [vars(row) for row in rows], lines)
