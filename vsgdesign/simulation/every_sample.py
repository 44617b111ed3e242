"""Figures come from every sample of a run, whatever its study logs: a log of every sample, and from it the study's."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.simulation.at_pcc import AtPcc
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.run_state import Twin
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

MOST_SAMPLES = 20_000_000
"""A run of up to so many samples, 1000 s at 50 µs, is kept as a whole until its figures are taken. It then takes 120
bytes a sample: 0.14 GB a minute at 50 µs, 2.4 GB at most. Of a longer one every n-th sample is kept, so that no more
rows come together."""

_ROWS = 8192
"""So many rows are worked on at a time, because they fit into the processor's cache."""


def spacing_of_figures(study: Study) -> int:
    """Every how many samples figures are taken: 1, or, of a run of more than MOST_SAMPLES, the least number that
    divides the spacing of its log and leaves no more rows than that."""
    T_s = study.converter.T_s
    logged, samples = round(study.simulation.log_interval / T_s), round(study.simulation.duration / T_s)
    enough = (n for n in range(1, logged) if logged % n == 0 and samples <= n * MOST_SAMPLES)
    return next(enough, logged)


def with_every_sample(study: Study) -> Study:
    """The study with the log from which its figures are taken."""
    interval = spacing_of_figures(study) * study.converter.T_s
    return replace(study, simulation=replace(study.simulation, log_interval=interval))


def rows_apart(study: Study) -> int:
    """How many rows of that log come to one of the study's own."""
    return round(study.simulation.log_interval / study.converter.T_s) // spacing_of_figures(study)


def as_logged(run: Simulation, study: Study) -> Simulation:
    """A run of :func:`with_every_sample` with the log that its study asks for."""
    rows = rows_apart(study)
    return run if rows == 1 else run.every(rows)


class SignalsAtPcc(NamedTuple):
    """What figures are taken from: time (s), powers at the PCC (W, var), and the lengths of the current's vector there
    and of that of the converter over the rated peak, (n,) each."""

    t_s: Array
    P_pcc: Array
    Q_pcc: Array
    i_pu: Array
    i_s_pu: Array


def signals_at_pcc(study: Study, run: Simulation | Twin) -> SignalsAtPcc:
    """Powers and current at the PCC in all rows of the log of a run, or of its twin."""
    at_pcc, t_s = AtPcc(study, run.timeline), run.t_s
    found = SignalsAtPcc(t_s, *(np.empty(len(t_s)) for _ in range(4)))
    for first in range(0, len(t_s), _ROWS):
        rows = slice(first, first + _ROWS)
        log = np.asfortranarray(run.log[rows, :8])
        v, i = at_pcc.rows(t_s[rows], log, run.circuit_log[rows])
        found.P_pcc[rows], found.Q_pcc[rows] = instantaneous_power(*v.T, *i.T)
        for lengths, vector in ((found.i_pu, i), (found.i_s_pu, log[:, :2])):
            lengths[rows] = np.sqrt(vector[:, 0] ** 2 + vector[:, 1] ** 2) / study.converter.I_rated_pk
    return found


def without_steps(study: Study, run: Simulation, seen: SignalsAtPcc) -> dict[float, SignalsAtPcc]:
    """What the powers of a run are without each of its steps that has a twin, by the time of the step, s: arrays as
    long as those of the run, ``seen``, and equal to them outside the twin."""
    found = {}
    for twin in run.twins:
        own = signals_at_pcc(study, twin)
        first = int(np.searchsorted(seen.t_s, own.t_s[0] - 0.5 * run.interval)) if len(own.t_s) else 0
        powers = {name: getattr(seen, name).copy() for name in ("P_pcc", "Q_pcc")}
        for name, values in powers.items():
            values[first : first + len(own.t_s)] = getattr(own, name)[: len(values) - first]
        found[twin.event_s] = seen._replace(**powers)
    return found
