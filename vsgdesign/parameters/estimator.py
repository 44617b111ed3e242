"""Reads the [estimator] section: the network that estimates the grid's impedance, trained in the run or from a file."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.parameters.reader import TableReader

RECIPES = ("published", "continuous", "wide")
"""The packaged recipes for windows, by name; another is a TOML file."""

FIELD_RECIPES = ("field",)
"""The packaged recipes for the network of the field estimator."""

_TRAINED = ("recipe", "seed", "hidden", "components", "starts")
"""Fields that only training uses."""


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
    )
    if spec.weights_file is not None:
        for field in _TRAINED:
            if table.has(field):
                table.fault(field, table.table[field], "weights are given too", "Give either, or neither to train.")
    table.finish()
    return spec
