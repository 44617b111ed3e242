"""What goes through a suite: a converter with one of its controllers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.parameters.knowledge import GridEstimate
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation.lanes.telling import learns, told_controller
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S
from vsgdesign.simulation.survival.demand import settling_time_of

ROW_S = 5e-4
"""Interval of a trace's rows, s; a sampling period where that is longer."""

FOR_EVER_S = 36000.0
"""How long a schedule without any further estimate is silent, s: what a study file takes at most."""


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A converter with one of its controllers, and the gain table that this controller follows."""

    study: Study
    spec: ControllerSpec
    ready: Ready = NOTHING

    @cached_property
    def own_study(self) -> Study:
        """The study with the current limit of the controller."""
        return self.study.with_limit_of(self.spec)

    @property
    def limit_pu(self) -> float:
        """Limit of the converter's current over the rated peak; infinite without one."""
        limit_pu = self.own_study.converter.current_limit_pu
        return math.inf if limit_pu is None else limit_pu

    @property
    def learns(self) -> bool:
        """Whether the controller estimates its grid by itself, in every sample."""
        return learns(self.spec)

    @property
    def settling_time(self) -> float:
        """T: that of its table's specification, or of its closed form, s."""
        return settling_time_of(self.spec, self.ready)

    @property
    def row_samples(self) -> int:
        """Samples of the controller in one row of a trace."""
        return max(round(ROW_S / self.study.converter.T_s), 1)

    @property
    def lead_s(self) -> float:
        """How long a run is at rest before its test begins, s: a whole number of rows of the trace. An estimator that
        is told nothing learns its grid in this time."""
        row_s = self.row_samples * self.study.converter.T_s
        return math.ceil((LEARNING_S if self.learns else LEAD_S) / row_s - 1e-9) * row_s

    def told(self, silent_s: float) -> ControllerSpec:
        """The controller as it runs: a schedule without an estimator of its own is told the grid, with the errors that
        the study gives it, and ``silent_s`` after every change."""
        spec = told_controller(self.spec)
        if spec.kind == "fixed" or self.learns:
            return spec
        known = spec.knowledge or GridEstimate()
        return replace(spec, knowledge=replace(known, silent_s=min(max(silent_s, known.silent_s), FOR_EVER_S)))
