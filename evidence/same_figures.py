"""The same quantity in all files of three studies: every verb that writes figures, the explorer and Python functions.

Each study has a gain table of four nodes. A quantity has one value for each definition (docs/definitions.md): whatever
has the same name and place in two files is compared.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

from click.testing import CliRunner

import vsgdesign as vd
from evidence._walk import Walk, csv_rows, differences, said
from vsgdesign.artifacts import read_table_file
from vsgdesign.artifacts.definitions import FULL_ORDER, REDUCED
from vsgdesign.artifacts.ready import Ready
from vsgdesign.report.explore.linear import linear_answer
from vsgdesign.report.explore.state import state_of
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.cli.program import main as program

STUDY = """
base = "case:{case}"
study = {{ name = "{name}", title = "One table of four nodes in every file" }}
grid = {{ scr = 3, x_over_r = 4, scr_basis = "impedance" }}
power_loops = {{ structure = "angle_damped", P_droop = "5 %", Q_droop = "50 %", P_design = {P_design}, Q_design = 0 }}
stability = {{ scr = [3, 8], x_over_r = [1, 4] }}
controllers = [
  {{ name = "table", kind = "scheduled", schedule = "table", table = "table.json" }},
  {{ name = "closed", kind = "scheduled" }},
]
events = [{{ time = 0.1, P_ref = {P_after} }}, {{ time = 2.5, grid = {{ scr = 8, x_over_r = 4 }} }}]

[simulation]
duration = "6 s"
P_ref = {P_ref}
Q_ref = 0
bridge = "averaged"
survival = true

[specification]
settling_time = "1.3 s"
overshoot = "5 %"
disk_margin = 0.8
damping_ratio = 0.4
scr_basis = "impedance"
P = [{least}, {most}]
Q = [-{Q}, {Q}]
error = "10 %"
scr = [3, 8]
x_over_r = [1, 4]
"""
CASES = {"lab_12kva_lcl": 12.5e3, "hoang2025_5kva": 5e3, "utility_1mva_60hz": 1e6}
"""Packaged cases with their rating, VA."""


def main(folder: Path) -> None:
    rows = []
    for case, rating in CASES.items():
        rows.append(walked(case, rating, folder / "same_figures" / case))
        print(rows[-1]["line"], flush=True)
        for line in rows[-1]["differences"]:
            print(f"  {line}", flush=True)
    (folder / "same_figures.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")


def walked(case: str, S: float, folder: Path) -> dict[str, Any]:
    """Every verb in a folder of its own, and what their files say."""
    folder.mkdir(parents=True, exist_ok=True)
    powers = {"P_ref": 0.32 * S, "P_after": 0.4 * S, "P_design": 0.4 * S, "least": -0.45 * S, "most": 0.45 * S}
    path = folder / "study.toml"
    path.write_text(STUDY.format(case=case, name=f"walk_{S:.0f}", Q=0.15 * S, **powers), encoding="utf-8")
    table = folder / "table.json"
    options = ("--controller", "table", "--workers", "1", "--points", "200", "--verify", "60")
    _called("table", "build", path, "--out", table, *options)
    study, read = load_study(path), read_table_file(table)
    walk = Walk(study, {read.name: "table"})
    walk.table(_read(table), "table.json")
    walk.table(_printed("table", "show", table), "table show")
    walk.assessed(_printed("margins", path), "margins")
    walk.designed(_printed("design", path), "design")
    _report(walk, path, folder / "report")
    _called("compare", path, "--no-emt", "--workers", "1", "--out", folder / "compare")
    walk.compared(_read(folder / "compare" / "results.json"), "compare/results.json")
    walk.compared_rows(csv_rows(folder / "compare" / "comparison.csv"), "compare/comparison.csv")
    _called("run", path, "--no-explorer", "--workers", "1", "--out", folder / "run")
    run = _read(folder / "run" / "results.json")
    walk.run(run, "run/results.json")
    walk.table(_read(folder / "run" / "table.table.json"), "run/table.table.json")
    walk.c_data((folder / "run" / "table.c" / "vsg_data.c").read_text(encoding="utf-8"), "table", "run/table.c")
    _called("simulate", path, "--out", folder / "simulate")
    walk.run(_read(folder / "simulate" / "results.json"), "simulate/results.json")
    verified = ("--controller", "table", "--runs", "60", "--search", "0", "--workers", "1")
    _called("verify", path, "--no-explorer", *verified, "--out", folder / "verify")
    walk.verification(_read(folder / "verify" / "results.json"), "verify/results.json")
    walk.table(_read(folder / "verify" / "table.json"), "verify/table.json")
    walk.certificate(_printed("certify", path, "--controller", "table"), "certify")
    _explorer(walk, read, run)
    walk.run(vd.simulate(vd.load(path)).to_dict(), "vd.simulate")
    walk.assessed(vd.margins(vd.load(path)).to_dict(), "vd.margins")
    found, several = differences(walk.facts)
    files = Counter(fact.file for fact in walk.facts)
    line = f"{case}: {len(walk.facts)} values in {len(files)} files, {several} in several, {len(found)} differ"
    return {"case": case, "line": line, "values": dict(files), "several": several, "differences": list(said(found))}


def _report(walk: Walk, path: Path, folder: Path) -> None:
    _called("report", path, "--no-explorer", "--out", folder)
    walk.assessed(_read(folder / "results.json"), "report/results.json")
    for file in sorted(folder.glob("map_*.csv")):
        named = re.fullmatch(r"map_(.*)_(reduced|full_order)\.csv", file.name)
        if named is not None:
            model = {"reduced": REDUCED, "full_order": FULL_ORDER}[named[2]]
            walk.map(csv_rows(file), named[1], model, f"report/{file.name}")


def _explorer(walk: Walk, table: Any, run: dict[str, Any]) -> None:
    """The explorer's linear answers at the nodes and where the run rests."""
    study, ready = walk.study, Ready(tables={"table": table})
    places = [(scr, ratio, study.target.P, study.target.Q) for scr in (3.0, 8.0) for ratio in (1.0, 4.0)]
    places += [(8.0 if rest["t_s"] > 2.0 else 3.0, 4.0, rest["P"], rest["Q"]) for rest in run["operating_points"]]
    for scr, ratio, P, Q in places:
        powers = {"P_pu": P / study.converter.S_rated, "Q_pu": Q / study.converter.S_rated}
        answer = linear_answer(study, ready, state_of({"scr": scr, "x_over_r": ratio, **powers}, study))
        walk.explorer(answer.header, scr, ratio, "explorer")


def _called(*arguments: Any) -> str:
    result = CliRunner().invoke(program, [str(argument) for argument in arguments])
    if result.exit_code != 0:
        raise RuntimeError(f"{' '.join(map(str, arguments))}: {result.stderr}")
    return result.stdout


def _printed(*arguments: Any) -> Any:
    return json.loads(_called(*arguments, "--json"))


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
