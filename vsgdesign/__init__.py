"""From a converter's datasheet to a gain schedule for grid-forming control, proven in EMT simulation.

``import vsgdesign as vd`` gives the functions below. Each is imported when it is first used, so importing the package
costs nothing, and ``vsgdesign.runtime`` stays with NumPy alone.
"""

__version__ = "0.2.0"

_HOMES = {
    "CheckedTable": "verbs.facade.tables",
    "ComparedGains": "verbs.facade.tables",
    "ComparedTables": "verbs.facade.tables",
    "Compliance": "verbs.facade.campaigns",
    "DcSide": "verbs.facade.campaigns",
    "Design": "verbs.facade.designed",
    "DesignedTable": "verbs.facade.tables",
    "Difference": "verbs.facade.tables",
    "EstimatorComparison": "verbs.facade.estimators",
    "InnerLoops": "verbs.facade.designed",
    "Margins": "verbs.facade.designed",
    "NetworkGrid": "verbs.facade.designed",
    "NewStudy": "verbs.facade.designed",
    "ProcessorResult": "verbs.facade.exports",
    "Proof": "verbs.facade.tables",
    "Run": "verbs.facade.simulated",
    "Study": "study.parameters.study",
    "Survival": "verbs.facade.campaigns",
    "Training": "verbs.facade.estimators",
    "Verification": "verbs.facade.campaigns",
    "VsgDesignError": "errors",
    "case_names": "study.parameters.loading",
    "certify": "verbs.facade.tables",
    "check_table": "verbs.facade.tables",
    "cite": "verbs.pipeline.given_results",
    "compare": "verbs.facade.tables",
    "compare_estimators": "verbs.facade.estimators",
    "compare_tables": "verbs.facade.tables",
    "comply": "verbs.facade.campaigns",
    "controller": "verbs.facade.studies",
    "design_study": "verbs.facade.designed",
    "design_table": "verbs.facade.tables",
    "diff": "verbs.facade.tables",
    "event": "verbs.facade.studies",
    "explore": "verbs.facade.simulated",
    "export_all": "verbs.facade.exports",
    "export_c": "verbs.facade.tables",
    "export_dll": "verbs.facade.exports",
    "export_firmware": "verbs.facade.exports",
    "export_fmu": "verbs.facade.exports",
    "export_modelica": "verbs.facade.exports",
    "export_plecs": "verbs.facade.exports",
    "export_simulink": "verbs.facade.exports",
    "export_sunspec": "verbs.facade.exports",
    "grid": "verbs.facade.studies",
    "grid_of_network": "verbs.facade.designed",
    "inner": "verbs.facade.designed",
    "linear_model": "verbs.facade.designed",
    "load": "verbs.facade.studies",
    "load_scheduler": "runtime.scheduler",
    "margins": "verbs.facade.designed",
    "new": "verbs.facade.designed",
    "open_table": "verbs.facade.tables",
    "pil": "verbs.facade.exports",
    "simulate": "verbs.facade.simulated",
    "size": "verbs.facade.campaigns",
    "step_figures": "metrics.recorded",
    "stress_estimators": "verbs.facade.estimators",
    "survive": "verbs.facade.campaigns",
    "train": "verbs.facade.estimators",
    "validate": "verbs.facade.designed",
    "verify": "verbs.facade.campaigns",
    "write_report": "verbs.facade.simulated",
}
"""Where each public name lives (SPEC 1: lazy loading)."""

__all__ = ["__version__", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll] - __init__.pyi has the types


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
