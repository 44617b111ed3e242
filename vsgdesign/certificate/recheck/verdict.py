"""What a second look at a full-order proof finds: every fault of its file, and how much of it was looked at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.proof_file import LEFT, PROVED, ProofFile, proved_table
from vsgdesign.artifacts.ready import Ready
from vsgdesign.certificate.asked import within_scheduler
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.points import decays_at, least_decay
from vsgdesign.certificate.recheck.checking import LEAST_SECONDS, Checked, check_boxes
from vsgdesign.certificate.recheck.inner import Inner
from vsgdesign.certificate.recheck.loops import Ball, Loops
from vsgdesign.certificate.recheck.reading import NotCoveredError, check_covered, leaves_of
from vsgdesign.certificate.region import AtDesignPoint, Region, System, region_faults
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.runtime.guards import settings_of
from vsgdesign.study.parameters.study import Study

_SAME = 1e-6
"""Relative to a number of the statement that is computed again."""

FOREIGN = "full-order proof (its file is of another table)"
MISSING = "full-order proof (its file is missing)"


@dataclass(frozen=True, kw_only=True)
class ProofCheck:
    """``faults``: why the proof is refused, one sentence each. ``carried``: what could not be checked. ``looked``: at
    how many boxes; None where it did not come to that. ``decay``: the least one that a search found, 1/s."""

    faults: tuple[str, ...] = ()
    carried: tuple[str, ...] = ()
    looked: Checked | None = None
    decay: float | None = None
    proved: float | None = None
    """Share of the boxes' volume that the file has as proved."""
    alpha: float | None = None
    """The decay of its statement, 1/s."""
    apart: ProofCheck | None = None
    """The same of units against each other; None where the proof is about one converter. ``faults`` has its faults,
    too."""

    def as_document(self) -> dict[str, Any]:
        """JSON's types."""
        looked = None if self.looked is None else asdict(self.looked)
        apart = {} if self.apart is None else {"apart": self.apart.as_document()}
        return plain(
            {name: value for name, value in vars(self).items() if name != "apart"} | {"looked": looked} | apart
        )


def check_proof(
    proof: ProofFile,
    study: Study,
    table: GainTable | None,
    *,
    seed: int = 0,
    most_seconds: float = LEAST_SECONDS,
    progress: Progress | None = None,
) -> ProofCheck:
    """Looks at a proof again, for a study and the gain table of its controller; None: the closed form.

    Whether boxes and arcs cover region and circle is checked in full. A proof of at most 400 boxes is enclosed whole,
    of a larger one at least 200 that are drawn by volume.
    """
    tell = progress or silent
    if proof.table != proved_table(table):
        return ProofCheck(carried=(FOREIGN,))
    apart = proof.statement.get("differential")
    found = _check(replace(proof, apart=()), study, table, False, seed, most_seconds, tell)
    if apart is None and not proof.apart:
        return found
    own = replace(proof, statement=apart or {}, blocks=proof.apart, apart=())
    other = _check(own, study, table, True, seed, most_seconds, tell)
    faults = (*found.faults, *(f"units against each other: {fault}" for fault in other.faults))
    return replace(found, faults=faults, apart=other)


def _check(
    proof: ProofFile,
    study: Study,
    table: GainTable | None,
    apart: bool,
    seed: int,
    most_seconds: float,
    tell: Progress,
) -> ProofCheck:
    """Of all units together, or of units against each other."""
    try:
        loops, system = _read(proof, study, table, apart)
    except (KeyError, TypeError, ValueError) as error:
        return ProofCheck(faults=(f"statement: is not what certify writes ({error})",))
    except (StudyError, InfeasibleStudyError) as error:
        return ProofCheck(faults=(str(error),))
    statement = proof.statement
    faults = [*_differences(loops, system, statement), *_drawn_in(loops)]
    tell("least decay", 0.0)
    least, slower = _decays(loops, system, statement, seed)
    faults += slower
    tell("least decay", 1.0)
    try:
        leaves, roots, estimates = leaves_of(proof)
        every = _of_blocks(loops, proof)
        check_covered(every[0], proof, roots, estimates)
    except (NotCoveredError, ValueError) as error:
        return ProofCheck(faults=(*faults, str(error)), decay=least)
    proved, left = (float(leaves.share[leaves.symbol == k].sum()) for k in (PROVED, LEFT))
    share = proved / max(proved + left, 1e-300)
    if statement["certified"] != (not (leaves.symbol == LEFT).any()):
        faults.append("certified: does not agree with the tree of boxes, a part of which is not decided")
    elif abs(share - statement["proved"]) > 1e-3:
        faults.append(f"proved: is {statement['proved']:.6g}, and {share:.6g} of the boxes' volume are")
    if faults:
        return ProofCheck(faults=tuple(faults), decay=least, proved=share)
    looked = check_boxes(every, leaves, seed, most_seconds, lambda done: tell("boxes", done))
    unconfirmed = [f"a box is not confirmed: {words}" for words in looked.not_confirmed]
    return ProofCheck(faults=tuple(unconfirmed), looked=looked, decay=least, proved=share, alpha=loops.alpha)


def _read(proof: ProofFile, study: Study, table: GainTable | None, apart: bool) -> tuple[Loops, System]:
    """The loops that a statement is about. Raises KeyError, TypeError, ValueError or StudyError."""
    statement, r = proof.statement, proof.statement["region"]
    pairs = [(float(r[name][0]), float(r[name][1])) for name in ("scr", "x_over_r", "P", "Q")]
    region = Region(*pairs, error=float(r["error"]), error_Z=float(r.get("error_Z", 0.0)))
    decay = float(statement["decay"])
    if faults := region_faults(region):
        raise StudyError(study.name, faults)
    if not 0.0 < decay < np.inf:
        raise ValueError(f"decay = {decay:g}")
    for name in ("proved", "certified", "inner_gains", "inner_hash", "delay_samples", "static_limits", "slowest"):
        if name not in statement:
            raise KeyError(f"{name} is missing")
    study = replace(study, scr_basis=proof.scr_basis)
    spec = next((one for one in study.controllers if one.name == statement["controller"]), None)
    if spec is None:
        raise ValueError(f"controller {statement['controller']!r} is none of the study's")
    ready = Ready(tables={} if table is None else {spec.name: table})
    study, _ = within_scheduler(study, region, table)
    system, _ = prepared(study, spec, region, ready, None, None)
    study, limits = study.with_limit_of(spec), system.static
    loops = Loops(
        study=study,
        inner=Inner.of(study, apart),
        region=region,
        schedule=system.schedule,
        table=table,
        current=limits.current,
        bridge_voltage=limits.bridge_voltage,
        alpha=decay,
        divisor=max(4.0, 3.0 * decay),
    )
    return loops, replace(system, apart=apart)


def _of_blocks(loops: Loops, proof: ProofFile) -> list[Loops]:
    """Where gains change, the loops of each block with its rate and its ball; else those of all. Raises
    NotCoveredError."""
    if proof.statement.get("model") != "moving":
        return [loops]
    parts = proof.statement["parts"]
    if len(parts) != len(proof.blocks):
        raise NotCoveredError(f"there are {len(parts)} balls of gains for {len(proof.blocks)} blocks")
    if loops.table is not None or not _one_pair(loops):
        raise NotCoveredError("with gains of a table, or with a droop that changes by itself, nothing is proved")
    found, first = [], 0 if loops.kept_droops else 1
    for part in parts:
        left, right = np.array(part["L"], dtype=float), np.array(part["R"], dtype=float)
        alpha = float(part["decay"])
        sizes = left.shape == (3 - first, 3 - first) and right.shape == (2, 2)
        if not sizes or not np.isfinite([*left.flat, *right.flat]).all():
            raise NotCoveredError("the weights of a ball are no matrices of numbers")
        if not alpha >= loops.alpha:
            raise NotCoveredError(f"a block has a decay of {alpha:.6g} 1/s, which is less than {loops.alpha:.6g}")
        ball = Ball(left, right, first, -(loops.region.largest_error**2))
        found.append(replace(loops, alpha=alpha, divisor=max(4.0, 3.0 * alpha), ball=ball))
    return found


def _one_pair(loops: Loops) -> bool:
    """Whether all gains act on one pair of quantities: the droops, or their products with the gains, stay the same."""
    s = loops.schedule.schedule if isinstance(loops.schedule, AtDesignPoint) else loops.schedule
    structure, parameters = loops.structure, s.normalised(0.0, 0.0)
    if structure.P_droop != structure.Q_droop:
        return False
    if loops.kept_droops:
        return parameters.q == 0.0
    found = []
    for A, B, C, D in np.random.default_rng(0).uniform(0.5, 2.0, (8, 4)):
        g = structure.gains(A, B, C, D, parameters, *structure.droops(s.D_p, s.D_q), 1.0, s.omega, s.law == "inertia")
        if any((g.k_P, g.k_Q, g.K_pq, g.K_qp)):
            return False
        found.append((g.K_ip * g.D_p, g.K_iq * g.D_q))
    return bool((np.ptp(found, axis=0) <= 1e-9 * np.abs(found[0])).all())


def _differences(loops: Loops, system: System, statement: dict[str, Any]) -> Iterator[str]:
    """Where a statement is about other inner loops or other limits than the study has."""
    study = loops.study
    for what, said, own in (
        ("inner_gains", statement["inner_gains"], plain(study.inner_gains._asdict())),
        ("delay_samples", statement["delay_samples"], study.converter.delay_samples),
        ("static_limits", statement["static_limits"], plain(system.static)),
    ):
        if said != own:
            yield f"{what}: is {said}, and the study has {own}"
    smoothings = [lag for lag, _ in loops.inner.filters]
    if any(1.0 - lag >= np.exp(-loops.alpha * loops.inner.T) for lag in smoothings):
        yield f"decay: {loops.alpha:g} 1/s is more than a power filter decays"


def _drawn_in(loops: Loops) -> Iterator[str]:
    """Where the scheduler of a table limits what the gains are made of."""
    if loops.table is None:
        return
    box, c = settings_of(loops.table), loops.study.converter
    for name, own, asked in (
        ("P", box.P, loops.region.P),
        ("Q", box.Q, loops.region.Q),
        ("V_rms", box.V_rms, c.V_limits_rms),
    ):
        if asked[0] < own[0] or asked[1] > own[1]:
            yield (
                f"region: {name} from {asked[0]:g} to {asked[1]:g} is beyond {own[0]:g} to {own[1]:g} of the scheduler"
            )


def _decays(loops: Loops, system: System, statement: dict[str, Any], seed: int) -> tuple[float | None, list[str]]:
    """The least decay of a search with other points than the proof's, and the faults that follow from it."""
    try:
        found = least_decay(loops.study, system, loops.region, seed + 1)
        said = statement["slowest"]
        place = [1.0 / said["scr"], np.arctan(said["x_over_r"]), *(said[n] for n in ("P", "Q", "error_R", "error_L"))]
        own = float(decays_at(loops.study, system, np.array([place], dtype=float))[0])
    except InfeasibleStudyError as error:
        return None, [str(error)]
    except (KeyError, TypeError, ValueError) as error:
        return None, [f"statement: is not what certify writes ({error})"]
    faults = []
    if not abs(own - said["decay"]) <= _SAME * max(abs(own), 1.0):
        faults.append(f"slowest: decays at {own:.6g} 1/s, and not at {said['decay']:.6g}")
    least = min(own, found.decay or 0.0) if np.isfinite(own) else found.decay or 0.0
    if loops.alpha >= least:
        at = f"SCR {found.scr:.4g}, X/R {found.x_over_r:.4g}, P {found.P:.4g} W, Q {found.Q:.4g} var"
        faults.append(f"decay: {loops.alpha:.6g} 1/s is proved, but a mode at {at} decays at {least:.6g} 1/s")
    return least, faults
