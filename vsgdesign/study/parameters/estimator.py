"""The [estimator] section: the network that estimates the grid's impedance, trained in the run or from a file."""

from __future__ import annotations

from dataclasses import asdict, field

from vsgdesign.identification.field import PAIRS, ProbeLimits
from vsgdesign.study.parameters.fields import (
    SEEDS,
    fields_of,
    flag,
    inserted,
    number,
    section,
    subtable,
    text,
    values,
    whole,
    with_defaults,
)
from vsgdesign.study.parameters.reader import TableReader

RECIPES = ("published", "continuous", "wide")
"""The packaged recipes for windows, by name; another is a TOML file."""

FIELD_RECIPES = ("field",)
"""The packaged recipes for the network of the field estimator."""

_TRAINED = ("recipe", "seed", "hidden", "components", "starts")
"""Fields that only training uses."""

_OF_RECIPE = "of the recipe"


class _Shares:
    """Fields of this section."""

    sigma: float = number("1", 0.001, 0.2)
    """Standard deviation of Z at rest that the probe is to give, relative to the length of Z."""
    amplitude: float = number("1", 0.0002, 0.02)
    """Largest voltage of one of the two lines at the PCC at rest, rms over the changes of its sign."""
    amplitude_sent: float = number("1", 0.0002, 0.05)
    """The same as it is sent; less arrives where the converter has a transient impedance; at least `amplitude`."""
    amplitude_burst: float = number("1", 0.0002, 0.05)
    """Largest voltage at the PCC for some tenths of a second, while the estimator learns a new grid; at least
    `amplitude`."""
    current: float = number("1", 0.001, 0.3)
    """Largest current of one line at rest."""
    ripple: float = number("1", 0.0005, 0.1)
    """Largest rms ripple of P that both lines together add at rest."""


@section
class ProbeSpec:
    """The probe of every controller with a field estimator."""

    send: bool = flag(default=True)
    """Without the probe the estimator never learns the grid, and the gains stay those of a safe place."""
    limits: ProbeLimits = field(default_factory=ProbeLimits)
    code: int = whole(0, SEEDS, default=1)
    """Which sequence of signs the probe follows. It does not keep the probes of two converters on one grid apart."""
    pair: int = whole(1, len(PAIRS), default=1)
    """On which pair of lines it is sent: 1.5 and 2.5, −1.5 and −2.5, 3.5 and 4.5, or −3.5 and −4.5 times the grid's
    frequency. Converters on one grid take different ones; the units of a plant get theirs by themselves."""
    neighbours: bool = flag(default=False)
    """Whether other grid-forming converters stand on the same grid. They answer the probe with their own control, so
    that its lines differ without a fault: R and L alone are fitted. The units of a plant of several have it by
    themselves."""


LIMITS = with_defaults(fields_of(_Shares), asdict(ProbeLimits()))
PROBE = inserted(fields_of(ProbeSpec), "send", *LIMITS)
"""The fields of [estimator.probe]."""


@section
class EstimatorSpec:
    """One network for every controller with ``estimate = "neural"``."""

    recipe: str = text(default="published", limits="`published`, `continuous`, `wide`, `field` or a .toml file")
    """Windows that it is trained on ([recipes](how-to/windows.md#fields)); `field`, the network of `field_network`, is
    for `estimator train` alone."""
    seed: int = whole(0, SEEDS, default=0)
    """Seed of windows, split and training."""
    hidden: int | None = whole(1, 64, default=None, shown=_OF_RECIPE)
    """Tanh units."""
    components: int | None = whole(0, 1000, default=None, shown=_OF_RECIPE)
    """Principal components of the windows that it is trained on; 0: all that stand out of the noise."""
    starts: int | None = whole(1, 100, default=None, shown=_OF_RECIPE)
    """Trainings at most, where the goal is not reached."""
    weights_file: str | None = text(default=None, name="weights", limits="a file; without the fields above")
    """A trained network to use instead."""
    field_weights_file: str | None = text(
        default=None, name="field_weights", limits="a file", shown="the packaged weights"
    )
    """The network of controllers with `estimate = "field_network"`
    ([how-to](how-to/estimator.md#a-network-behind-the-field-estimator))."""
    grid_phase: bool = flag(default=False)
    """Lend it the simulator's own phase of the grid. No converter in the field has that signal."""
    v_limit_pu: float | None = number("1", 1.0, 100.0, default=None, shown="no limit")
    """Where the voltage sensors saturate, pu of the rated peak; such a window gives no estimate."""
    i_limit_pu: float | None = number("1", 1.0, 100.0, default=None, shown="no limit")
    """The same of the current sensors."""
    probe: ProbeSpec | None = subtable(PROBE, default=None, shown="as below")
    """The probe of `field` and `field_network`."""


def read_estimator(table: TableReader | None) -> EstimatorSpec | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    found = values(fields_of(EstimatorSpec)[:-1], table)
    recipe, known = found["recipe"], RECIPES + FIELD_RECIPES
    if recipe not in known and not recipe.endswith(".toml"):
        table.fault("recipe", recipe, "unknown", f"Known: {', '.join(known)}; or a .toml file.")
    spec = EstimatorSpec(**found, probe=_read_probe(table.child("probe")))
    if spec.weights_file is not None:
        for name in _TRAINED:
            if table.has(name):
                table.fault(name, table.table[name], "weights are given too", "Give either, or neither to train.")
    table.finish()
    return spec


def _read_probe(table: TableReader | None) -> ProbeSpec | None:
    if table is None:
        return None
    limits = ProbeLimits(**values(LIMITS, table))
    for name in ("amplitude_burst", "amplitude_sent"):
        if getattr(limits, name) < limits.amplitude:
            table.fault(
                name,
                f"{getattr(limits, name):g}",
                f"smaller than the amplitude at rest, {limits.amplitude:g}",
                "Raise it, or lower the amplitude.",
            )
    spec = ProbeSpec(**values(ProbeSpec, table), limits=limits)
    for one in () if spec.send else PROBE[1:]:
        if table.has(one.name):
            table.fault(one.name, table.table[one.name], "has no effect with send = false", "Leave one of them out.")
    table.finish()
    return spec
