"""The field estimator in C against Python: one record of samples through both, and the converter as a whole."""

from __future__ import annotations

import cmath
import math
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.artifacts.field_networks import random_field_weights
from tests.compilers import GCC_AND_CLANG, require_compiler
from tests.export.conftest import built
from tests.export.exchange import self_test_of, written
from tests.export.fuzzing import build_converter_fuzz, run_control_fuzz
from vsgdesign.equations.field import (
    FieldAnswer,
    FieldFeatures,
    FieldSettings,
    conclude,
    features,
    first_lock_in,
    first_track,
    listen,
)
from vsgdesign.equations.field import probe_value as probe_of
from vsgdesign.equations.field.fusion import FIRST_GATE, GateLimits
from vsgdesign.errors import ArtifactError
from vsgdesign.export import CompiledC, compile_c, export_c_files
from vsgdesign.export.c_code import export_c
from vsgdesign.export.c_content import Origin
from vsgdesign.export.compiled import OPEN, PROBE_OFF, STRICT, TRIPPED, run_compiler
from vsgdesign.export.field import converter_constants
from vsgdesign.identification.field import FieldNetwork, field_network
from vsgdesign.runtime import load_scheduler
from vsgdesign.study.parameters import Study, study_from_text

STUDY = """
base = "case:hoang2025_5kva"
grid = { scr_basis = "impedance", scr = 4, x_over_r = 3 }
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
inner_loops = { transient_resistance_pu = 0.08 }
controllers = [{ name = "any", kind = "fixed" }]
simulation = { duration = "1 s", P_ref = "0 W", Q_ref = "0 var" }
"""


@pytest.fixture(scope="module")
def study() -> Study:
    return study_from_text(STUDY)


@pytest.fixture(scope="module")
def field_folder(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("field")
    scheduler = load_scheduler(written(place)[0])
    origin = Origin("t", "0" * 64, "s", "0" * 64, limiter=study.current_limiter)
    return export_c(scheduler, origin, place / "c", converter=converter_constants(study)).folder


@pytest.fixture(scope="module", params=["double", "float"])
def field_c(request: pytest.FixtureRequest, field_folder: Path) -> CompiledC:
    return built(field_folder, request.param == "double", "-O0" if request.param == "double" else "-O2")


def a_network() -> FieldNetwork:
    """One that speaks with any certainty, so that all of its equations act."""
    weights = random_field_weights(FieldFeatures._fields, seed=2)
    network = field_network(weights, FieldFeatures._fields)
    return replace(network, gate=GateLimits(first=2.0, first_refuted=1.0, last=12.0, confident=3.0))


@pytest.fixture(scope="module")
def network_c(study: Study, tmp_path_factory: pytest.TempPathFactory) -> CompiledC:
    """Double precision, with the network behind the estimator."""
    place = tmp_path_factory.mktemp("field_network")
    origin = Origin("t", "0" * 64, "s", "0" * 64, limiter=study.current_limiter)
    scheduler = load_scheduler(written(place)[0])
    made = export_c(scheduler, origin, place / "c", converter=converter_constants(study, a_network()))
    return compile_c(made.folder, double=True, flags=("-O0",))


@dataclass
class Recorded:
    """Samples of a small circuit whose impedance jumps, with Python's answers."""

    settings: FieldSettings
    v: np.ndarray
    i: np.ndarray
    sent: np.ndarray
    probes: np.ndarray
    limited: np.ndarray
    closed: np.ndarray
    answers: list[FieldAnswer]
    spoken: list[FieldAnswer]
    """With a network behind the recursions."""


@pytest.fixture(scope="module")
def recorded(study: Study) -> Recorded:
    """24 cycles: learning, a jump from SCR 4 to 9 at the 12th, some limited samples, one that is no number."""
    settings = converter_constants(study).field_settings
    V, Z, T = 1.0 / settings.per_volt, settings.Z_base, settings.T_s
    omega, rng = 0.997 * settings.omega_n, np.random.default_rng(3)
    lock, track, i, frame = first_lock_in(settings, omega), first_track(settings), 0j, cmath.rect(1.0, 0.4)
    rows, answers, spoken, gate, network = [], [], [], FIRST_GATE, a_network()
    while len(answers) < 24:
        R, L = (0.08 * Z, 0.235 * Z / settings.omega_n) if len(answers) < 12 else (0.05 * Z, 0.1 * Z / settings.omega_n)
        u = complex(*probe_of(lock, 1.0, settings))
        sent = complex(np.complex64(u * frame))
        noise = V * 1e-3 * rng.normal(size=4)
        v, limited = V * (frame + sent), 1.0 if rng.random() < 0.002 else 0.0
        v_seen = complex(np.complex64(v + complex(*noise[:2])))
        i_seen = complex(np.complex64(i + complex(*noise[2:]) / Z))
        v_seen = complex(math.nan, 0.0) if len(rows) == 9_100 else v_seen
        rows.append((v_seen, i_seen, sent, u, limited))
        lock = listen(lock, v_seen.real, v_seen.imag, i_seen.real, i_seen.imag, sent.real, sent.imag, limited, settings)
        rows[-1] += (lock.closed,)
        if lock.closed > 0.5:
            lock, track, answer = conclude(lock, track, settings)
            answers.append(FieldAnswer(*map(float, answer)))
            seen = features(lock, track, answer, settings)
            gate, said = network.behind(gate, seen, answers[-1], settings)
            spoken.append(said)
        decay = math.exp(-R * T / L)
        i = decay * i + (1.0 - decay) / R * (v - V * cmath.rect(1.0, -0.1) * frame)
        frame *= cmath.rect(1.0, omega * T)
    v, i_all, sent_all, probes, limited_all, closed = map(np.array, zip(*rows, strict=True))
    assert max(answer.changed for answer in answers) == 1.0  # the jump is seen
    assert max(answer.spoilt for answer in answers) == 1.0
    assert answers[-1].valid == 1.0
    return Recorded(settings, v, i_all, sent_all, probes, limited_all, closed, answers, spoken)


def replayed(compiled: CompiledC, record: Recorded, late: int = 0) -> tuple[list[FieldAnswer], float]:
    """The answers of C, concluded ``late`` samples after the cycle has ended, and the largest error of the probe."""
    found, worst, waited = compiled.field(record.settings, 0.997 * record.settings.omega_n), 0.0, 0
    answers: list[FieldAnswer] = []
    V_n = 1.0 / record.settings.per_volt / math.sqrt(2.0)
    for v, i, sent, u, limited in zip(
        record.v.tolist(), record.i.tolist(), record.sent.tolist(), record.probes.tolist(), record.limited, strict=True
    ):
        now = found.probe(V_n, 0.0, V_n)
        offered = (V_n + now.V) / V_n * cmath.rect(1.0, now.theta) - 1.0
        worst = max(worst, abs(offered - u))
        due = found.listen(v, i, sent, 0.997 * record.settings.omega_n, limited=limited > 0.5)
        waited = waited + 1 if due else 0
        if due and waited > late:
            answer = found.conclude()
            assert answer is not None
            answers.append(answer)
            waited = 0
    return answers, worst


def test_the_answers_of_python(field_c: CompiledC, recorded: Recorded) -> None:
    """Double to 1e-12 of each number, single to 1e-4 of |Z|, and the same decisions in the same cycles."""
    answers, probe = replayed(field_c, recorded)
    assert len(answers) == len(recorded.answers)
    got, wanted = np.array(answers), np.array(recorded.answers)
    if field_c.double:
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-15)
        assert probe <= 1e-12
        return
    decisions = [FieldAnswer._fields.index(name) for name in ("valid", "changed", "event", "doubt", "mode", "spoilt")]
    np.testing.assert_array_equal(got[:, decisions], wanted[:, decisions])
    valid = wanted[:, FieldAnswer._fields.index("valid")] > 0.5
    omega = recorded.settings.omega_n
    Z = wanted[:, 0] + 1j * omega * wanted[:, 1]
    error = np.abs(got[:, 0] + 1j * omega * got[:, 1] - Z)[valid] / np.abs(Z)[valid]
    assert np.max(error) <= 1e-4
    assert probe <= 1e-5  # of the rated voltage, of which the probe is a small part


def test_the_network_behind_it(network_c: CompiledC, recorded: Recorded) -> None:
    """It speaks in some cycles, says in one that the grid has changed, and its answers are those of Python."""
    assert network_c.selftest() == 0
    answers, _ = replayed(network_c, recorded)
    np.testing.assert_allclose(np.array(answers), np.array(recorded.spoken), rtol=1e-11, atol=1e-14)
    spoken = [one != other for one, other in zip(recorded.spoken, recorded.answers, strict=True)]
    assert 0 < sum(spoken) < len(spoken)


def test_its_known_answers(field_c: CompiledC, field_folder: Path, tmp_path: Path) -> None:
    """And a constant that is wrong by a per mille is seen."""
    assert field_c.selftest() == 0
    if field_c.double:
        return
    for path in field_folder.iterdir():
        text = path.read_text(encoding="utf-8")
        if path.name == "vsg_data.c":
            per_volt = text.split("vsg_field_settings = {")[1].split("VSG_C(")[3].split(")")[0]
            bent = text.replace(f"VSG_C({per_volt})", f"VSG_C({float(per_volt) * 1.005!r})")
            assert bent != text
            text = bent
        (tmp_path / path.name).write_text(text, encoding="utf-8")
    assert compile_c(tmp_path, flags=("-O0",)).selftest() > 0


def test_a_nan_is_among_its_known_answers(field_folder: Path, tmp_path: Path) -> None:
    """In a sample and in the memory: the self-test sees that the guard of either is gone."""
    require_compiler()
    copy = Path(shutil.copytree(field_folder, tmp_path / "copy"))
    for name, guard in (
        ("vsg_field.c", "(vsg_all_finite(&size, 1U) != 0U) && (size <= VSG_FIELD_BOUND)"),
        ("vsg_field_laws.h", "VSG_ABS(v_alpha) * settings->per_volt < VSG_FIELD_BEYOND"),
    ):
        sound = (copy / name).read_text(encoding="utf-8")
        assert sound.count(guard) == 1, guard
        (copy / name).write_text(sound.replace(guard, "(1 == 1)"), encoding="utf-8")
        assert self_test_of(copy) != 0, guard
        (copy / name).write_text(sound, encoding="utf-8")
    assert self_test_of(copy) == 0


def test_a_slow_background_task_changes_nothing(field_c: CompiledC, recorded: Recorded) -> None:
    """Samples wait while a cycle is being concluded; with too many the estimator begins anew and says so."""
    assert replayed(field_c, recorded, late=6)[0] == replayed(field_c, recorded)[0][:-1]  # the record ends before it
    found = field_c.field(recorded.settings, recorded.settings.omega_n)
    for v, i, sent in zip(recorded.v[:1000].tolist(), recorded.i.tolist(), recorded.sent.tolist(), strict=False):
        found.listen(v, i, sent, recorded.settings.omega_n)
    assert found.data.overruns == 1
    assert found.data.restart == 1
    answer = found.conclude()  # late, but it must not be believed
    assert answer is not None
    assert answer.valid == 0.0
    found.listen(0j, 0j, 0j, recorded.settings.omega_n)
    assert found.data.restart == 0


def test_inputs(field_c: CompiledC, recorded: Recorded) -> None:
    """Off: no probe at once, and it goes on listening. Tripped or open: nothing is learnt, and all begins anew."""
    found = field_c.field(recorded.settings, recorded.settings.omega_n)
    assert found.probe(110.0, 1.0, 110.0) != (0.0, 0.0, 0.0, 0.0)
    for inputs in (PROBE_OFF, TRIPPED, OPEN):
        assert found.probe(110.0, 1.0, 110.0, inputs) == (0.0, 0.0, 0.0, 0.0)
    for _ in range(600):
        due = found.listen(100 + 0j, 1 + 0j, 0j, recorded.settings.omega_n, inputs=PROBE_OFF)
        assert not due or found.conclude() is not None
    assert found.data.track.filled > -1.0
    for _ in range(600):
        assert not found.listen(100 + 0j, 1 + 0j, 0j, recorded.settings.omega_n, inputs=TRIPPED)
    assert found.probe(110.0, 1.0, 110.0) == (0.0, 0.0, 0.0, 0.0)
    assert not found.listen(100 + 0j, 1 + 0j, 0j, 0.98 * recorded.settings.omega_n)
    assert found.data.track.filled == -1.0
    assert found.data.lock.omega == pytest.approx(0.98 * recorded.settings.omega_n, rel=1e-6)


def test_no_input_spoils_it(field_folder: Path, tmp_path: Path) -> None:
    """NaN, infinite and huge samples, trips and a background task that is too slow, under the sanitizers."""
    program = build_converter_fuzz(field_folder, tmp_path, double=False)
    code, said = run_control_fuzz(program, 40_000, seed=5)
    assert code == 0, said
    cycles, _, spoilt, waited = map(int, re.findall(r"\d+", said))
    assert cycles > 20
    assert spoilt > 0
    assert waited > 0


def test_what_cannot_be_exported_is_said(study: Study, tmp_path: Path) -> None:
    table_file, out = written(tmp_path)[0], tmp_path / "c"
    with pytest.raises(ArtifactError, match=r"no study says which\. Give the study"):
        export_c_files(table_file, out, estimator="field")
    with pytest.raises(ArtifactError, match=r'"kalman": unknown\. Known: field, field_network, none'):
        export_c_files(table_file, out, estimator="kalman")
    with pytest.raises(ArtifactError, match="was not designed from this study"):
        export_c_files(table_file, out, study=study, estimator="field")
    assert not out.exists()


def test_small_and_plain(field_folder: Path, field_c: CompiledC, recorded: Recorded) -> None:
    size = field_c.field(recorded.settings, recorded.settings.omega_n).bytes
    assert 500 < size <= (4096 if field_c.double else 2048)
    text = (field_folder / "vsg_field.c").read_text(encoding="ascii")
    assert "malloc" not in text


@pytest.mark.parametrize("compiler", GCC_AND_CLANG)
@pytest.mark.parametrize("flags", [[], ["-DVSG_DOUBLE"]], ids=["float", "double"])
def test_compiles_without_a_warning(compiler: str, flags: list[str], field_folder: Path) -> None:
    if compiler == "gcc":
        require_compiler()
    sources = [str(path) for path in field_folder.glob("*.c")]
    run_compiler([compiler, *STRICT, "-Wpedantic", "-Wshadow", "-O2", *flags, "-fsyntax-only", *sources])
