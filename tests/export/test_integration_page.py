"""docs/how-to/integrate-c.md to the letter: its table exported, its interrupt routine compiled and run."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tests.compilers import require_compiler
from vsgdesign.export import export_c_files
from vsgdesign.export.compiled import SOURCES, STRICT, run_compiler

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "integrate-c.md"

STAND_INS = """
#include <stdio.h>
#include "vsg.h"
void start_up(void);
void timer_interrupt(void);
static unsigned long now, updates;
static uint16_t last;
static vsg_real_t angle, delivered;
void measure(vsg_real_t *P, vsg_real_t *Q) { *P = delivered; *Q = VSG_C(0.0); }
int estimate_ready(vsg_real_t *R_g, vsg_real_t *L_g) { *R_g = VSG_C(0.9); *L_g = VSG_C(6e-3); return now > 30000UL; }
void make_voltage(vsg_real_t V_rms, vsg_real_t theta, vsg_real_t omega)
{
    (void)V_rms; (void)theta;
    angle += VSG_C(100e-6) * (omega - VSG_C(314.159265));
    delivered = VSG_C(60000.0) * angle;
}
uint32_t microseconds(void) { return (uint32_t)now; }
void stop(void) { printf("stopped"); }
void log_status(uint16_t status, uint16_t reason) { (void)reason; last = status; updates += 1UL; }
int main(void)
{
    long k;
    start_up();
    for (k = 0; k < 30000; ++k) { now += 100UL; timer_interrupt(); }
    printf("%lu %u %.0f", updates, (unsigned)last, (double)delivered);
    return 0;
}
"""


def test_the_interrupt_routine_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three simulated seconds: 150 updates, the last fresh, and the power is the set point."""
    require_compiler()
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    (first,) = re.findall(r"^## A table\n.*?^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    exec(compile(first, str(PAGE), "exec"), {})
    folder = export_c_files("lab.json", "lab-c").folder
    (routine,) = re.findall(r"^```c\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "routine.c").write_text(routine, encoding="utf-8")
    (tmp_path / "stand_ins.c").write_text(STAND_INS, encoding="utf-8")
    sources = [*(str(folder / name) for name in SOURCES), "routine.c", "stand_ins.c"]
    run_compiler(["gcc", *STRICT, "-O2", f"-I{folder}", *sources, "-o", "program", "-lm"])
    said = subprocess.run([str(tmp_path / "program")], capture_output=True, text=True, check=True).stdout
    updates, status, delivered = map(int, said.split())
    assert (updates, status) == (150, 1)
    assert abs(delivered - 4000) <= 20
