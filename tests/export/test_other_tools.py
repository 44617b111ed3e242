"""Wrappers for MATLAB, Simulink and Octave, for PLECS and for Modelica, each with the client that can be had."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compilers import require_compiler
from tests.export.unit_loop import Library, on_a_battery, run_loop, study_with, unit_with
from tests.gain_tables import table
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.errors import ArtifactError
from vsgdesign.export import export_all, export_modelica, export_plecs, export_simulink, unit_of
from vsgdesign.export.c_code import export_unit_c
from vsgdesign.export.every_kind import KINDS
from vsgdesign.export.fmu import reference_inputs
from vsgdesign.export.unit import Unit
from vsgdesign.export.wrapping import Builder, in_one_file, legal_name, wrapped

SCHEDULED = 'kind = "scheduled"'
WARNINGS = ("-std=c99", "-DVSG_DOUBLE", "-Wall", "-Wextra", "-Werror", "-O0")


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    require_compiler("gcc")
    with Builder("-O0") as one:
        yield one


@pytest.fixture(scope="module")
def tabled() -> Unit:
    """A controller with a table of 4 × 3 nodes, the field estimator and a battery."""
    scr, x_over_r = np.array([1.5, 3.0, 7.0, 20.0]), np.array([0.5, 2.0, 10.0])
    bend = 1.0 + 0.2 * np.sin(np.arange(12.0)).reshape(4, 3)
    parameters = {"k_1": 15.8 * bend, "d_1": 6.6 * bend[::-1], "k_2": 4.0 * bend, "share_P": np.minimum(bend, 1.0)}
    made = table("angle_damped", "poles", scr=scr, x_over_r=x_over_r, parameters=parameters)
    controller = 'kind = "scheduled", schedule = "table", table = "any.json", estimate = "field"'
    study = on_a_battery(study_with(0, controller, quiet=True))
    return unit_of(study, "one", Ready(tables={"one": made}))


def places(unit: Unit) -> list[tuple[float, float]]:
    """A node, places between nodes, and one beyond the edge, as SCR and R/X."""
    lookup = unit.scheduler.lookup
    between = [(2.2, 0.3), (11.0, 0.15), (5.0, 1.2)]
    return [(lookup.scr[1], lookup.r_over_x[1]), *between, (100.0, 0.01)]


OCTAVE = """
cd('{folder}');
loaded = load('{name}_table.mat').vsg;
{name}_table;
assert(isequaln(loaded.k_1_or_H, vsg.k_1_or_H) && isequal(loaded.scr, vsg.scr) && strcmp(loaded.sha256, vsg.sha256));
places = [{places}];
at = @(x, axis) min(max(x, axis(1)), axis(end));
found = interp2(vsg.r_over_x, vsg.scr, loaded.k_1_or_H, at(places(:, 2), vsg.r_over_x), at(places(:, 1), vsg.scr));
{name}_build;
{name}_buses;
[inputs, parameters] = {name}_mex();
assert(isequal(size({name}_inputs, 1), numel(inputs)) && isequal(cell2mat({name}_parameters(:, 3)), parameters));
at = find(strcmp({name}_parameters(:, 1), 'pair')); parameters(at) = 3;
given = csvread('given.csv');
state = []; told = [];
for k = 1:size(given, 1)
  [out, state] = {name}_mex(given(k, :)', parameters, state);
  told(k, :) = out';
end
failed = '';
try
  [out, state] = {name}_mex([1 2], parameters, []);
catch problem
  failed = problem.message;
end
assert(!isempty(strfind(failed, 'inputs: give')));
parameters(at) = 2.5;
try
  [out, state] = {name}_mex(inputs, parameters, []);
catch problem
  failed = problem.message;
end
assert(!isempty(strfind(failed, 'pair: no whole number from 1 to 4.')));
fid = fopen('told.bin', 'w'); fwrite(fid, [numel(found), found(:)', told'(:)'], 'double'); fclose(fid);
"""


def test_octave_loads_the_table_and_runs_the_mex_function(tabled: Unit, builder: Builder, tmp_path: Path) -> None:
    if shutil.which("octave") is None or shutil.which("mkoctfile") is None:
        pytest.skip("Octave and its headers (octave, octave-dev) are not installed")
    out = export_simulink(tabled, tmp_path / "simulink", builder=builder).folder
    one = wrapped(tabled, "controller", longest=40)
    given = reference_inputs(one)[80:140]
    given[:, [port.name for port in one.ports.inputs].index("v_dc")] *= np.linspace(1.0, 0.8, len(given))
    np.savetxt(out / "given.csv", given, delimiter=",", fmt="%.17g")
    text = OCTAVE.format(folder=out, name=one.name, places="; ".join(f"{s!r}, {r!r}" for s, r in places(tabled)))
    (tmp_path / "run.m").write_text(text)
    done = subprocess.run(["octave", "--no-gui", "-qf", str(tmp_path / "run.m")], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    told = np.fromfile(out / "told.bin")
    count = int(told[0])
    expected = [tabled.scheduler.lookup.normalised(*place) for place in places(tabled)]
    found = told[1 : 1 + count]
    assert all(value is not None for value in expected)
    wanted = np.array([value.k_1_or_H for value in expected if value is not None])
    assert found[0] == wanted[0]  # a node, exactly
    assert np.max(np.abs(found / wanted - 1.0)) <= 1e-12
    library = Library(export_unit_c(tabled, tmp_path / "c").folder, tmp_path, tabled)
    instance = library.instance(pair=3)
    assert np.array_equal(told[1 + count :].reshape(len(given), -1), [instance.step(row) for row in given])


@pytest.mark.parametrize("delay", [0, 1])
def test_the_s_function_is_c(delay: int, tmp_path: Path, builder: Builder) -> None:
    """It was never compiled with Simulink's own header: this one stands for it."""
    out = export_simulink(unit_with(delay), tmp_path / "s", builder=builder).folder
    text = next(out.glob("*_sfun.c"))
    for name in ("simulink.c", "cg_sfun.h"):
        (tmp_path / name).write_text("")
    flags = [*WARNINGS, "-Wno-unused-function", "-DMATLAB_MEX_FILE", "-fsyntax-only", f"-I{tmp_path}"]
    here = Path(__file__).parent
    subprocess.run(["gcc", *flags, f"-I{here}", f"-I{out / 'sources'}", str(text)], check=True)
    assert ("DirectFeedThrough(S, 0, 1)" in text.read_text()) == (delay == 0)


class Sizes(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int) for name in ("numInputs", "numOutputs", "numStates", "numParameters")]


class State(ctypes.Structure):
    _pack_ = 4
    _layout_ = "ms"
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("inputs", "outputs", "states", "parameters")),
        ("time", ctypes.c_double),
        ("errorMessage", ctypes.c_char_p),
        ("userData", ctypes.c_void_p),
    ]


@pytest.mark.parametrize("delay", [0, 1])
def test_the_library_of_plecs_is_the_exported_code(delay: int, builder: Builder, tmp_path: Path) -> None:
    study, unit = study_with(delay), unit_with(delay)
    out = export_plecs(unit, tmp_path / "plecs", builder=builder).folder
    loaded, sizes = ctypes.CDLL(str(next(out.glob("*.so")))), Sizes()
    loaded.plecsSetSizes(ctypes.byref(sizes))
    library = Library(export_unit_c(unit, tmp_path / "c").folder, tmp_path, unit)
    assert (sizes.numInputs, sizes.numOutputs) == (len(library.ports.inputs), len(library.ports.outputs))

    def hosted() -> Any:
        arrays = [np.zeros(n) for n in (sizes.numInputs, sizes.numOutputs, sizes.numStates)]
        arrays.append(library.parameters.copy())
        state = State(*(array.ctypes.data for array in arrays), 0.0, None, None)
        loaded.plecsStart(ctypes.byref(state))
        return state, arrays

    (one, mine), (other, theirs) = hosted(), hosted()
    calls: list[np.ndarray] = []

    def step(given: np.ndarray) -> np.ndarray:
        mine[0][:], theirs[0][:] = given, given[::-1]
        one.time = other.time = len(calls) * unit.T_s
        calls.append(given)
        loaded.plecsOutput(ctypes.byref(other))
        loaded.plecsOutput(ctypes.byref(one))
        return mine[1].copy()

    run = run_loop(study, unit, step, acts_now=True, samples=1900)
    expected = run_loop(study, unit, library.instance().step, samples=1900)
    assert np.array_equal(run.figures, expected.figures)
    one.time += 0.5 * unit.T_s
    loaded.plecsOutput(ctypes.byref(one))
    assert f"has to be called every {unit.T_s!r} s" in one.errorMessage.decode()


HOST = """
#include <stdio.h>
#include <stdlib.h>
static double in_[256], out_[256], state_[1024], CurrentTime;
#define InputSignal(port, k) in_[k]
#define OutputSignal(port, k) out_[k]
#define DiscState(k) state_[k]
static double given_[64];
#define NumParameters 1
#define ParamDim(i, j) ((j) == 0 ? 1 : given_count_)
#define ParamRealData(i, j) given_[j]
#define SetErrorMessage(text) (puts(text), exit(1))
static int given_count_;
{declarations}
int main(int n, char **words)
{{
    FILE *from = fopen(words[1], "rb"), *to = fopen(words[2], "wb");
    for (given_count_ = 0; given_count_ < n - 3; ++given_count_) {{
        given_[given_count_] = atof(words[3 + given_count_]);
    }}
    {start}
    while (fread(in_, sizeof(double), VSG_INPUTS, from) == VSG_INPUTS) {{
        {output}
        fwrite(out_, sizeof(double), VSG_OUTPUTS, to);
        {update}
        CurrentTime += STEP;
    }}
    return fclose(to);
}}
"""


def script_of(unit: Unit, place: Path, builder: Builder, step: float = 1.0) -> Path:
    """The sections of a C-Script in a program of their own, with signals, states and parameters of a block: it takes
    the files of its inputs and of its outputs, and the vector of parameters. ``step``: between its calls, in T_s."""
    out = export_plecs(unit, place / "plecs", builder=builder).folder
    text = next(out.glob("*_cscript.txt")).read_text()
    parts = dict(re.findall(r"^=== (.*?)\n(.*?)(?=^=== |\Z)", text, re.MULTILINE | re.DOTALL))
    source = HOST.format(
        declarations=parts["Code declarations"],
        start=parts["Start function code"],
        output=parts["Output function code"],
        update=parts["Update function code"],
    )
    (out / "host.c").write_text(source)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-O0", f"-DSTEP={step * unit.T_s}"]
    subprocess.run(["gcc", *flags, "host.c", "-o", "host", "-lm"], cwd=out, check=True)
    return out / "host"


@pytest.mark.parametrize("delay", [0, 1])
def test_the_text_of_a_c_script_runs(delay: int, builder: Builder, tmp_path: Path) -> None:
    unit = unit_with(delay, SCHEDULED)
    host = script_of(unit, tmp_path, builder)
    given = reference_inputs(wrapped(unit, "controller"))
    given.tofile(tmp_path / "given.bin")
    subprocess.run([host, "given.bin", "told.bin"], cwd=tmp_path, check=True)
    library = Library(export_unit_c(unit, tmp_path / "c").folder, tmp_path, unit)
    instance = library.instance()
    expected = np.array([instance.step(row) for row in given])
    told = np.fromfile(tmp_path / "told.bin").reshape(len(given), -1)
    assert np.array_equal(told[delay:], expected[: len(given) - delay])
    if delay:
        wrong = script_of(unit, tmp_path / "wrong", builder, step=0.5)
        done = subprocess.run([wrong, "given.bin", "told.bin"], cwd=tmp_path, capture_output=True, check=False)
        assert (done.returncode, f"has to be called every {unit.T_s!r} s" in done.stdout.decode()) == (1, True)


def test_rumoca_finds_the_gains_of_the_table(tabled: Unit, tmp_path: Path) -> None:
    rumoca = pytest.importorskip("rumoca")
    out = export_modelica(tabled, tmp_path / "modelica").folder
    place = next(out.glob("VsgTable_*.mo"))

    for k, (scr, r_over_x) in enumerate(places(tabled)):
        text = re.sub(r"(at_scr = )[^;]+;", rf"\g<1>{scr!r};", place.read_text())
        text = re.sub(r"(at_r_over_x = )[^;]+;", rf"\g<1>{r_over_x!r};", text)
        file = tmp_path / str(k) / "table.mo"
        file.parent.mkdir()
        file.write_text(text)
        model = rumoca.Session().load(str(file), model=f"{place.stem}.Lookup")
        result = model.simulate(t=(0.0, 0.1), dt=0.05)
        wanted = tabled.scheduler.lookup.normalised(scr, r_over_x)
        assert wanted is not None
        for name, value in zip(NormalisedGains._fields, wanted, strict=True):
            got = result[f"y_{name}"][0]
            assert got == value if k == 0 else got == pytest.approx(value, rel=1e-12, abs=1e-300)


def test_the_block_of_modelica_is_parsed_and_its_c_compiles(builder: Builder, tmp_path: Path) -> None:
    rumoca = pytest.importorskip("rumoca")
    for variant in ("controller", "reference"):
        out = export_modelica(unit_with(1, SCHEDULED), tmp_path / variant, variant=variant, builder=builder).folder
        place = next(out.glob("VsgController_*.mo"))
        rumoca.validate_source(place.read_text())
        sources = [str(path) for path in sorted((out / "Resources" / "Source").glob("*.c"))]
        include = f"-I{out / 'Resources' / 'Include'}"
        library = tmp_path / f"{variant}.so"
        subprocess.run(["gcc", *WARNINGS, "-shared", "-fPIC", include, *sources, "-o", str(library), "-lm"], check=True)
        assert hasattr(ctypes.CDLL(str(library)), "vsg_modelica_step")


def test_every_form_at_once(builder: Builder, tmp_path: Path) -> None:
    unit, out = unit_with(1, SCHEDULED), tmp_path / "all"
    made = export_all(unit, out, builder=builder)
    assert sorted(path.name for path in out.iterdir()) == sorted([*made.manifest["kinds"], "manifest.json"])
    assert set(made.manifest["kinds"]) == {"c", *KINDS}
    for name in KINDS:
        assert (out / name / "manifest.json").is_file()
    (out / "fmu" / "mine.txt").write_text("mine")
    with pytest.raises(ArtifactError, match=r"mine\.txt"):
        export_all(unit, out, builder=builder)
    assert (out / "fmu" / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("text", "name"),
    [("lab", "lab"), ("1 kV-Ω", "c_1_kV_Ohm"), ("../x", "c____x"), ("a" * 60, f"{'a' * 43}_11ee39")],
)
def test_a_name_is_legal_and_tells_what_it_was(text: str, name: str) -> None:
    assert legal_name(text) == name
    assert len(name) <= 50


def test_one_file_tells_apart_what_two_files_call_alike() -> None:
    text = in_one_file({"a.c": "static int vsg_x;\n", "b.c": "static int vsg_x;\nstatic int vsg_y;\n"})
    assert text.split("\n") == [
        *("#define vsg_x vsg_x_0", '#include "a.c"', "#undef vsg_x"),
        *("#define vsg_x vsg_x_1", '#include "b.c"', "#undef vsg_x"),
    ]
