"""Runs that find the instants which only they can tell."""

from __future__ import annotations

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.simulation import build_timeline, simulate
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation
from vsgdesign.study.parameters.study import Study


def finding(study: Study, bridge: str | None = None) -> Simulation:
    """The run of a study's first controller."""
    spec = study.controllers[0]
    return simulate(study, feed_of(study, spec, build_timeline(study), NOTHING), bridge=bridge, finds=spec)


def found_in(study: Study, bridge: str | None = None) -> Study:
    """The study as this run was."""
    return finding(study, bridge).study
