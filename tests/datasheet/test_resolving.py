"""Datasheets to converters: five by hand, every synonym, every way to be wrong."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.datasheet.sheets import SIMPLE, of, write_all
from vsgdesign.errors import StudyError
from vsgdesign.study.datasheet import read_sheet, resolve

OMEGA_50, OMEGA_60 = 100.0 * math.pi, 120.0 * math.pi


def faults(**changes: object) -> list[str]:
    with pytest.raises(StudyError) as caught:
        of(**changes)
    return [str(fault) for fault in caught.value.faults]


def test_five_datasheets_by_hand(tmp_path: Path) -> None:
    found = {name: resolve(read_sheet(path)) for name, path in write_all(tmp_path).items()}

    Z = 480.0**2 / 250e3
    a = found["industrial"]
    assert (a.S_rated, a.V_rated_ll_rms, a.f_n, a.V_dc, a.f_sw) == (250e3, 480.0, 60.0, 850.0, 5e3)
    assert (a.samples_per_carrier, a.delay_samples, a.modulation) == (1, 1, "min_max")
    assert a.current_limit_pu == pytest.approx(390.0 * math.sqrt(3.0) * 480.0 / 250e3, rel=1e-12)
    assert pytest.approx(0.1 * Z / OMEGA_60, rel=1e-12) == a.L_1
    assert pytest.approx(0.03 * Z / OMEGA_60, rel=1e-12) == a.L_2
    assert pytest.approx(144e-6, rel=1e-12) == a.C
    assert a.R_c == pytest.approx(0.010, rel=1e-12)
    assert (a.R_1, a.R_2, a.scr, a.x_over_r) == (5e-3, 3e-3, (1.5, 20.0), (0.3, 20.0))
    assert a.assumptions == ()

    b = found["small"]
    assert (b.S_rated, b.V_rated_ll_rms, b.V_dc, b.f_sw, b.samples_per_carrier) == (1e3, 208.0, 400.0, 20e3, 1)
    assert pytest.approx(1.8e-6, rel=1e-12) == b.C
    assert (b.L_1, b.L_2, b.R_1, b.R_2) == (3e-3, 1e-3, 0.15, 0.08)
    assert b.current_limit_pu == pytest.approx(6.0 / math.sqrt(2.0) / (1e3 / math.sqrt(3.0) / 208.0), rel=1e-12)
    assert (b.scr, b.x_over_r) == ((2.0, 15.0), (0.5, 10.0))
    assert {item.field for item in b.assumptions} == {"voltage", "pwm", "R_c"}

    Z = 3300.0**2 / 5e6
    c = found["medium_voltage"]
    assert (c.V_rated_ll_rms, c.V_dc, c.samples_per_carrier, c.current_limit_pu) == (3300.0, 5200.0, 2, 1.2)
    assert pytest.approx(0.12 * Z / OMEGA_50, rel=1e-12) == c.L_1
    assert pytest.approx(0.05 / (Z * OMEGA_50), rel=1e-12) == c.C
    assert pytest.approx(0.08 * Z / OMEGA_50, rel=1e-12) == c.L_2
    assert c.scr == pytest.approx((3.0, 16.0), rel=1e-12)
    assert pytest.approx(0.12 * Z / 30.0, rel=1e-3) == c.R_1
    assert {item.field for item in c.assumptions} == {
        "voltage",
        "dc_link",
        "delay",
        "R_1",
        "R_c",
        "transformer",
        "R_2",
        "x_over_r",
    }

    d = found["supply"]
    assert d.S_rated == pytest.approx(100e3, rel=1e-12)
    assert d.V_rated_ll_rms == pytest.approx(230.0 * math.sqrt(3.0), rel=1e-12)
    assert (d.samples_per_carrier, d.delay_samples, d.L_2, d.R_2) == (2, 0, 0.0, 0.0)
    assert pytest.approx(12e3 / (3.0 * OMEGA_50 * 230.0**2), rel=1e-12) == d.C
    Z = 3.0 * 230.0**2 / 100e3
    assert d.scr == pytest.approx((Z / 0.8, Z / 0.08), rel=1e-12)

    e = found["german"]
    assert (e.S_rated, e.L_1, e.L_2, e.R_c, e.current_limit_pu) == (12.5e3, 3e-3, 3e-3, 2.0, 1.5)
    assert (e.samples_per_carrier, e.delay_samples, e.modulation, e.scr) == (2, 1, "min_max", (1.5, 20.0))
    assert pytest.approx(10e-6, rel=1e-12) == e.C
    assert [item.field for item in e.assumptions] == ["voltage"]


def test_delta_is_three_times_star() -> None:
    """Three capacitors in delta and three of three times the capacitance in star make the same datasheet."""
    assert pytest.approx(of(C="60 uF star").C, rel=1e-15) == of(C="20 uF delta").C
    assert pytest.approx(60e-6, rel=1e-12) == of(C="20 uF", capacitor_connection="Δ").C
    assert of(C="20 uF", capacitor_connection="wye").C == 20e-6
    assert "is not the one that C says" in faults(C="20 uF delta", capacitor_connection="star")[0]


def test_per_unit_kvar_and_farad_agree() -> None:
    in_pu = of(C="0.03 pu").C
    assert pytest.approx(in_pu, rel=1e-12) == of(C="3 kvar").C
    assert pytest.approx(in_pu, rel=1e-12) == of(C=in_pu, capacitor_connection="star").C


@pytest.mark.parametrize(
    ("voltage", "expected"),
    [
        ("480 Vac", 480.0),
        ("480 V L-L", 480.0),
        ("0.48 kV", 480.0),
        ("480Y/277 V", 480.0),
        ("277/480 V", 480.0),
        ("277.128 V L-N", 480.0),
        (480, 480.0),
        ("480", 480.0),
    ],
)
def test_voltages(voltage: object, expected: float) -> None:
    assert of(voltage=voltage, dc_link="900 V").V_rated_ll_rms == pytest.approx(expected, rel=1e-5)


def test_a_voltage_that_does_not_say_which_is_an_assumption() -> None:
    assert [item.field for item in of(voltage="400 V").assumptions] == ["voltage"]
    assert of(voltage="400 V line to line").assumptions == ()


@pytest.mark.parametrize(
    ("pwm", "expected"),
    [
        ("SPWM", "sine_triangle"),
        ("sine-triangle", "sine_triangle"),
        ("Sinusoidal PWM", "sine_triangle"),
        ("SVPWM", "min_max"),
        ("SVM", "min_max"),
        ("space vector modulation", "min_max"),
        ("min-max", "min_max"),
        ("third harmonic injection", "min_max"),
        ("THIPWM", "min_max"),
        ("DPWM", "min_max"),
        ("Space Vector PWM (SVPWM)", "min_max"),
    ],
)
def test_kinds_of_pwm(pwm: str, expected: str) -> None:
    assert of(pwm=pwm).modulation == expected


@pytest.mark.parametrize(
    ("sampling", "expected"),
    [
        ("once", 1),
        ("twice per carrier", 2),
        (2, 2),
        ("4", 4),
        ("20 kHz", 2),
        ("10 kHz", 1),
        ("50 us", 2),
        (20000, 2),
        ("asymmetric", 2),
        ("single update", 1),
        ("2 per period", 2),
        ("once per period", 1),
        ("4 samples / switching period", 4),
        ("2 times per carrier", 2),
        ("2 samples", 2),
    ],
)
def test_sampling(sampling: object, expected: int) -> None:
    assert of(sampling=sampling).samples_per_carrier == expected


@pytest.mark.parametrize(("delay", "expected"), [("0", 0), ("none", 0), (1, 1), ("1.5 Ts", 1), ("one sample", 1)])
def test_delays(delay: object, expected: int) -> None:
    assert of(delay=delay).delay_samples == expected


@pytest.mark.parametrize(
    ("changes", "scr", "said"),
    [
        ({"scr": "4"}, (3.2, 5.0), "scr: 3.2 to 5: one value is no range"),
        ({"scr": [4, 4]}, (3.2, 5.0), "scr: 3.2 to 5: one value is no range"),
        ({"scr": "≥ 1.5"}, (1.5, 20.0), "scr: up to 20: only the least is given"),
        ({"scr": "at least 8"}, (8.0, 32.0), "scr: up to 32"),
        ({"scr": "up to 12"}, (1.5, 12.0), "scr: from 1.5: only the largest is given"),
        ({"scr": None, "Minimum short circuit ratio": "2"}, (2.0, 20.0), "scr: up to 20"),
        ({"scr": None, "short_circuit_power": "400 kVA"}, (3.2, 5.0), "scr: 3.2 to 5"),
        ({"scr": None, "short_circuit_power": "min. 400 kVA"}, (4.0, 20.0), "scr: up to 20"),
        ({"scr": None, "grid_impedance": "≤ 0.5 pu"}, (2.0, 20.0), "scr: up to 20"),
    ],
)
def test_one_value_where_a_range_belongs(changes: dict[str, object], scr: tuple[float, float], said: str) -> None:
    """The other end is assumed, and the assumption is listed: it decides on which grids the table works."""
    sheet = of(**changes)
    assert sheet.scr == pytest.approx(scr, rel=1e-12)
    assert any(f"{item.field}: {item.text}".startswith(said) for item in sheet.assumptions)


def test_one_ratio_of_x_over_r_is_no_range_either() -> None:
    sheet = of(x_over_r="5")
    assert sheet.x_over_r == (4.0, 6.25)
    assert [item.field for item in sheet.assumptions] == ["x_over_r"]


@pytest.mark.parametrize("unit", ["rad/s", "rpm", "1/min"])
def test_a_unit_that_no_field_has_is_no_remark(tmp_path: Path, unit: str) -> None:
    """Without a heading, the third column may hold remarks; 314 rad/s must not become 314 Hz."""
    path = tmp_path / "sheet.csv"
    rows = [f"{key};{value}" for key, value in (SIMPLE | {"frequency": f"100;{unit}"}).items()]
    path.write_text("\n".join(rows))
    with pytest.raises(StudyError, match=rf'"{unit}" is not a unit of this field'):
        resolve(read_sheet(path))


def test_every_assumption_is_said() -> None:
    """With nothing but what must be given, everything else is an assumption, and nothing else is."""
    bare = of(
        **dict.fromkeys(("sampling", "delay", "pwm", "current_limit", "R_1", "R_c", "L_2", "R_2", "scr", "x_over_r")),
        voltage="400 V",
        C="60 uF",
    )
    assert {item.field for item in bare.assumptions} == {
        "voltage",
        "pwm",
        "sampling",
        "delay",
        "current_limit",
        "R_1",
        "capacitor_connection",
        "R_c",
        "filter",
        "scr",
        "x_over_r",
    }
    assert of().assumptions == ()
    assert of(rating="100 kW").assumptions[0].field == "power_factor"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"L_1": "1 H"}, 'L_1 = "1 H": is 1 H, 196.3 pu, and so outside 25.4648 uH to 4.07437 mH. Did you mean 1 mH?'),
        ({"voltage": "480 kV"}, "Did you mean 480 V?"),
        ({"rating": "100 mVA"}, "Did you mean 100 VA?"),
        ({"rating": "-5 kVA"}, "outside 100 VA to 100 MVA"),
        ({"rating": "nan"}, "is not a number with a unit"),
        ({"rating": math.nan}, "is not a number with a unit"),
        ({"rating": math.inf}, "is not a number with a unit"),
        ({"rating": True}, "is not a value"),
        ({"rating": ["5 kVA", "6 kVA"]}, "is a list of 2. Give one value, for example 250 kVA."),
        ({"scr": [2, 5, 10]}, "is a list of 3. Give one value, or both ends of a range, for example 1.5 to 20."),
        ({"x_over_r": "-1 to 3"}, 'x_over_r = "-1 to 3": outside 0.05 to 100. Check it'),
        ({"rating": None}, "rating: missing. Give it, for example rating = 250 kVA."),
        ({"C": "60 F"}, "Did you mean 60 uF?"),
        ({"C": "60 mH"}, "is not a unit of this field"),
        ({"current_limit": "200 A"}, 'Write "A rms" or "A peak"'),
        ({"current_limit": "2 kA rms"}, "is 13.86 pu of 144.3 A rms, outside 0.8 to 5"),
        ({"dc_link": "500 V"}, "makes at most 288.7 V phase peak, and the rated voltage is 326.6 V"),
        ({"dc_link": "600 V", "pwm": "SPWM"}, "say pwm = SVPWM"),
        ({"dc_link": "75 kV"}, "times the rated voltage"),
        ({"frequency": "50/60 Hz"}, "is two frequencies"),
        ({"frequency": "314.16"}, "That is 2π times 50 Hz: did you mean 50 Hz?"),
        ({"frequency": "377 Hz"}, "did you mean 60 Hz?"),
        ({"carrier": "10 Hz"}, "Did you mean 10 kHz?"),
        ({"carrier": "400 Hz"}, "samples 16 times in a cycle"),
        ({"sampling": "15 kHz"}, "is 1.5 samples per carrier"),
        ({"delay": "3"}, "is neither 0 nor 1 sample"),
        ({"pwm": "SVPMW"}, "Did you mean svpwm?"),
        ({"pwm": "delta sigma"}, "is not known"),
        ({"filter": "LC"}, "an LC filter has none"),
        ({"filter": "LCL", "L_2": None, "R_2": None}, "missing of an LCL filter"),
        ({"L_2": None}, "belongs to L_2, which is missing"),
        ({"scr": "20 to 2000"}, "outside 0.5 to 1000"),
        ({"short_circuit_power": "1 MVA"}, "says what scr says"),
        ({"scr": None, "grid_impedance": "0 ohm"}, "is scr inf, outside"),
        ({"voltage": "400/300 V"}, "two voltages"),
        ({"voltage": "0/0 V"}, "outside 30 V to 50 kV"),
        ({"voltage": "566 V peak"}, "Give the rms value"),
        ({"ratting": "5 kVA"}, "unknown field. Did you mean rating?"),
        ({"current_limt": "1 pu"}, "unknown field. Did you mean current_limit?"),
        ({"xyzzy": "5"}, "Take the row out, or give it one of these names"),
        ({"L1": "1 mH"}, "says L_1 a second time"),
        ({"C": "0.2 uF"}, "Did you mean 200 uF?"),
    ],
)
def test_faults(changes: dict[str, object], said: str) -> None:
    found = faults(**changes)
    assert any(said in fault for fault in found), found


def test_all_faults_come_at_once() -> None:
    """The filter's too, although its per-unit base is not known."""
    found = faults(rating="5 mVA", voltage="480 kV", L_1="1 H", C=None, R_c="-1 ohm", pwm="abc", carrrier="10 kHz")
    for word in ("rating", "voltage", "L_1", "C: missing", "R_c", "pwm", "carrrier"):
        assert any(word in fault for fault in found), word


def test_rows_of_no_use_are_named_and_left_out() -> None:
    assert of(**{"Efficiency": "98 %", "Weight (kg)": "120"}).unused == ("Efficiency", "Weight (kg)")


def test_notes_on_what_will_be_hard() -> None:
    assert len(of(carrier="16 kHz").notes) == 1  # the bound of the current after a phase jump, which is always told
    slow = of(carrier="3 kHz", sampling="once")
    assert "times in a period of the filter's highest resonance" in slow.notes[0]
    assert len(of(carrier="3 kHz", sampling="once", delay="0").notes) == 1
    assert "at most 1.06 times the rated voltage" in of(dc_link="600 V").notes[0]
