"""Changes of a gain table's document and of a network's weights, each with the field that a refusal has to name."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.artifacts.guarded_file import GuardedFile

Document = dict[str, Any]
Random = np.random.Generator
Change = Callable[[Document, Random], str]
"""Changes a document in place, and returns the field."""

SMALLER = ("overshoot_P_pct", "settling_P_s", "overshoot_Q_pct", "settling_Q_s")
LARGER = ("disk_margin_output", "damping_power_loops")


@dataclass(frozen=True)
class Mutation:
    """One kind of change. ``refused``: whether its fault follows from the file; else the field is only carried."""

    name: str
    change: Change
    refused: bool = True


def cell(values: list[list[Any]], rng: Random) -> tuple[int, int]:
    """A random cell."""
    return int(rng.integers(len(values))), int(rng.integers(len(values[0])))


def gain(document: Document, rng: Random) -> str:
    name = str(rng.choice([key for key, values in document["gains"].items() if np.any(values)]))
    i, j = cell(document["gains"][name], rng)
    document["gains"][name][i][j] *= 1.0 + float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-6.0, -0.5))
    return f"gains.{name}"


def column(document: Document, rng: Random) -> str:
    name = str(rng.choice(["k_1", "d_1", "k_2"]))
    i, j = cell(document["columns"][name], rng)
    document["columns"][name][i][j] *= float(rng.uniform(0.8, 0.99))
    return "gains."


def nominal(document: Document, rng: Random) -> str:
    name = str(rng.choice([*SMALLER, *LARGER, "H_s", "decay_1_s"]))
    i, j = cell(document["margins"][name], rng)
    document["margins"][name][i][j] = 1.1 * document["margins"][name][i][j] + 0.3
    return f"margins.{name}"


def worst_better(document: Document, rng: Random) -> str:
    name = str(rng.choice([*SMALLER, *LARGER]))
    i, j = cell(document["margins"][name], rng)
    value = document["margins"][name][i][j]
    better = value - 0.05 * value - 0.15 if name in SMALLER else value + 0.1
    document["margins"][f"worst_{name}"][i][j] = better
    return f"margins.worst_{name}"


def worst_beyond(document: Document, rng: Random) -> str:
    name = str(rng.choice([*SMALLER, *LARGER]))
    i, j = cell(document["margins"][name], rng)
    document["margins"][f"worst_{name}"][i][j] = 20.0 if name in SMALLER else 0.2
    return f"margins.worst_{name}"


def worst_within(document: Document, rng: Random) -> str:
    name = str(rng.choice(SMALLER))
    i, j = cell(document["margins"][name], rng)
    limit = 5.0 if name.startswith("overshoot") else document["specification"]["settling_time"]
    own, worst = document["margins"][name][i][j], document["margins"][f"worst_{name}"]
    worst[i][j] = max(own, float(rng.uniform(own, limit)))
    return f"worst_{name}"


def status(document: Document, rng: Random) -> str:
    i, j = cell(document["status"], rng)
    document["status"][i][j] = str(rng.choice(["relaxed", "outside"]))
    return "status"


def all_relaxed(document: Document, rng: Random) -> str:  # noqa: ARG001
    document["status"] = [["relaxed" for _ in row] for row in document["status"]]
    document["between"]["promised"] = 0
    return "status"


def cause(document: Document, rng: Random) -> str:
    i, j = cell(document["status"], rng)
    known = {"cause": "delay", "missed": {"overshoot": 0.3}, "keeps": None, "limit": "current", "limit_use": 0.9}
    document["causes"] = [known | {"scr": document["scr"][i], "x_over_r": document["x_over_r"][j]}]
    return "causes[0]"


def promised(document: Document, rng: Random) -> str:
    document["between"]["promised"] -= int(rng.integers(1, 5))
    return "between.promised"


def points(document: Document, rng: Random) -> str:
    document["between"]["points"] += int(rng.choice([-3, 3]))
    return "between.promised"


def more_points(document: Document, rng: Random) -> str:
    for name in ("points", "promised"):
        document["between"][name] += 1000
    document["between"]["seed"] = int(rng.integers(3, 100))
    return "between"


def of_certificate(name: str, low: float, high: float, refused: str = "") -> Change:
    def change(document: Document, rng: Random) -> str:
        document["certificate"][name] *= float(rng.uniform(low, high))
        return refused or f"certificate.{name}"

    return change


def lyapunov(document: Document, rng: Random) -> str:
    P = document["certificate"]["P"][0]
    if rng.random() < 0.5:
        P[0][1], P[1][0] = -P[0][1], -P[1][0]
        return "certificate."
    k = int(rng.integers(2))
    P[k][k] *= 30.0
    return "certificate."


def region(document: Document, rng: Random) -> str:
    name, within = str(rng.choice(["scr", "x_over_r", "P"])), document["certificate"]["region"]
    within[name][1] *= float(rng.uniform(1.05, 3.0))
    return f"certificate.region.{name}"


def static_limit(document: Document, rng: Random) -> str:
    name = str(rng.choice(["V_low", "V_high", "power_transfer", "bridge_voltage"]))
    document["certificate"]["static_limits"][name] *= float(rng.choice([0.8, 1.3]))
    return f"certificate.static_limits.{name}"


def step(document: Document, rng: Random) -> str:
    rows = document["certificate"]["steps"]["rows"]
    k = int(rng.choice([n for n, row in enumerate(rows) if row["P_ref"] is not None]))
    name = str(rng.choice(["P_ref", "Q_ref", "phase", "V_g", "omega_g"]))
    rows[k][name] *= float(rng.uniform(2.0, 10.0))
    return f"certificate.steps.rows[{k}].{name}"


def step_decay(document: Document, rng: Random) -> str:
    document["certificate"]["steps"]["decay"] *= float(rng.uniform(5.0, 50.0))
    return "certificate.steps.decay"


def counted(document: Document, rng: Random) -> str:
    family = document["verification"]["families"][str(rng.choice(list(document["verification"]["families"])))]
    one = family["promises"][str(rng.choice(list(family["promises"])))]
    name = str(rng.choice(["broken", "judged", "share", "bound", "one_in"]))
    one[name] = one[name] + 1 if name in ("broken", "judged", "one_in") else 0.5 * one[name] + 0.01
    return "verification"


def verified_worst(document: Document, rng: Random) -> str:
    one = document["verification"]["families"]["step"]["promises"]["settling"]
    one["worst"] *= float(rng.uniform(0.6, 0.99))
    return "verification"


def limit(document: Document, rng: Random) -> str:
    name = str(rng.choice(["settling_time", "overshoot", "disk_margin", "damping_ratio"]))
    document["specification"][name] *= float(rng.choice([0.5, 1.5]))
    return f"specification.{name}"


def validity(document: Document, rng: Random) -> str:
    name = str(rng.choice(["P", "V_rms", "scr", "x_over_r"]))
    document["validity"][name][1] *= float(rng.uniform(1.1, 2.0))
    return f"validity.{name}"


def base(document: Document, rng: Random) -> str:
    name = str(rng.choice(["S_rated", "V_rated_rms", "omega_n", "V_g_rms"]))
    document["base"][name] *= float(rng.choice([0.9, 1.1]))
    return f"base.{name}"


def inputs(document: Document, rng: Random) -> str:
    section, name, field = (
        ("converter", "S_rated", "base.S_rated"),
        ("converter", "V_min_pu", "validity.V_rms"),
        ("grid", "V_g_rms", "base.V_g_rms"),
        ("controller", "P_design", "P_design"),
    )[int(rng.integers(4))]
    document["design_inputs"][section][name] *= 1.05
    return field


def node(document: Document, rng: Random) -> str:
    name = str(rng.choice(["scr", "x_over_r"]))
    document[name][0] *= 0.9
    return name


def scenarios(document: Document, rng: Random) -> str:
    i, j = cell(document["status"], rng)
    document["margins"]["scenarios"][i][j] += int(rng.integers(1, 9))
    return "scenarios"


def unstable(document: Document, rng: Random) -> str:
    i, j = cell(document["status"], rng)
    document["margins"]["full_order_decay_1_s"][i][j] *= -1.0
    return "margins.full_order_decay_1_s"


def price(document: Document, rng: Random) -> str:
    i, j = cell(document["price"], rng)
    document["price"][i][j] = float(rng.uniform(0.0, 100.0))
    return "price"


def negative_price(document: Document, rng: Random) -> str:
    i, j = cell(document["price"], rng)
    document["price"][i][j] = -float(rng.uniform(1.0, 100.0))
    return "price"


def active(document: Document, rng: Random) -> str:
    i, j = cell(document["active"], rng)
    document["active"][i][j] = str(rng.choice(["overshoot", "disk_margin"]))
    return "active"


def place(document: Document, rng: Random) -> str:
    document["safe_place"] = [float(rng.uniform(*document["validity"][name])) for name in ("scr", "x_over_r")]
    return "safe_place"


def scale(document: Document, rng: Random) -> str:
    document["certificate"]["scale"][int(rng.integers(3))] *= float(rng.uniform(1.5, 3.0))
    return "certificate.scale"


def word(document: Document, rng: Random) -> str:
    section, name = (("filter", "L_1"), ("converter", "V_dc"), ("grid", "omega_g"))[int(rng.integers(3))]
    document["design_inputs"][section][name] = "much"
    return f"design_inputs.{section}.{name}"


TABLE = (
    Mutation("gain of a node", gain),
    Mutation("column of a node", column),
    Mutation("figure of a node", nominal),
    Mutation("worst figure better than the nominal one", worst_better),
    Mutation("worst figure beyond the limit of a met cell", worst_beyond),
    Mutation("status of a cell", status),
    Mutation("status of all cells", all_relaxed),
    Mutation("cause of a met cell", cause),
    Mutation("promised points", promised),
    Mutation("looked at points", points),
    Mutation("decay of the certificate", of_certificate("decay", 1.5, 60.0)),
    Mutation("sampled decay", of_certificate("sampled", 1.5, 60.0)),
    Mutation("largest eigenvalue", of_certificate("largest", 5.0, 60.0)),
    Mutation("Lyapunov function", lyapunov),
    Mutation("scale of the Lyapunov function", scale),
    Mutation("region of the certificate", region),
    Mutation("static limit", static_limit),
    Mutation("certified step", step),
    Mutation("decay of the steps", step_decay),
    Mutation("counts of the verification", counted),
    Mutation("limit of the specification", limit),
    Mutation("validity", validity),
    Mutation("base", base),
    Mutation("inputs of the design", inputs),
    Mutation("word in place of an input", word),
    Mutation("node of an axis", node),
    Mutation("unstable with real inner loops", unstable),
    Mutation("negative price", negative_price),
    Mutation("worst figure within its limit", worst_within, refused=False),
    Mutation("less decay of the certificate", of_certificate("decay", 0.5, 0.95, "certificate"), refused=False),
    Mutation("more looked at points", more_points, refused=False),
    Mutation("scenarios", scenarios, refused=False),
    Mutation("price", price, refused=False),
    Mutation("active constraint", active, refused=False),
    Mutation("safe place", place, refused=False),
    Mutation("worst run of the verification", verified_worst, refused=False),
)
"""Of a designed and verified table without a relaxed cell."""


def size(document: Document, rng: Random) -> str:
    name = str(rng.choice(["W_1", "b_1", "W_2", "b_2"]))
    _layers(document)[name].pop()
    return "has shape"


def missing(document: Document, rng: Random) -> str:
    name = str(rng.choice(["b_1", "b_2"]))
    _layers(document)[name][0] = None
    return name


def deviation(document: Document, rng: Random) -> str:
    layers = _layers(document)
    values = layers["inputs"]["deviation"] if "inputs" in layers else layers["deviation"]
    values[int(rng.integers(len(values)))] = float(rng.choice([0.0, -1.0]))
    return "deviation"


def _layers(document: Document) -> Document:
    return document["network"] if "network" in document else document["layers"]


def trained_on(document: Document, rng: Random) -> str:
    name = str(rng.choice(["R_g", "L_g"]))
    document["trained_on"][name][1] *= float(rng.uniform(1.01, 2.0))
    return f"trained_on.{name}"


def scaling(document: Document, rng: Random) -> str:
    side = str(rng.choice(["inputs", "outputs"]))
    values = document["network"][side]["high"]
    values[int(rng.integers(len(values)))] *= float(rng.uniform(-1.0, 0.2))
    return f"{side}.low"


def window(document: Document, rng: Random) -> str:
    document["window"]["samples"] += int(rng.integers(1, 9))
    return "window"


def radius(document: Document, rng: Random) -> str:
    name = str(rng.choice(["learning", "tracking", "doubt"]))
    document["radius_squared"][name] = -document["radius_squared"][name]
    return f"radius_squared.{name}"


def gate(document: Document, rng: Random) -> str:
    document["gate"]["first"] = document["gate"]["last"] + float(rng.uniform(1.0, 9.0))
    return "gate"


def feature(document: Document, rng: Random) -> str:
    document["features"][0] = document["features"][int(rng.integers(1, len(document["features"])))]
    return "features"


WINDOWS = tuple(
    Mutation(f"windows: {name}", change)
    for name, change in (
        ("size of a layer", size),
        ("missing number", missing),
        ("deviation", deviation),
        ("trained range", trained_on),
        ("scaling", scaling),
        ("window", window),
    )
)
FIELD = tuple(
    Mutation(f"field: {name}", change)
    for name, change in (
        ("size of a layer", size),
        ("missing number", missing),
        ("deviation", deviation),
        ("radius", radius),
        ("gate", gate),
        ("features", feature),
    )
)


def mutated(document: Document, mutation: Mutation, rng: Random, form: GuardedFile[Any]) -> tuple[str, str]:
    """The text of the changed document with the right hash and layout, and the field."""
    changed = copy.deepcopy({name: value for name, value in document.items() if name != "sha256"})
    field = mutation.change(changed, rng)
    return form.render(changed), field
