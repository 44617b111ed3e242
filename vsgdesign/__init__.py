"""From a converter's datasheet to a gain schedule for grid-forming control, proven in EMT simulation.

``import vsgdesign as vd`` gives the functions below. Each is imported when it is first used, so importing the package
costs nothing, and ``vsgdesign.runtime`` stays with NumPy alone.
"""

__version__ = "0.2.0"

_HOMES = {
    "DesignedTable": "facade.tables",
    "Margins": "facade.assessed",
    "Proof": "facade.tables",
    "Run": "facade.simulated",
    "Study": "parameters.study",
    "VsgDesignError": "errors",
    "case_names": "parameters.loading",
    "certify": "facade.tables",
    "controller": "facade.studies",
    "design_table": "facade.tables",
    "event": "facade.studies",
    "export_c": "facade.tables",
    "grid": "facade.studies",
    "load": "facade.studies",
    "load_scheduler": "runtime.scheduler",
    "margins": "facade.assessed",
    "open_table": "facade.tables",
    "simulate": "facade.simulated",
    "write_report": "facade.reporting",
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
