"""docs/study-file.md: its tables are those of the fields, and they say what the readers ask for, both ways.

``python -m tests.docs.test_study_reference`` writes the tables anew.
"""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import LIMITERS
from vsgdesign.study.parameters import (
    background,
    building,
    dc_link,
    estimator,
    grid,
    inner_loops,
    network_fields,
    power_plant_fields,
    power_plant_reading,
    replay,
    scenario,
    sensors,
    specification,
    study_from_text,
    verification,
)
from vsgdesign.study.parameters.building import Sections
from vsgdesign.study.parameters.fields import fields_of
from vsgdesign.study.parameters.loading import tables_of
from vsgdesign.study.parameters.reader import REQUIRED, TableReader
from website.study_file import HEADER, table_lines

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "study-file.md"

OUTSIDE_THE_READER = {("", "base")}
"""Taken out of the document before it is read."""

LC_WITH_TIMES = """
[study]
name = "one"
[converter]
S_rated = "5 kVA"
V_rated_rms = "110 V"
f_n = "50 Hz"
V_dc = "800 V"
f_sw = "10 kHz"
current_limit_pu = 1.2
current_limiter = "projection"
[converter.limiter]
[filter]
kind = "LC"
L_1 = "1 mH"
R_1 = "1 mohm"
C = "50 uF"
[inner_loops]
current_response_time = "1 ms"
voltage_response_time = "10 ms"
[grid]
scr = 5
x_over_r = 2
components = [{ order = -1, amplitude_pu = 0.01 }]
[power_loops]
[simulation]
duration = "2 s"
P_ref = "1 kW"
Q_ref = "0 var"
[[controllers]]
name = "a"
kind = "fixed"
gains = { K_ip = 0.002, D_p = 4000, K_iq = 0.06, D_q = 0.7 }
[[controllers]]
name = "b"
kind = "fixed"
design_grid = { scr = 4, x_over_r = 2 }
[[controllers]]
name = "c"
kind = "scheduled"
estimate = "field"
[[controllers]]
name = "d"
kind = "scheduled"
schedule = "table"
table = "gains.json"
knowledge = { silent = "0.1 s" }
[[events]]
time = 1
grid = { scr = 8 }
components = [{ order = 7, amplitude_pu = 0.01 }]
sag = { type = "C", V_pu = 0.5 }
load = { series = { R_pu = 0.5 } }
fault = {}
breaker = "closed"
synchro_check = {}
[network]
breaker = "open"
load = { series = { R_pu = 1.0 } }
fault = {}
[stability]
[stability.gates]
[survival]
[survival.protection]
[verification]
[verification.step]
[verification.grid]
[verification.phase]
[verification.sag]
[verification.ramp]
[verification.reference]
[background]
[sensors]
[estimator.probe]
"""

LCL_WITH_GAINS = """
[converter]
S_rated = "1 MVA"
V_rated_ll_rms = "690 V"
f_n = "60 Hz"
V_dc = "1200 V"
f_sw = "4 kHz"
[filter]
kind = "LCL"
L_1 = "150 uH"
R_1 = "2 mohm"
C = "200 uF"
L_2 = "60 uH"
R_2 = "1 mohm"
[inner_loops]
K_pc = 0.5
K_ic = 100
K_pv = 0.1
K_iv = 20
[grid]
R_g = "20 mohm"
L_g = "300 uH"
[simulation]
duration = "3 s"
P_ref = "100 kW"
Q_ref = "0 var"
[[controllers]]
name = "a"
kind = "fixed"
design_grid = { R_g = "20 mohm", L_g = "300 uH" }
[[events]]
time = 1
grid = { R_g = "10 mohm", L_g = "200 uH" }
[estimator]
[specification]
aim = "inertia"
H = "4 s"
"""

PLANT = """
[network]
pcc = "here"
[[network.nodes]]
name = "here"
[[network.nodes]]
name = "there"
[[network.branches]]
name = "line"
from = "here"
to = "there"
X_pu = 0.1
[[network.shunts]]
name = "filter"
node = "there"
R = "1 ohm"
[[network.loads]]
name = "load"
node = "there"
series = { R_pu = 1.0 }
[[network.loads]]
name = "drive"
node = "there"
kind = "constant_power"
P_pu = 0.1
[[network.sources]]
name = "source"
node = "there"
X_pu = 0.1
[[network.units]]
name = "unit"
node = "here"
[[network.inverters]]
name = "inverter"
node = "here"
"""

DESIGNED = LCL_WITH_GAINS[: LCL_WITH_GAINS.index("K_pc")] + LCL_WITH_GAINS[LCL_WITH_GAINS.index("[grid]") :]
"""Gains to be designed."""


@dataclass(frozen=True)
class Asked:
    """What a reader asked of one field: its kind or unit, its limits, its default."""

    unit: str
    low: float | None = None
    high: float | None = None
    words: tuple[str, ...] = ()
    default: Any = None


DC = {
    "battery": "R_i = 1\ni_max = 30\ncapacity_Ah = 1\n",
    "converter": "p_max = 9000\n",
    "photovoltaic": "modules = 24\nstrings = 3\n",
}
"""What each source of the dc link needs."""


@dataclass(frozen=True)
class Row:
    """What the page says of one field."""

    unit: str
    limits: str
    default: str


def _section(heading: str) -> str | None:
    """The table that a heading of the page names; None for another heading."""
    name = re.search(r"`\[+([a-z_.]+)\]+`", heading)
    return name.group(1) if name else ("" if heading == "## Top level" else None)


def _page() -> dict[tuple[str, str], Row]:
    rows: dict[tuple[str, str], Row] = {}
    section: str | None = None
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            section = _section(line)
        elif section is not None and (field := re.match(r"\| `(\w+)` \|", line)):
            cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
            assert len(cells) == 5, line
            key = (section, field.group(1))
            assert key not in rows, f"twice on the page: {key}"
            rows[key] = Row(cells[1], cells[2], cells[3])
    return rows


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[tuple[str, str], list[Asked]]:
    """Every field that reading the two studies asks for, as (section, field)."""
    record: dict[tuple[str, str], list[Asked]] = {}

    def spy(method: str, describe: Any) -> None:
        original = getattr(TableReader, method)
        signature = inspect.signature(original)

        def wrapped(self: TableReader, *args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(self, *args, **kwargs)
            bound.apply_defaults()
            key = (re.sub(r"\[[^]]+\]", "", self.path), bound.arguments["field"])
            record.setdefault(key, []).append(describe(bound.arguments))
            return original(self, *args, **kwargs)

        monkeypatch.setattr(TableReader, method, wrapped)

    spy(
        "quantity",
        lambda a: Asked("–" if a["dimension"] == "1" else a["dimension"], a["low"], a["high"], (), a["default"]),
    )
    spy(
        "quantities",
        lambda a: Asked(
            "list of " + ("–" if a["dimension"] == "1" else a["dimension"]), a["low"], a["high"], (), a["default"]
        ),
    )
    spy("names", lambda _: Asked("list of texts"))
    spy("integer", lambda a: Asked("whole number", a["low"], a["high"], (), a["default"]))
    spy("choice", lambda a: Asked("word", words=a["allowed"], default=a["default"]))
    spy("flag", lambda a: Asked("true or false", default=a["default"]))
    spy("text", lambda a: Asked("text", default=a["default"]))
    spy("child", lambda _: Asked("table"))
    spy("children", lambda _: Asked("list of tables"))
    np.savez(tmp_path / "grid.npz", v=160.0 * np.cos(2.0 * np.pi * 50.0 * np.arange(20_000) / 6400.0))
    recorded = LC_WITH_TIMES.replace(
        "[background]", f'[replay]\nfile = "{tmp_path / "grid.npz"}"\nscale = "1 V"\nsampling_rate = 6400'
    )
    recorded = re.sub("(components|sag) = .*", "", recorded)
    others = [LC_WITH_TIMES.replace('"projection"', f'"{name}"') for name in LIMITERS if name != "projection"]
    plants = (LCL_WITH_GAINS + PLANT, LCL_WITH_GAINS + "[plant]\nunits = 2\n")
    fed = [LCL_WITH_GAINS + f'[dc]\nsource = "{name}"\nC = "1 mF"\n[dc.{name}]\n{own}' for name, own in DC.items()]
    for text in (LC_WITH_TIMES, LCL_WITH_GAINS, DESIGNED, recorded, *plants, *others, *fed):
        study_from_text(text, inner_loops=lambda _: (InnerLoopGains(1.0, 1.0, 1.0, 1.0), 100.0))
    return record


def test_page_and_readers_name_the_same_fields(asked: dict[tuple[str, str], list[Asked]]) -> None:
    on_page = set(_page()) - OUTSIDE_THE_READER
    assert not set(asked) - on_page, f"read, but not on the page: {sorted(set(asked) - on_page)}"
    assert not on_page - set(asked), f"on the page, but never read: {sorted(on_page - set(asked))}"


def test_the_two_studies_reach_every_reader(asked: dict[tuple[str, str], list[Asked]]) -> None:
    """A field in a branch that the studies above do not take would escape the test above."""
    reached = {field for _, field in asked}
    escaped = set()
    for module in (
        background,
        building,
        dc_link,
        estimator,
        inner_loops,
        grid,
        network_fields,
        power_plant_fields,
        power_plant_reading,
        replay,
        scenario,
        sensors,
        specification,
        verification,
    ):
        for node in ast.walk(ast.parse(inspect.getsource(module))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr
                in (
                    "quantity",
                    "quantities",
                    "integer",
                    "names",
                    "identifier",
                    "choice",
                    "flag",
                    "text",
                    "child",
                    "children",
                    "section",
                )
                and node.args
                and isinstance(node.args[0], ast.Constant)
            ):
                escaped |= {node.args[0].value} - reached
    assert not escaped, f"add these to a study of this test: {sorted(escaped)}"


def test_units_limits_and_defaults(asked: dict[tuple[str, str], list[Asked]]) -> None:
    page = _page()
    wrong = [
        f"{key}: {difference}"
        for key, calls in asked.items()
        if key in page
        for call in calls
        for difference in _differences(page[key], call)
    ]
    assert not wrong, wrong


def _differences(row: Row, call: Asked) -> list[str]:
    """Limits and defaults are compared where the page gives numbers or words: those of the study's own are prose."""
    found = []
    if row.unit != call.unit:
        found.append(f"unit {row.unit}, read as {call.unit}")
    if call.unit in ("table", "list of tables"):
        return found
    if call.words and set(re.findall(r"`(\w+)`", row.limits)) != set(call.words):
        found.append(f"words {row.limits}, read as {call.words}")
    numbers = [_number(part) for part in row.limits.split(" to ")]
    if len(numbers) == 2 and None not in numbers and numbers != [call.low, call.high]:
        found.append(f"limits {row.limits}, read with {call.low} to {call.high}")
    if row.default.startswith("required") != (call.default is REQUIRED):
        found.append(f"default {row.default}, read with {call.default!r}")
    number, word = _number(row.default), re.fullmatch(r"`(\w+)`", row.default)
    if number is not None and number != call.default:
        found.append(f"default {row.default}, read with {call.default!r}")
    if call.words and word is not None and word.group(1) != call.default:
        found.append(f"default {row.default}, read with {call.default!r}")
    return found


def _number(text: str) -> float | None:
    try:
        return float(text.replace("−", "-"))
    except ValueError:
        return None


def written(page: str) -> str:
    """The page with the tables of its sections as the fields have them."""
    pages = {
        label: f"theory/{path.name}#eq-{label}"
        for path in (ROOT / "docs" / "theory").glob("*.md")
        for label in re.findall(r'<a id="eq-([a-z0-9-]+)"></a>', path.read_text(encoding="utf-8"))
    }
    tables = dict(tables_of(fields_of(Sections)))
    lines: list[str] = []
    section: str | None = None
    skipping = False
    for line in page.splitlines():
        if line.startswith("#"):
            section = _section(line)
        skipping = skipping and line.startswith("|")
        fields = tables.get(section, ()) if section is not None else ()
        if fields and line == HEADER[0]:
            table = "\n".join(table_lines(fields))
            lines += re.sub(r":eq:`([a-z0-9-]+)`", lambda m: f"[({m[1]})]({pages[m[1]]})", table).splitlines()
            skipping = True
        elif not skipping:
            lines.append(line)
    return "\n".join(lines) + "\n"


def test_the_tables_are_those_of_the_fields() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == written(page), "write them anew: python -m tests.docs.test_study_reference"


def test_every_table_of_a_study_has_its_place_on_the_page() -> None:
    on_page = {section for section, _ in _page()}
    assert {path for path, _ in tables_of(fields_of(Sections))} == on_page


def test_every_field_says_what_it_means() -> None:
    fields = [(path, one) for path, table in tables_of(fields_of(Sections)) for one in table]
    assert not [(path, one.name) for path, one in fields if not one.meaning]


def test_example_is_a_study() -> None:
    example = re.search(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert example is not None
    study = study_from_text(example.group(1))
    assert [event.t_s for event in study.events] == [2.0]


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
