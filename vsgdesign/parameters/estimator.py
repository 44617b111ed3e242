"""Reads the [estimator] section: the network that estimates the grid's impedance, trained in the run or from a file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from vsgdesign.identification.field import ProbeLimits
from vsgdesign.parameters.reader import TableReader

RECIPES = ("published", "continuous", "wide")
"""The packaged recipes for windows, by name; another is a TOML file."""

FIELD_RECIPES = ("field",)
"""The packaged recipes for the network of the field estimator."""

_TRAINED = ("recipe", "seed", "hidden", "components", "starts")
"""Fields that only training uses."""


@dataclass(frozen=True, kw_only=True)
class ProbeSpec:
    """The probe of every controller with a field estimator."""

    send: bool = True
    """Without its probe the estimator never knows the grid, and the gains stay those of a safe place."""
    limits: ProbeLimits = field(default_factory=ProbeLimits)
    code: int = 1
    """Converters on one grid take different ones, and so different sign codes."""


@dataclass(frozen=True, kw_only=True)
class EstimatorSpec:
    """One network for every controller with ``estimate = "neural"``."""

    recipe: str = "published"
    """What it is trained on: a packaged recipe by name, or a TOML file."""
    seed: int = 0
    """Of the windows, their split and the training."""
    hidden: int | None = None
    components: int | None = None
    """Principal components that are trained on; 0: all that stand out of the sensors' noise."""
    starts: int | None = None
    """Of these three None is what the recipe says."""
    weights_file: str | None = None
    """A trained network; None: it is trained in the run."""
    field_weights_file: str | None = None
    """The network of every controller with ``estimate = "field_network"``; None: the packaged one."""
    grid_phase: bool = False
    """Lend the network the simulator's own phase of the grid source. No converter in the field has that signal."""
    v_limit_pu: float | None = None
    i_limit_pu: float | None = None
    """Where the sensors saturate, pu of the rated peaks; None: nowhere."""
    probe: ProbeSpec | None = None
    """None: as the field estimator has it by itself."""


def read_estimator(table: TableReader | None) -> EstimatorSpec | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    recipe = table.text("recipe", default="published")
    known = RECIPES + FIELD_RECIPES
    if recipe not in known and not recipe.endswith(".toml"):
        table.fault("recipe", recipe, "unknown", f"Known: {', '.join(known)}; or a .toml file.")
    spec = EstimatorSpec(
        recipe=recipe,
        seed=table.integer("seed", 0, 2**31 - 1, default=0),
        hidden=table.integer("hidden", 1, 64, default=None),
        components=table.integer("components", 0, 1000, default=None),
        starts=table.integer("starts", 1, 100, default=None),
        weights_file=table.text("weights", default=None),
        field_weights_file=table.text("field_weights", default=None),
        grid_phase=table.flag("grid_phase", default=False),
        v_limit_pu=table.quantity("v_limit_pu", "1", 1.0, 100.0, default=None),
        i_limit_pu=table.quantity("i_limit_pu", "1", 1.0, 100.0, default=None),
        probe=_read_probe(table.child("probe")),
    )
    if spec.weights_file is not None:
        for name in _TRAINED:
            if table.has(name):
                table.fault(name, table.table[name], "weights are given too", "Give either, or neither to train.")
    table.finish()
    return spec


def _read_probe(table: TableReader | None) -> ProbeSpec | None:
    if table is None:
        return None
    own = ProbeLimits()
    send = table.flag("send", default=True)
    limits = ProbeLimits(
        sigma=table.quantity("sigma", "1", 0.001, 0.2, default=own.sigma),
        amplitude=table.quantity("amplitude", "1", 0.0002, 0.02, default=own.amplitude),
        amplitude_sent=table.quantity("amplitude_sent", "1", 0.0002, 0.05, default=own.amplitude_sent),
        amplitude_burst=table.quantity("amplitude_burst", "1", 0.0002, 0.05, default=own.amplitude_burst),
        current=table.quantity("current", "1", 0.001, 0.3, default=own.current),
        ripple=table.quantity("ripple", "1", 0.0005, 0.1, default=own.ripple),
    )
    for name in ("amplitude_burst", "amplitude_sent"):
        if getattr(limits, name) < limits.amplitude:
            table.fault(
                name,
                f"{getattr(limits, name):g}",
                f"smaller than the amplitude at rest, {limits.amplitude:g}",
                "Raise it, or lower the amplitude.",
            )
    for name in () if send else (*asdict(own), "code"):
        if table.has(name):
            table.fault(name, table.table[name], "has no effect with send = false", "Leave one of them out.")
    spec = ProbeSpec(send=send, limits=limits, code=table.integer("code", 0, 2**31 - 1, default=1))
    table.finish()
    return spec
