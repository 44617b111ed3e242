"""Studies through the EMT: every controller through all events, and whether promises and estimates hold."""

from vsgdesign.simulation.scenario.controllers import (
    ControllerResult,
    ScenarioResult,
    derive_series,
    mean_cycles,
    measure_events,
    rest_at_limit,
    run_scenario,
    samples_per_mean,
)

__all__ = [
    "ControllerResult",
    "ScenarioResult",
    "derive_series",
    "mean_cycles",
    "measure_events",
    "rest_at_limit",
    "run_scenario",
    "samples_per_mean",
]
