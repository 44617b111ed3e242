"""The voltage of the dc link, the pair of lines of the probe and the units on line: ports of every form."""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compilers import require_compiler
from tests.export.cigre_host import Dll, Hosted
from tests.export.test_fmu import slave_of, step_of
from tests.export.test_other_tools import Sizes, State, script_of
from tests.export.test_unit import FIELD, UnitsFeed
from tests.export.unit_loop import FIXED, Library, clamping, drooping, on_a_battery, run_loop, simulated, study_with
from vsgdesign.equations.dc_control import clamp_of_sample
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.export import export_dll, export_fmu, export_modelica, export_plecs, unit_of
from vsgdesign.export.c_code import export_unit_c
from vsgdesign.export.fmu import reference_inputs
from vsgdesign.export.sunspec import sunspec_map
from vsgdesign.export.wrapping import Builder, wrapped
from vsgdesign.identification.field import PAIRS
from vsgdesign.runtime.scheduler import Scheduler
from vsgdesign.simulation.field_feed import settings_of_study, with_pair
from vsgdesign.simulation.shipped import ShippedScheduler, true_grid
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.study.parameters import study_from_text
from vsgdesign.verbs.pipeline.export import unit_of_study

SAID = "pair: no whole number from 1 to 4."


class Made:
    """A controller on a battery, exported and compiled."""

    def __init__(self, delay: int, controller: str, place: Path) -> None:
        self.study = on_a_battery(study_with(delay, controller))
        self.unit = unit_of(self.study)
        self.library = Library(export_unit_c(self.unit, place / "c").folder, place, self.unit)
        self.inputs = [port.name for port in self.library.ports.inputs]
        self.outputs = [port.name for port in self.library.ports.outputs]

    def given(self) -> np.ndarray:
        """Inputs of some samples: the link falls and rises, and its sensor fails once."""
        rows = reference_inputs(wrapped(self.unit, "controller"))[:120]
        at = self.inputs.index("v_dc")
        rows[:, at] *= 0.8 + 0.3 * np.sin(0.2 * np.arange(len(rows)))
        rows[60, at] = np.nan
        return rows

    def expected(self, pair: float) -> np.ndarray:
        """What the exported C answers to them."""
        one = self.library.instance(pair=pair)
        return np.array([one.step(row) for row in self.given()])


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    require_compiler("gcc")
    with Builder("-O0") as one:
        yield one


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """With a sample of delay, the field estimator and a battery."""
    return Made(1, FIELD, tmp_path_factory.mktemp("field"))


def test_on_a_battery_the_loop_is_the_simulation(tmp_path: Path) -> None:
    """The exported code limits its voltage as the run does; told a constant voltage, it does not."""
    made = Made(0, FIXED, tmp_path)
    study, unit, one = made.study, made.unit, made.library.instance()
    run = run_loop(study, unit, one.step)
    emt = simulated(study, unit)
    assert len(run.figures) == len(emt)
    assert np.max(np.abs(run.figures - emt)) <= 1e-11  # 1e-14 at worst
    other, at = made.library.instance(), made.inputs.index("v_dc")

    def deaf(given: np.ndarray) -> np.ndarray:
        given = given.copy()
        given[at] = study.converter.V_dc
        return other.step(given)

    assert np.max(np.abs(run_loop(study, unit, deaf).figures - emt)) > 1e-4


@pytest.mark.parametrize("controller", [FIXED, FIELD])
def test_a_clamp_is_that_of_the_simulation(controller: str, tmp_path: Path) -> None:
    """What the source can give is an input; the clamp acts from the step of the power on. Told that the source can give
    anything, it does not."""
    study = clamping(study_with(1, controller))
    unit = unit_of(study)
    library = Library(export_unit_c(unit, tmp_path / "c").folder, tmp_path, unit)
    run = run_loop(study, unit, library.instance().step)
    emt = simulated(study, unit, UnitsFeed(study, unit) if controller == FIELD else None)
    assert np.max(np.abs(run.figures - emt)) <= 1e-11  # 1e-14 at worst
    cut = run.outputs[:, [port.name for port in library.ports.outputs].index("P_cut")]
    step, lost = (round(t / unit.T_s) for t in (0.01, 0.09))
    assert not cut[:step].any()
    assert (cut[step:] < 0.0).all()
    S = unit.S_rated
    assert np.ptp(cut[lost - 10 : lost + 10]) == pytest.approx(0.2 * S, abs=1e-3 * S)
    if controller == FIXED:
        other, at = library.instance(), [port.name for port in library.ports.inputs].index("P_dc_high")

        def deaf(given: np.ndarray) -> np.ndarray:
            given = given.copy()
            given[at] = 1e9
            return other.step(given)

        assert np.max(np.abs(run_loop(study, unit, deaf).figures - emt)) > 1e-3


def test_a_droop_of_the_links_voltage_is_that_of_the_simulation(tmp_path: Path) -> None:
    """The frequency follows v_dc, in the whole controller and in the power loops alone."""
    study = drooping(study_with(1))
    unit = unit_of(study)
    assert unit.link is not None
    folder = export_unit_c(unit, tmp_path / "c").folder
    library = Library(folder, tmp_path, unit)
    run = run_loop(study, unit, library.instance().step)
    assert np.max(np.abs(run.figures - simulated(study, unit))) <= 1e-11  # 1e-14 at worst
    loops = Library(folder, tmp_path, unit, "reference")
    at = {port.name: k for k, port in enumerate(loops.ports.inputs)}
    given = np.array([port.start for port in loops.ports.inputs])
    told = {port.name: k for k, port in enumerate(loops.ports.outputs)}
    omega = []
    for v in (unit.link.rest, unit.link.rest + 10.0, np.nan):
        given[at["v_dc"]] = v
        omega.append(loops.instance().step(given)[told["omega"]])
    assert omega[1] - omega[0] == pytest.approx(0.2 * unit.omega_n * 10.0 / study.converter.V_dc, rel=1e-9)
    assert omega[2] == omega[0]


@pytest.mark.parametrize("variant", ["controller", "reference"])
def test_a_clamp_answers_to_any_limits_as_the_equation(variant: str, tmp_path: Path) -> None:
    """Random limits, crossed and missing ones among them, and references; in double with the bits of Python."""
    unit = unit_of(clamping(study_with(1)))
    assert unit.link is not None
    assert unit.link.clamp is not None
    clamp, S = unit.link.clamp, unit.S_rated
    library = Library(export_unit_c(unit, tmp_path / "c").folder, tmp_path, unit, variant)
    names, states = ([one.name for one in ports] for ports in (library.ports.inputs, library.ports.states))
    one, given = library.instance(), np.array([port.start for port in library.ports.inputs])
    rng, path, cuts, left = np.random.default_rng(33), {"controller": "control.", "reference": "power."}[variant], [], 0
    where = "state." if variant == "controller" else ""
    V_rms = "V" if variant == "controller" else "V_rms"
    known = {"P_dc_low": clamp.limits.low, "P_dc_high": clamp.limits.high, "P_ref": unit.references.P_ref}
    for _ in range(300):
        before = dict(zip(states, one.save(), strict=True))
        for name in known:
            value = float(rng.choice([rng.uniform(-S, S), np.nan, np.inf], p=[0.8, 0.1, 0.1]))
            given[names.index(name)] = value
            known[name] = value if np.isfinite(value) else known[name]
        out = dict(zip([port.name for port in library.ports.outputs], one.step(given), strict=True))
        after = dict(zip(states, one.save(), strict=True))
        omega_i, V, P, Q = (before[f"{path}{where}{name}"] for name in ("omega_i", V_rms, "P_f", "Q_f"))
        refs = unit.references._replace(P_ref=known["P_ref"])
        limits = SourceLimits(known["P_dc_low"], known["P_dc_high"])
        slow, own = before["memory.omega"], (clamp.own, clamp.smoothing)
        expected = clamp_of_sample(slow, omega_i, V, P, Q, refs, unit.gains, limits, *own)
        assert (after[f"{path}refs.P_ref"], after["memory.omega"], out["P_cut"]) == expected
        cuts.append(out["P_cut"])
        left += known["P_dc_low"] > known["P_dc_high"]
    assert np.isfinite(cuts).all()
    assert min(cuts) < 0.0 < max(cuts)
    assert cuts.count(0.0) > 10
    assert left > 50


def test_each_pair_is_that_of_a_unit_of_a_plant(field: Made) -> None:
    """Its lines and its sign code, on a battery, through everything that happens; the second one differs."""
    unit = field.unit
    for pair in range(1, len(PAIRS) + 1):
        assert unit.probes[pair - 1] == settings_of_study(with_pair(field.study, pair, pair - 1))
    study = with_pair(field.study, 4, 3)
    run = run_loop(study, unit, field.library.instance(pair=4).step)
    emt = simulated(study, unit, UnitsFeed(study, unit))
    assert np.max(np.abs(run.figures - emt)) <= 1e-11
    first = run_loop(study, unit, field.library.instance().step, samples=600)
    assert np.max(np.abs(first.figures - emt[:600])) > 1e-4
    assert len({probe.line for probe in unit.probes}) == len(PAIRS) == len({probe.seed for probe in unit.probes})


def test_a_link_that_is_not_measured_leaves_the_sample_out(field: Made) -> None:
    """The bridge voltage goes on at the limit of the last voltage; saved and loaded there, it has the same bits."""
    rows, at, used = field.given(), field.inputs.index("v_dc"), field.outputs.index("used")
    one = field.library.instance(pair=3)
    for wrong in (np.nan, np.inf, -400.0, 0.0):
        told = one.step(rows[0])
        row = rows[1].copy()
        row[at] = wrong
        out = one.step(row)
        assert (told[used], out[used]) == (1.0, 0.0)
        assert np.isfinite(out).all()
    other = field.library.instance()
    for row in rows[:59]:
        one.step(row)
    other.load(one.save())
    for row in rows[59:]:
        assert np.array_equal(one.step(row), other.step(row))


PLANT = """
base = "case:lab_12kva_lcl"
grid = { scr = 4, x_over_r = 5 }
plant = { units = [2, 3], reactance = 0.06, resistance = 0.006 }
power_loops = { structure = "angle_damped", tau_P = "5 ms", tau_Q = "5 ms" }
simulation = { duration = "0.3 s", bridge = "averaged", log_interval = "50 us", P_ref = "5 kW", Q_ref = "0 var" }
controllers = [{ name = "one", kind = "scheduled" }]
events = [{ time = "0.02 s", P_ref = "7 kW" }, { time = "0.1 s", element = "unit3", breaker = "open" }]
"""


def test_units_on_line_are_an_input(tmp_path: Path) -> None:
    """A unit that is told the grid of the node and how many are on line is that of the run, which is told what it sees;
    a number that cannot be is no estimate."""
    plant = study_from_text(PLANT)
    unit, study = unit_of_study(plant), plant_timeline(plant).units[0]
    library = Library(export_unit_c(unit, tmp_path / "c").folder, tmp_path, unit)
    at = {port.name: k for k, port in enumerate(library.ports.inputs)}
    port = library.ports.inputs[at["units"]]
    assert (port.start, port.low, port.high, port.whole) == (3.0, 2.0, 3.0, True)
    node, timeline, T_s, k = plant.grid, build_timeline(study), study.converter.T_s, 0
    one = library.instance()

    def step(given: np.ndarray) -> np.ndarray:
        nonlocal k
        given = given.copy()
        given[at["units"]] = round(timeline.true_grid_at(max((k - 0.5) * T_s, 0.0)).L_g / node.L_g)
        given[at["R_g"]], given[at["L_g"]] = node.R_g, node.L_g
        k += 1
        return one.step(given)

    run = run_loop(study, unit, step)
    runtime = Scheduler(unit.scheduler.lookup, unit.scheduler.settings)
    runtime.start(study.grid.R_g, study.grid.L_g)
    emt = simulated(study, unit, ShippedScheduler(runtime, estimate=true_grid(timeline), sample_interval=T_s))  # type: ignore[arg-type]
    assert np.max(np.abs(run.figures - emt)) <= 1e-11
    out = dict(zip([p.name for p in library.ports.outputs], run.outputs.T, strict=True))
    assert out["L_g_of_gains"][0] == pytest.approx(3.0 * node.L_g, rel=1e-12)
    assert out["L_g_of_gains"][-1] == pytest.approx(2.0 * node.L_g, rel=0.03)
    for wrong in (1.0, 4.0, 2.5, np.nan):
        other, given = library.instance(), np.array([p.start for p in library.ports.inputs])
        given[at["units"]] = wrong
        told = dict(zip(out, np.array([other.step(given) for _ in range(401)])[-1], strict=True))
        assert (told["status_held"], told["reason"]) == (1.0, 5.0)
    loops = Library(export_unit_c(unit, tmp_path / "loops").folder, tmp_path, unit, "reference")
    assert [p.start for p in loops.ports.inputs if p.name == "units"] == [3.0]
    alone, rested = loops.instance(), np.array([p.start for p in loops.ports.inputs])
    names, told = [p.name for p in loops.ports.outputs], np.zeros(0)
    for _ in range(801):
        told = alone.step(rested)
    assert told[names.index("status_fresh")] == 1.0
    assert told[names.index("L_g_of_gains")] == pytest.approx(3.0 * node.L_g, rel=0.03)


def test_fmu(field: Made, builder: Builder, tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    made = export_fmu(field.unit, tmp_path / "fmu", builder=builder)
    place = made.folder / f"{made.manifest['name']}.fmu"
    found = {one.name: (one.min, one.max, one.start) for one in fmpy.read_model_description(place).modelVariables}
    assert found["pair"] == ("1.0", "4.0", "1.0")
    assert field.unit.link is not None
    assert found["v_dc"][2] == repr(field.unit.link.rest)
    fmpy.extract(place, tmp_path / "unzipped")
    one = slave_of(wrapped(field.unit, "controller"), tmp_path / "unzipped", pair=3.0)
    step = step_of(one)
    assert np.array_equal([step(row) for row in field.given()], field.expected(3.0))
    one.freeInstance()
    for wrong in (0.0, 5.0, 2.5, np.nan):
        with pytest.raises(Exception, match="fmi3SetFloat64"):
            slave_of(wrapped(field.unit, "controller"), tmp_path / "unzipped", pair=wrong)


def test_dll(field: Made, builder: Builder, tmp_path: Path) -> None:
    dll = Dll(next(export_dll(field.unit, tmp_path / "dll", builder=builder).folder.glob("*.so")))
    one, T_s = Hosted(dll, start=0.0, pair=3.0), field.unit.T_s
    told = np.array([one.sample(row, k * T_s) for k, row in enumerate(field.given())])
    expected, bridge = field.expected(3.0), [field.outputs.index(f"v_b_{phase}") for phase in "abc"]
    assert np.array_equal(told[1:, bridge], expected[:-1, bridge])  # the delay is in it
    assert np.array_equal(np.delete(told, bridge, 1), np.delete(expected, bridge, 1))
    for wrong in (0.0, 5.0, 2.5, np.nan):
        bad = Hosted(dll, pair=wrong)
        assert bad.call("CheckParameters") == 2
        assert bad.data.LastErrorMessage.decode() == SAID


def test_plecs(field: Made, builder: Builder, tmp_path: Path) -> None:
    """The library of its DLL block and the text of its C-Script."""
    loaded = ctypes.CDLL(str(next(export_plecs(field.unit, tmp_path / "plecs", builder=builder).folder.glob("*.so"))))
    sizes, at = Sizes(), [port.name for port in field.library.ports.parameters].index("pair")
    loaded.plecsSetSizes(ctypes.byref(sizes))
    expected, bridge = field.expected(3.0), [field.outputs.index(f"v_b_{phase}") for phase in "abc"]

    def hosted(pair: float) -> tuple[Any, list[np.ndarray]]:
        arrays = [np.zeros(n) for n in (sizes.numInputs, sizes.numOutputs, sizes.numStates)]
        arrays.append(field.library.parameters.copy())
        arrays[3][at] = pair
        state = State(*(array.ctypes.data for array in arrays), 0.0, None, None)
        loaded.plecsStart(ctypes.byref(state))
        return state, arrays

    state, arrays = hosted(3.0)
    assert state.errorMessage is None
    told = []
    for k, row in enumerate(field.given()):
        arrays[0][:], state.time = row, k * field.unit.T_s
        loaded.plecsOutput(ctypes.byref(state))
        told.append(arrays[1].copy())
    assert np.array_equal(np.delete(told, bridge, 1), np.delete(expected, bridge, 1))
    assert hosted(2.5)[0].errorMessage.decode() == SAID

    host = script_of(field.unit, tmp_path / "script", builder)
    field.given().tofile(tmp_path / "given.bin")
    words = [repr(float(one)) for one in arrays[3]]
    subprocess.run([host, tmp_path / "given.bin", tmp_path / "told.bin", *words], check=True)
    script = np.fromfile(tmp_path / "told.bin").reshape(len(told), -1)
    assert np.array_equal(script[1:], expected[:-1])
    words[at] = "7"
    for wrong, said in ((words, SAID), (words[:2], f"give [] or {len(words)} numbers")):
        done = subprocess.run([host, "a", "b", *wrong], capture_output=True, check=False, cwd=tmp_path)
        assert (done.returncode, said in done.stdout.decode()) == (1, True)


def test_modelica(field: Made, builder: Builder, tmp_path: Path) -> None:
    rumoca = pytest.importorskip("rumoca")
    text = next(
        export_modelica(field.unit, tmp_path / "m", builder=builder).folder.glob("VsgController_*.mo")
    ).read_text()
    rumoca.validate_source(text)
    assert f'assert(pair >= 1.0 and pair <= 4.0 and abs(pair - integer(pair)) <= 0.0, "{SAID}");' in text
    assert 'input Real in_v_dc(unit = "V"' in text


def test_sunspec_says_that_it_has_no_point_for_them(field: Made) -> None:
    left = [one.partition(":")[0] for one in sunspec_map(field.unit)["without a point"]]
    assert {"v_dc", "pair"} <= set(left)


def test_no_wrapper_names_a_port_of_these() -> None:
    """They come from the one list: whatever is added to it is in every form."""
    room = resources.files("vsgdesign.export")
    texts = {file.name: file.read_text() for file in (room / "templates").iterdir() if file.name.endswith(".j2")}
    texts |= {file.name: file.read_text() for file in room.iterdir() if file.name.endswith(".py")}
    own = {"vsg_unit.c.j2", "port_records.py", "ports.py", "unit.py", "unit_content.py", "processor.py"}
    named = re.compile(r"v_dc|V_DC|P_dc|P_DC|P_cut|P_CUT|PAR_PAIR|IN_UNITS|\"(pair|units)\"|\.pair\b|on_line")
    assert {name for name, text in texts.items() if named.search(text)} == own
