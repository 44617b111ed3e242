"""docs/how-to/integrate-c.md to the letter: its table exported, its interrupt routine compiled and run."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.compilers import objects_of, require_compiler
from vsgdesign.export import export_c_files
from vsgdesign.export.compiled import STRICT, run_compiler, sources_of

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


FOLLOWING = """
void start_up(void);
void follow(vsg_real_t R_g, vsg_real_t L_g, const vsg_covariance_t *covariance, uint16_t changed, vsg_answer_t *answer);
int main(void)
{
    const vsg_covariance_t wide = {VSG_C(0.25), VSG_C(0.0), VSG_C(2.5e-6)};
    vsg_answer_t answer;
    start_up();
    now = 20000UL;
    follow(VSG_C(0.9), VSG_C(3e-3), &wide, 1U, &answer);
    printf("%u ", (unsigned)(answer.status & (VSG_FRESH | VSG_PARTLY)));
    now = 40000UL;
    follow(VSG_C(0.9), VSG_C(3e-3), 0, 0U, &answer);
    printf("%u", (unsigned)(answer.status & (VSG_FRESH | VSG_PARTLY)));
    return 0;
}
"""


CONTROL_STAND_INS = """
#include <math.h>
#include <stdio.h>
#include "vsg.h"
void start_up(void);
void start_control(void);
void control_interrupt(void);
void schedule(const vsg_answer_t *answer);
static double angle, size;
void sample(vsg_measurement_t *m)
{
    m->v_alpha = (vsg_real_t)(326.6 * cos(angle));
    m->v_beta = (vsg_real_t)(326.6 * sin(angle));
    m->i_s_alpha = (vsg_real_t)(-1.026 * sin(angle)); /* of the filter's capacitor, 10 uF */
    m->i_s_beta = (vsg_real_t)(1.026 * cos(angle));
    m->i_g_alpha = m->i_g_beta = VSG_C(0.0);
}
vsg_real_t grid_angle(void) { return (vsg_real_t)angle; }
void set_bridge_voltage(vsg_real_t alpha, vsg_real_t beta) { size = hypot((double)alpha, (double)beta); }
int main(void)
{
    const vsg_gains_t gains = {VSG_C(1e-3), VSG_C(1e3), VSG_C(0.02), VSG_C(50.0), 0, 0, 0, 0};
    const vsg_answer_t answer = {gains, VSG_FRESH, VSG_REASON_NONE, VSG_C(5.0), VSG_C(0.5)};
    int k;
    angle = 1.0;
    start_control();
    for (k = 0; k < 100; ++k) {
        if (k == 50) { schedule(&answer); }
        control_interrupt();
        angle += 314.159265 * 50e-6;
    }
    printf("%.1f", size);
    return 0;
}
"""


CONVERTER_STAND_INS = """
#include <math.h>
#include <stdio.h>
#include "vsg.h"
void start_converter(void);
void converter_interrupt(void);
void background_task(void);
static double angle;
static int closed, requested;
static long sample_number, closed_at, cycles;
static uint16_t last;
void sample_all(vsg_measurement_t *m, vsg_real_t *v_grid_alpha, vsg_real_t *v_grid_beta)
{
    *v_grid_alpha = (vsg_real_t)(326.6 * cos(angle));
    *v_grid_beta = (vsg_real_t)(326.6 * sin(angle));
    m->v_alpha = *v_grid_alpha;
    m->v_beta = *v_grid_beta;
    m->i_s_alpha = (vsg_real_t)(-1.026 * sin(angle));
    m->i_s_beta = (vsg_real_t)(1.026 * cos(angle));
    m->i_g_alpha = m->i_g_beta = VSG_C(0.0);
}
void set_bridge(vsg_real_t alpha, vsg_real_t beta, int on) { (void)alpha; (void)beta; (void)on; }
int is_tripped(void) { return 0; }
int is_closed(void) { return closed; }
void close_breaker(void) { closed = 1; closed_at = sample_number; }
int probe_is_wanted(void) { return 1; }
uint32_t counter(void) { return (uint32_t)(50L * sample_number); }
void request_background(void) { requested = 1; }
void report(const vsg_field_answer_t *estimate, uint16_t status) { (void)estimate; last = status; cycles += 1; }
void halt(void) { printf("halted"); }
int main(void)
{
    angle = 1.0;
    start_converter();
    for (sample_number = 0; sample_number < 12000; ++sample_number) {
        converter_interrupt();
        if (requested) { requested = 0; background_task(); }
        angle += 314.159265 * 50e-6;
    }
    printf("%ld %ld %u", closed_at, cycles, (unsigned)last);
    return 0;
}
"""


def test_the_whole_converters_routines_run(page: Page, tmp_path: Path) -> None:
    """The breaker closes 0.2 s after both voltages are equal, and the estimator's cycles begin then."""
    said = run(page, page.place / "lab-field-c", page.routines[3], CONVERTER_STAND_INS, tmp_path)
    closed_at, cycles, status = map(int, said.split())
    assert 4000 <= closed_at <= 8000
    assert abs(cycles - (12000 - closed_at) / 400) <= 1
    assert status & 16 == 0  # VSG_ESTIMATE_WAITS


def test_the_interrupt_routine_runs(page: Page, tmp_path: Path) -> None:
    """Three simulated seconds: 150 updates, the last fresh, and the power is the set point."""
    said = run(page, page.folder, page.routines[0], STAND_INS, tmp_path)
    updates, status, delivered = map(int, said.split())
    assert (updates, status) == (150, 1)
    assert abs(delivered - 4000) <= 20


def test_an_estimator_that_knows_its_error_is_followed(page: Page, tmp_path: Path) -> None:
    """A change far away with a wide estimate: accepted at once, and followed in part."""
    stand_ins = STAND_INS[: STAND_INS.index("int main")] + FOLLOWING
    status, exact = map(int, run(page, page.folder, "".join(page.routines[:2]), stand_ins, tmp_path).split())
    assert (status, exact) == (1 + 128, 1)


def test_the_whole_controllers_routine_runs(page: Page, tmp_path: Path) -> None:
    """At no load on a grid of nominal voltage the bridge makes that voltage, and a retuning does not disturb it."""
    size = float(run(page, page.folder, page.routines[2], CONTROL_STAND_INS, tmp_path))
    assert abs(size - 326.6) <= 0.02 * 326.6


@dataclass(frozen=True)
class Page:
    """Where the page's code was run, its first exported folder, and its routines."""

    place: Path
    folder: Path
    routines: list[str]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """The page's table exported, its header of constants written, and its routines."""
    require_compiler()
    text, place = PAGE.read_text(encoding="utf-8"), tmp_path_factory.mktemp("page")
    scope: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        for heading in ("A table", "The whole controller", "Everything of one converter"):
            (code,) = re.findall(rf"^## {heading}\n.*?^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
            exec(compile(code, str(PAGE), "exec"), scope)
        folder = place / export_c_files("lab.json", "lab-c").folder
    routines = re.findall(r"^```c\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert len(routines) == 4
    return Page(place, folder, routines)


def run(page: Page, folder: Path, routine: str, stand_ins: str, build: Path) -> str:
    """What a program of a folder says that was made of a routine and of what stands in for the rest."""
    (build / "routine.c").write_text(routine, encoding="utf-8")
    (build / "stand_ins.c").write_text(stand_ins, encoding="utf-8")
    # The page's routines as they ship; what they call is compiled optimised, and without a warning, in other tests.
    command, quickly, headers = ["gcc", *STRICT, "-O2"], ["gcc", *STRICT, "-O0"], [folder, page.place]
    objects = objects_of(command, [build / "routine.c", build / "stand_ins.c"], headers)
    objects += objects_of(quickly, sources_of(folder), headers)
    run_compiler([*command, *objects, "-o", str(build / "program"), "-lm"])
    return subprocess.run([str(build / "program")], capture_output=True, text=True, check=True).stdout
