"""Five quite different datasheets, as files, and what each must come to by hand."""

from __future__ import annotations

from pathlib import Path

from vsgdesign.study.datasheet import Datasheet, resolve
from vsgdesign.study.datasheet.reading import Entry, Sheet

SIMPLE = {
    "rating": "100 kVA",
    "voltage": "400 V L-L",
    "frequency": "50 Hz",
    "dc_link": "750 V",
    "carrier": "10 kHz",
    "sampling": "twice",
    "delay": "1",
    "pwm": "SVPWM",
    "current_limit": "1.5 pu",
    "L_1": "0.4 mH",
    "R_1": "4 mohm",
    "C": "60 uF star",
    "R_c": "0",
    "L_2": "0.1 mH",
    "R_2": "1 mohm",
    "scr": "1.5 to 20",
    "x_over_r": "0.3 to 20",
}

INDUSTRIAL = """\
Parameter,Value,Unit
Rated power,250,kVA
Rated voltage,480 V L-L,
Frequency,60,Hz
DC link,850 Vdc,
Switching frequency,5,kHz
Sampling,once per carrier,
Computation delay,1 sample,
PWM,SVPWM,
Current limit,390 A rms,
L1,0.1,pu
R1,5,mΩ
Cf,48,µF
Capacitors,Δ,
Damping resistor,30,mohm
L2,3,%
R2,3,mohm
SCR,1.5-20,
X/R,0.3-20,
"""

SMALL = """\
rating = "1 kVA"
voltage = "208 Vac"
frequency = 60
dc_link = 400
carrier = "20 kHz"
sampling = 1
delay = 1
pwm = "third harmonic"
current_limit = "6 A peak"

[filter]
L_1 = "3 mH"
R_1 = 0.15
L_2 = { value = 1, unit = "mH" }
R_2 = "80 mohm"

[capacitor]
value = "0.6 uF"
connection = "delta"

[grid]
scr = [2, 15]
x_over_r = [0.5, 10]
"""

MEDIUM_VOLTAGE = """\
S_n;5 MVA
U_n;3.3 kV
f_n;50 Hz
U_dc;5.2 - 6.0 kV
f_sw;2 kHz
sampling frequency;4 kHz
modulation;SVM
I_max;120 %
L1;0.12 pu
C;0.05 pu
transformer;8 %
short-circuit power;15 MVA to 80 MVA
"""

LC_SUPPLY = """\
Rated active power\t80 kW
Power factor\t0.8
Phase voltage\t230 V
Grid frequency\t50 Hz
DC bus\t750 V
f_sw\t8 kHz
Update\tdouble
Delay\tnone
PWM\tspace vector
Current limit\t1.5 pu
Filter\tLC
L_f\t0.4 mH
ESR_L1\t6 mohm
Filter capacitor\t12 kvar
R_d\t0
Grid impedance\t0.08 ohm to 0.8 ohm
"""

GERMAN = """\
Bezeichnung;Wert;Einheit
Nennleistung;12,5;kVA
Nennspannung;400;V
Netzfrequenz;50;Hz
Zwischenkreisspannung;700;V
Schaltfrequenz;10;kHz
Abtastung;doppelt;
Totzeit;1;Abtastschritt
Modulationsverfahren;Raumzeigermodulation;
Strombegrenzung;1,5;pu
L1;3,0;mH
R1;80;mΩ
Kapazität;10;µF
Kondensatorschaltung;Stern;
Dämpfungswiderstand;2;Ω
L2;3,0;mH
R2;80;mΩ
Kurzschlussverhältnis;1,5 bis 20;
X/R;0,3 bis 20;
"""


def write_all(folder: Path) -> dict[str, Path]:
    """The files, each in the encoding and with the line ends of where it comes from."""
    contents = {
        "industrial.csv": INDUSTRIAL.encode(),
        "small.toml": b"\xef\xbb\xbf" + SMALL.encode(),
        "medium_voltage.csv": MEDIUM_VOLTAGE.replace("\n", "\r\n").encode(),
        "supply.csv": LC_SUPPLY.encode("utf-16"),
        "german.csv": b"\xef\xbb\xbf" + GERMAN.replace("\n", "\r\n").encode(),
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return {name.partition(".")[0]: folder / name for name in contents}


def of(**changes: object) -> Datasheet:
    """The simple converter with some fields changed, taken out (None) or added."""
    return resolve(sheet_of(**changes))


def sheet_of(**changes: object) -> Sheet:
    """The rows of :func:`of`."""
    fields = {key: value for key, value in (SIMPLE | changes).items() if value is not None}
    return Sheet("test", tuple(Entry(key, value, "", key) for key, value in fields.items()))
