"""Studies through the EMT: every controller through all events, and whether promises and estimates hold."""

from vsgdesign.simulation.scenario.controllers import (
    ControllerResult,
    OperatingPointRow,
    ScenarioResult,
    derive_series,
    mean_cycles,
    measure_events,
    operating_points,
    rest_at_limit,
    run_scenario,
    samples_per_mean,
    series_at_pcc,
)

__all__ = [
    "ControllerResult",
    "OperatingPointRow",
    "ScenarioResult",
    "derive_series",
    "mean_cycles",
    "measure_events",
    "operating_points",
    "rest_at_limit",
    "run_scenario",
    "samples_per_mean",
    "series_at_pcc",
]
