"""The bare-metal project: a clean build for both cores, and its self-test in QEMU."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tests.compilers import require_compiler
from tests.export.unit_loop import unit_with
from vsgdesign.export import export_firmware


def test_it_builds_and_passes_its_self_test_in_qemu(tmp_path: Path) -> None:
    """With all warnings as errors. -O0 builds in a third of the time; the page states the instructions of -O2."""
    for program in ("arm-none-eabi-gcc", "qemu-system-arm"):
        require_compiler(program)
    out = export_firmware(unit_with(1), tmp_path / "firmware").folder
    make = ["make", "-s", "-C", str(out)]
    file = out / "Makefile"
    file.write_text(file.read_text().replace("-O2", "-O0"))
    subprocess.run([*make, "firmware_m4.elf"], capture_output=True, check=True, timeout=100)
    told = subprocess.run([*make, "test"], capture_output=True, check=True, timeout=100).stderr.decode()
    assert told.count("selftest 0\n") == 2  # Cortex-M4F and M7
    counts = [int(count) for count in re.findall(r"instructions per sample (\d+)", told)]
    assert len(counts) == 2
    assert all(1000 < count < 20_000 for count in counts)


def test_a_wrong_answer_ends_the_self_test(tmp_path: Path) -> None:
    """The same binary with one known answer bent: make fails, and the number of the answer is told."""
    for program in ("arm-none-eabi-gcc", "qemu-system-arm"):
        require_compiler(program)
    out = export_firmware(unit_with(1), tmp_path / "firmware").folder
    place = out / "sources" / "vsg_power.c"
    text = place.read_text()
    bent = text.replace("p->lost[0] = VSG_C(0.0);", "p->theta = VSG_C(0.5);\n    p->lost[0] = VSG_C(0.0);", 1)
    assert bent != text
    place.write_text(bent)
    file = out / "Makefile"
    file.write_text(file.read_text().replace("-O2", "-O0"))
    done = subprocess.run(["make", "-s", "-C", str(out), "test"], capture_output=True, check=False, timeout=100)
    assert done.returncode != 0
    assert re.search(r"selftest [1-9]", done.stderr.decode())


@pytest.mark.parametrize("delay", [0, 1])
def test_the_drivers_say_when_the_voltage_acts(delay: int, tmp_path: Path) -> None:
    out = export_firmware(unit_with(delay), tmp_path / "firmware").folder
    contract = (out / "drivers.h").read_text()
    assert ("at the beginning of the next period" in contract) == (delay == 1)
