"""The same quantity in all files of one study: what every file says of it, by the names of docs/definitions.md.

A reader for each kind of file gives facts: a quantity, where it was taken, and its value. Facts with the same quantity
and the same place must have the same value, in whatever file they stand.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.definitions import DEFINITIONS, FULL_ORDER, NOMINAL, REDUCED, WORST
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.simulation.scenario.judging import TABLE
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

JSON_TOLERANCE = 1e-9
TEXT_TOLERANCE = 2e-8
"""Relative: what a CSV file says has nine digits."""
C_TOLERANCE = 2e-7
"""Relative: limits in C are rounded to single precision, outwards or inwards."""
REST_TOLERANCE = 5e-5
"""Relative: the rest of a run is that of the sampled controller, whose V differs from the power flow's by 7e-6 (12.5
kVA, 20 kHz) to 4e-5 (1 MVA, 6 kHz): the bridge's voltage stands while the frame turns on."""


class Fact(NamedTuple):
    """A value with its quantity, its place, the file that says it, and how exactly it is written."""

    quantity: str
    place: tuple[Any, ...]
    value: float
    file: str
    tolerance: float = JSON_TOLERANCE


class Difference(NamedTuple):
    """A quantity that has two values at one place."""

    quantity: str
    place: tuple[Any, ...]
    one: tuple[float, str]
    other: tuple[float, str]


def differences(facts: Iterable[Fact]) -> tuple[list[Difference], int]:
    """Which facts contradict each other, and how many quantities at a place stand in more than one file."""
    by_place: dict[tuple[Any, ...], list[Fact]] = defaultdict(list)
    for fact in facts:
        by_place[fact.quantity, fact.place].append(fact)
    found, several = [], 0
    for (quantity, place), said in by_place.items():
        several += len({fact.file for fact in said}) > 1
        first = min(said, key=lambda fact: fact.tolerance)
        for fact in said:
            if not _same(first, fact):
                found.append(Difference(quantity, place, (first.value, first.file), (fact.value, fact.file)))
    return found, several


def _same(one: Fact, other: Fact) -> bool:
    if not (math.isfinite(one.value) and math.isfinite(other.value)):
        return str(one.value) == str(other.value)
    least = 1e-9 if one.quantity.endswith("_pct") else 1e-12
    size = max(abs(one.value), abs(other.value))
    return abs(one.value - other.value) <= max(one.tolerance, other.tolerance) * size + least


def _digits(value: float) -> float:
    """A coordinate of a place in six digits: the same place is written with more or fewer of them."""
    return float(f"{value:.6g}") + 0.0


def _at(controller: str, where: str, scr: float, x_over_r: float, P: float, Q: float) -> tuple[Any, ...]:
    return controller, where, *map(_digits, (scr, x_over_r, P)), _digits(round(Q, 6))


class Walk:
    """Readers of the files of one study."""

    def __init__(self, study: Study, names: Mapping[str, str]) -> None:
        """``names``: of the controller of each gain table, by the name of the table."""
        self.study, self.names = study, names
        self.facts: list[Fact] = []

    def _add(self, quantity: str, place: tuple[Any, ...], value: Any, file: str, *more: float) -> None:
        if value is None or value == "":
            return
        self.facts.append(Fact(quantity, place, float(value), file, *more))

    def _gains(self, place: tuple[Any, ...], gains: Mapping[str, Any], file: str, *more: float) -> None:
        for name in PowerLoopGains._fields:
            if name in gains:
                self._add(name, (place[0], "gains", *place[2:]), gains[name], file, *more)

    def _place(self, controller: str, where: str, R_g: float, L_g: float, P: float, Q: float) -> tuple[Any, ...]:
        at = Grid(R_g, L_g).place(self.study.converter, self.study.scr_basis)
        return _at(controller, where, at.scr, at.x_over_r, P, Q)

    def table(self, document: Mapping[str, Any], file: str) -> None:
        """A gain table, of any file that holds one, and what ``table show`` prints."""
        controller, margins = self.names[document["name"]], document["margins"]
        T = document["time_scale"]
        powers = document["P_design"], document["Q_design"]
        for i, scr in enumerate(document["scr"]):
            for j, ratio in enumerate(document["x_over_r"]):
                place = _at(controller, NOMINAL, scr, ratio, *powers)
                self._gains(place, {name: rows[i][j] for name, rows in document["gains"].items()}, file)
                for name, rows in margins.items():
                    self._margin(name, place, rows[i][j], file)
                for name, rows in document["columns"].items():
                    scale = {"k_1": T * T, "d_1": T, "k_2": T}.get(name, 1.0)
                    self._add(f"node {name}", (controller, _digits(scr), _digits(ratio)), rows[i][j] / scale, file)
        box = document["validity"]
        for name in ("scr", "x_over_r", "P", "Q", "V_rms"):
            for end, value in zip(("low", "high"), box[name], strict=True):
                self._add(f"{name}_{end} of the box", (controller,), value, file)
        certificate = document.get("certificate")
        if certificate is not None:
            self.certificate(certificate, file)
        verification = document.get("verification")
        if verification is not None:
            self.verification(verification, file)

    def _margin(self, name: str, place: tuple[Any, ...], value: float, file: str) -> None:
        if name.startswith("worst_") or name == "full_order_decay_1_s":
            self._add(name, (place[0], WORST, *place[2:]), value, file)
        else:
            self._add(name, (place[0], REDUCED, *place[2:]), value, file)

    def certificate(self, document: Mapping[str, Any], file: str) -> None:
        """A certificate of a table, or what ``certify`` prints: its decay, and its steps."""
        place = (document["controller"], json.dumps(document["region"], sort_keys=True))
        if not document["certified"]:
            return
        self._add("certified decay", place, document["decay"], file)
        steps = document.get("steps") or {}
        for row in steps.get("rows") or ():
            where = (*place, json.dumps([row["scr"], row["P"], row["Q"]]))
            for name in ("P_ref", "Q_ref", "phase", "V_g", "omega_g"):
                self._add(f"certified step {name}", where, row[name], file)

    def verification(self, document: Mapping[str, Any], file: str) -> None:
        """``verify``: its results, its counts, and what a table keeps of them."""
        drawn = document.get("seed"), document.get("controller"), document["runs"]
        for family, one in document["families"].items():
            for name, promise in one["promises"].items():
                for field in ("broken", "judged", "bound", "worst", "limit"):
                    self._add(f"{field} of {name}", ("verify", family, *drawn), promise[field], file)

    def assessed(self, document: Mapping[str, Any], file: str) -> None:
        """results.json of ``report`` and what ``margins`` prints."""
        for controller, one in document["controllers"].items():
            for row in document["verdicts"]:
                if row["controller"] == controller:
                    self._add("gate kept", (controller, row["test"]), row["verdict"] == "pass", file)
            self._add("between the nodes", (controller,), one["between_nodes"]["damping_all_modes"], file)
            for kind, model in (("reduced", REDUCED), ("full_order", FULL_ORDER)):
                for worst in one["worst"][kind]:
                    self._add(worst["quantity"], (controller, model, "worst cell"), worst["value"], file)
            for cell in one["cells"]:
                at = cell["R_g"], cell["L_g"], cell["P"], cell["Q"]
                self._gains(self._place(controller, REDUCED, *at), cell["gains"], file)
                for model, where in (("reduced", REDUCED), ("full_order", FULL_ORDER)):
                    place, margins = self._place(controller, where, *at), cell["margins"][model]
                    for name, value in margins.items():
                        if name not in ("loops", "spectral_abscissa", "stable"):
                            self._add(name, place, value, file)
                    self._add("decay_1_s", place, -margins["spectral_abscissa"], file)
                    for loop, found in margins["loops"].items():
                        for name in ("gain_margin_db", "phase_margin_deg", "delay_margin_s"):
                            self._add(f"{name} of {loop}", place, found[name], file)

    def map(self, rows: Sequence[Mapping[str, str]], controller: str, model: str, file: str) -> None:
        """A map of ``report`` as CSV, and the worst of its cells."""
        for name in ("disk_margin_output", "disk_margin_input", "damping_power_loops", "damping_all_modes"):
            values = [
                float(row[f"{name} [1]"]) for row in rows if row.get(f"{name} [1]") and not row["outside the limits"]
            ]
            if values:
                title = DEFINITIONS[name].title
                self._add(title, (controller, model, "worst cell"), min(values), file, TEXT_TOLERANCE)
        for row in rows:
            P, Q = float(row["P [W]"]), float(row["Q [var]"])
            place = _at(controller, model, float(row["SCR"]), float(row["X/R"]), P, Q)
            self._gains(place, row, file, TEXT_TOLERANCE)
            for column in (
                "disk_margin_output",
                "disk_margin_input",
                "damping_power_loops",
                "damping_all_modes",
                "M_s",
            ):
                if f"{column} [1]" in row:
                    self._add(column, place, row[f"{column} [1]"], file, TEXT_TOLERANCE)
            self._add("decay_1_s", place, -float(row["spectral_abscissa [1/s]"]), file, TEXT_TOLERANCE)
            self._add("V_rms", (controller, *place[2:]), row["V [V]"], file, TEXT_TOLERANCE)
            for loop in "PQ":
                for name, column in (
                    ("gain_margin_db", f"gain_margin_{loop} [dB]"),
                    ("phase_margin_deg", f"phase_margin_{loop} [deg]"),
                    ("delay_margin_s", f"delay_margin_{loop} [s]"),
                ):
                    self._add(f"{name} of {loop}", place, row[column], file, TEXT_TOLERANCE)

    def designed(self, document: Mapping[str, Any], file: str) -> None:
        """What ``design`` prints: operating points, gains and margins of the reduced model."""
        for one in document["designs"]:
            point, grid = one["point"], one["grid"]
            place = self._place(one["controller"], REDUCED, grid["R_g"], grid["L_g"], point["P"], point["Q"])
            self._gains(place, one["gains"], file)
            self._add("V_rms", (place[0], *place[2:]), point["V_rms"], file)
            self._add("H_s", place, one["inertia_s"], file)
            for loop in "PQ":
                for name in ("gain_margin_db", "phase_margin_deg", "delay_margin_s"):
                    self._add(f"{name} of {loop}", place, one[f"margins_{loop}"][name], file)

    def explorer(self, header: Mapping[str, Any], scr: float, x_over_r: float, file: str) -> None:
        """The linear answer of the explorer on one grid."""
        for row in header["controllers"]:
            point = row["operating_point"]
            place = _at(row["name"], FULL_ORDER, scr, x_over_r, point["P"], point["Q"])
            self._gains(place, row["gains"], file)
            V_rms = point["V_pu"] * self.study.converter.V_rated_rms
            self._add("V_rms", (place[0], *place[2:]), V_rms, file)
            self._add("H_s", (place[0], REDUCED, *place[2:]), row["H_s"], file)
            for name in ("disk_margin_output", "disk_margin_input", "damping_all_modes", "M_s"):
                self._add(name, place, row[name], file)
            self._add("decay_1_s", place, row["decay"], file)
            for name in ("gain_margin_db", "phase_margin_deg"):
                self._add(f"{name} of P", place, row[name], file)
                self._add(f"{name} of Q", place, row[name.replace("margin", "margin_Q")], file)

    def compared(self, document: Mapping[str, Any], file: str) -> None:
        """results.json of ``compare``: its inertia stands at the design point, its figures are the worst of a grid."""
        target = self.study.target
        for one in document["contenders"]:
            for grid in one["grids"]:
                place = _at(one["name"], REDUCED, grid["scr"], grid["x_over_r"], target.P, target.Q)
                self._add("H_s", place, grid["inertia"], file)
                for side in ("exact", "wrong", "real_exact", "real_wrong"):
                    for name, value in (grid[side] or {}).items():
                        if name != "abscissa":
                            self._add(name, (one["name"], side, *place[2:4]), value, file)

    def compared_rows(self, rows: Sequence[Mapping[str, str]], file: str) -> None:
        """comparison.csv."""
        target = self.study.target
        for row in rows:
            scr, ratio = float(row["scr"]), float(row["x_over_r"])
            place = _at(row["contender"], REDUCED, scr, ratio, target.P, target.Q)
            self._add("H_s", place, row["H [s]"], file, TEXT_TOLERANCE)
            for side in ("exact", "wrong"):
                for name in ("cross_peak", "disk_margin_output", "damping_power_loops"):
                    value = row[f"{name} {side}"]
                    self._add(name, (row["contender"], side, *place[2:4]), value, file, TEXT_TOLERANCE)

    def run(self, document: Mapping[str, Any], file: str) -> None:
        """results.json of ``run`` and ``simulate``, and what the Python result holds."""
        for rest in document["operating_points"]:
            place = ("rest", rest["controller"], rest["t_s"])
            for name in ("P", "Q", "V_rms", "delta"):
                self._add(name, place, rest[name], file)
        for kept in document["promises"]:
            place = ("rest", kept["controller"], kept["t_s"])
            self._add("P", place, kept["P"], file)
            self._add("Q", place, kept["Q"], file)
            at = kept["controller"], kept["grid"]["R_g"], kept["grid"]["L_g"], kept["P"], kept["Q"]
            for field, where in (("ideal", REDUCED), ("full_order", FULL_ORDER)):
                self._promise(kept, self._place(at[0], where, *at[1:]), field, file)
        for gains in document["gains"]:
            self._gains_of_run(gains["controller"], gains, file)
        for controller, one in document["controllers"].items():
            for gains in one["gains"]:
                self._gains_of_run(controller, gains, file)
            for event in one["events"]:
                self._event(controller, event, file)
            for name, value in (one.get("survival") or {}).items():
                if isinstance(value, float):
                    self._add(name, ("survival", controller), value, file)
            verification = (one["table"] or {}).get("verification")
            if verification is not None:
                self.verification(verification, file)

    def _gains_of_run(self, controller: str, gains: Mapping[str, Any], file: str) -> None:
        for name in PowerLoopGains._fields:
            self._add(name, ("gains", controller, gains["t_s"]), gains[name], file)

    def _event(self, controller: str, event: Mapping[str, Any], file: str) -> None:
        place = ("event", controller, event["signal"], event["t_s"])
        for name in ("final", "peak_current_pu"):
            self._add(name, place, event[name], file)
        for name, value in event["cycle_mean"].items():
            self._add(name, (*place, "mean"), value, file)

    def _promise(self, kept: Mapping[str, Any], place: tuple[Any, ...], field: str, file: str) -> None:
        """A margin at rest: a table promises the damping of its power loops whatever the inner loops are."""
        of_loops = kept["source"] == TABLE and kept["name"] == "damping_ratio"
        place = (place[0], REDUCED, *place[2:]) if of_loops else place
        damping = "damping_power_loops" if place[1] == REDUCED else "damping_all_modes"
        quantity = {"disk_margin": "disk_margin_output", "damping_ratio": damping, "M_s": "M_s"}.get(kept["name"])
        if quantity is not None:
            self._add(quantity, place, kept[field], file, REST_TOLERANCE)

    def c_data(self, text: str, controller: str, file: str) -> None:
        """vsg_data.c: nodes of the table and limits of its box. Rows are SCR, columns R/X ascending."""
        axes = {
            name: _numbers(re.search(rf"vsg_axis_{name}\[\w+\] = {{(.*?)}};", text)) for name in ("scr", "r_over_x")
        }
        names = ("k_1", "d_1", "k_2", "q", "share_P", "share_Q")
        nodes = [_numbers(row) for row in re.finditer(r"^{(VSG_C.*?)},?$", text, re.MULTILINE)]
        places = [(scr, 1.0 / ratio) for scr in axes["scr"] for ratio in axes["r_over_x"]]
        for (scr, ratio), values in zip(places, nodes, strict=True):
            for name, value in zip(names, values, strict=True):
                self._add(f"node {name}", (controller, _digits(scr), _digits(ratio)), value, file)
        for name, end, value in re.findall(r"\.(scr|P|Q|V)_(low|high) = VSG_C\((.*?)\)", text):
            full = {"V": "V_rms"}.get(name, name)
            self._add(f"{full}_{end} of the box", (controller,), float(value), file, C_TOLERANCE)


def _numbers(found: re.Match[str] | None) -> list[float]:
    return [] if found is None else [float(value) for value in re.findall(r"VSG_C\((.*?)\)", found[1])]


def csv_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file by the heads of its columns; of columns with the same head the first."""
    with path.open(newline="", encoding="utf-8") as lines:
        head, *rows = csv.reader(lines)
    return [dict(reversed(list(zip(head, row, strict=True)))) for row in rows]


def said(found: Iterable[Difference]) -> Iterator[str]:
    """A line for each difference."""
    for one in found:
        (a, in_a), (b, in_b) = one.one, one.other
        yield f"{one.quantity} at {one.place}: {a!r} in {in_a}, {b!r} in {in_b}"
