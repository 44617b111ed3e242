"""A lattice of grids and powers: at each place one function for all gains, by points; and how long grids have to last
between two jumps."""

from __future__ import annotations

import functools
import hashlib
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateCell
from vsgdesign.artifacts.files import package_hash
from vsgdesign.certificate.full_order.statement import FullOrderJob, half_of
from vsgdesign.certificate.moving.levels import common_function, dwell_time, shortfall
from vsgdesign.certificate.moving.places import estimates, loops_at, middle_error, with_estimates
from vsgdesign.certificate.region import Region

Array = NDArray[np.float64]

_STEPS, _CHECKED = 5, 9
"""Estimates along each error for which a function is looked for, and among which it is checked."""


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """What was found on the lattice. Times are in s: how long grids have to last where two of them take turns."""

    places: int
    """Of the lattice, within the static limits and looked at."""
    without: tuple[CertificateCell, ...]
    """Those for which no function was found; ``decay`` is the least one of the estimates there, 1/s."""
    decay: tuple[float, float]
    """Least and largest decay of the functions, 1/s."""
    ratio: float
    """Of the SCR of neighbours."""
    near: tuple[float, float]
    """Between neighbours in SCR: the median and the largest time."""
    far: tuple[float, float]
    """Between any two SCR of one X/R, P and Q, alike."""
    lines: tuple[int, int]
    """Lines of constant X/R, P and Q that were looked at, and how many there are."""


class LatticeJob(FullOrderJob):
    """The lattice in lines of constant X/R, P and Q. A part has, by the number of its line, what was found there; the
    lines of units against each other follow those of the loop on the grids."""

    what = "places"

    @property
    def key(self) -> str:
        """Hash of everything that a part depends on."""
        return hashlib.sha256(f"lattice {super().key} {package_hash()}".encode()).hexdigest()

    @functools.cached_property
    def lattice(self) -> Array:
        """Places (lines, SCR, 4)."""
        return lattice_of(self.region)

    @property
    def blocks(self) -> range:
        """Numbers of all lines."""
        return range(len(self.lattice) * len(self.problems))

    def size(self, block: int, /) -> int:  # noqa: ARG002 - all lines have as many places
        """One."""
        return 1

    def run(self, block: int) -> dict[str, Any]:
        """The functions along a line."""
        if self.until is not None and time.time() > self.until:
            return {}
        mode, place_of_line = divmod(block, len(self.lattice))
        system, study = self.problems[mode].system, self.study.with_limit_of(self.spec)
        line = self.lattice[place_of_line]
        line = line[system.within_limits(np.hstack([line, np.zeros((len(line), 2))]))]
        places, functions = [], []
        for place in line:
            errors = [
                np.vstack([np.full((1, 2), middle_error(self.region)), estimates(self.region, float(place[1]), steps)])
                for steps in (_STEPS, _CHECKED)
            ]
            some, every = (loops_at(study, system, with_estimates(place[None], one)) for one in errors)
            if not np.isfinite(every.A).all():
                continue
            T_s = study.converter.T_s
            decay = float(-np.log(np.abs(np.linalg.eigvals(every.A)).max()) / T_s)
            rho = float(np.exp(-half_of(decay) * T_s))
            P = common_function(some.A, rho) if decay > 0.0 else None
            if decay > 0.0 and (P is None or shortfall(every.A, P, rho) >= 0.0):
                P = common_function(every.A, rho)
            held = P is not None
            places.append([*place.tolist(), decay, held])
            if held and P is not None:
                functions.append((float(place[0]), P, half_of(decay)))
        near, far = [], []
        for i, (first, P, decay) in enumerate(functions):
            for j, (other, Q, least) in enumerate(functions[:i]):
                dwell = dwell_time(P, Q, min(decay, least))
                far.append(dwell)
                if j == i - 1 and abs(np.log(first / other)) < 1.01 * np.log(ratio_of(self.lattice)):
                    near.append(dwell)
        return {str(block): {"places": places, "near": near, "far": far}}


_SCR, _X_OVER_R, _WIDEST = 15, 10, 1.05
"""Values of SCR, of X/R at most, and the ratio of those of X/R up to which one is enough."""


def lattice_of(region: Region) -> Array:
    """Places (lines, SCR, 4): SCR and X/R spaced by their logarithm, P and Q at their limits and in the middle."""
    low, high = region.x_over_r
    count = min(_X_OVER_R, 1 + int(np.ceil(np.log(high / low) / np.log(_WIDEST) - 1e-9)))
    axes = (
        np.arctan(np.unique(np.geomspace(low, high, count))),
        *(np.unique(np.linspace(*limits, 3)) for limits in (region.P, region.Q)),
        1.0 / np.unique(np.geomspace(*region.scr, _SCR))[::-1],
    )
    angle, P, Q, first = np.meshgrid(*axes, indexing="ij")
    return np.stack([first, angle, P, Q], axis=-1).reshape(-1, len(axes[3]), 4)


def ratio_of(lattice: Array) -> float:
    """Of neighbours' SCR; 1 where there is one alone."""
    first = lattice[0, :, 0]
    return float(first[1] / first[0]) if len(first) > 1 else 1.0


def sampled(job: LatticeJob, parts: Mapping[str, Any], mode: int = 0) -> Sampled:
    """The parts of a lattice as one; ``mode`` 1: of units against each other."""
    parts = {name: part for name, part in parts.items() if int(name) // len(job.lattice) == mode}
    rows = [row for name in sorted(parts, key=int) for row in parts[name]["places"]]
    without = [
        CertificateCell(
            scr=1.0 / row[0], x_over_r=float(np.tan(row[1])), P=row[2], Q=row[3], error_R=0.0, error_L=0.0, decay=row[4]
        )
        for row in rows
        if not row[5]
    ]
    held = [half_of(row[4]) for row in rows if row[5]] or [float("nan")]
    near, far = ([value for part in parts.values() for value in part[name]] for name in ("near", "far"))

    def middle_and_most(values: list[float]) -> tuple[float, float]:
        return (float(np.median(values)), max(values)) if values else (float("nan"), float("nan"))

    return Sampled(
        places=len(rows),
        without=tuple(without),
        decay=(min(held), max(held)),
        ratio=ratio_of(job.lattice),
        near=middle_and_most(near),
        far=middle_and_most(far),
        lines=(len(parts), len(job.lattice)),
    )
