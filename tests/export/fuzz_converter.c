/* Any input at all into the exported converter with its field estimator: no undefined behaviour (sanitizers), every
 * output finite, the probe within its largest amplitude, and after some cycles of sound samples an estimator that works
 * again. Arguments: number of samples and seed. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vsg.h"

static uint64_t state;

static uint64_t bits(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

static double uniform(void)
{
    return (double)(bits() >> 11) / 9007199254740992.0;
}

static vsg_real_t hostile(vsg_real_t x)
{
    const uint64_t kind = bits() % 6U;
    const uint64_t pattern = bits();
    if (kind == 0U) {
        x = (vsg_real_t)NAN;
    } else if (kind == 1U) {
        x = (vsg_real_t)INFINITY * (vsg_real_t)(((pattern & 1U) != 0U) ? 1 : -1);
    } else if (kind == 2U) {
        x = (vsg_real_t)0;
    } else if (kind == 3U) {
        memcpy(&x, &pattern, sizeof x);
    } else if (kind == 4U) {
        x = x * (vsg_real_t)40;
    } else {
        x = (vsg_real_t)((pattern & 1U) != 0U ? 3e38 : -3e38);
    }
    return x;
}

static vsg_real_t number(double x, uint64_t one_in)
{
    return ((one_in > 0U) && (bits() % one_in == 0U)) ? hostile((vsg_real_t)x) : (vsg_real_t)x;
}

static void fail(unsigned long sample, const char *what)
{
    printf("sample %lu: %s\n", sample, what);
    exit(1);
}

int main(int count, char **arguments)
{
    static vsg_converter_t x;
    vsg_grid_watch_t watch;
    vsg_controller_output_t out;
    vsg_answer_t answer;
    const double V = 1.0 / (double)vsg_field_settings.per_volt, I = 1.0 / (double)vsg_field_settings.per_ampere;
    const double most = 3.0 * (double)vsg_field_settings.amplitude_burst;
    unsigned long k, calls, cycles = 0UL, valid = 0UL, spoilt = 0UL, begun = 0UL, sound;
    double angle = 0.0, size = 1.0, load = 0.5, lag = 0.1;
    uint16_t inputs = 0U;
    uint32_t ticks = 0U;
    if (count != 3) {
        fail(0UL, "two arguments");
    }
    calls = strtoul(arguments[1], NULL, 10);
    state = strtoull(arguments[2], NULL, 10) * 2654435769U + 88172645463325252U;
    sound = (unsigned long)(12.0 * 6.283185307 / (double)(vsg_references.omega_0 * vsg_field_settings.T_s));
    vsg_converter_init(&x);
    vsg_grid_watch_init(&watch, &vsg_references);
    for (k = 0UL; k < calls + sound; ++k) {
        const uint64_t one_in = (k < calls) ? 3000U : 0U; /* 12 cycles of sound samples at the end */
        vsg_measurement_t m;
        angle += (double)vsg_references.omega_0 * (double)vsg_field_settings.T_s;
        if ((k < calls) && (bits() % 3000U == 0U)) {
            size = 1.5 * uniform();
            load = 3.0 * uniform();
            lag = 6.3 * uniform();
            angle += (bits() % 4U == 0U) ? 6.3 * uniform() : 0.0;
            inputs = (bits() % 3U == 0U) ? (uint16_t)(bits() % 8U) : (uint16_t)0U;
        }
        if (k == calls) {
            size = 1.0;
            load = 0.3;
            inputs = 0U;
        }
        m.v_alpha = number(size * V * cos(angle), one_in);
        m.v_beta = number(size * V * sin(angle), one_in);
        m.i_s_alpha = number(load * I * cos(angle - lag), one_in);
        m.i_s_beta = number(load * I * sin(angle - lag), one_in);
        m.i_g_alpha = number(load * I * cos(angle - lag), one_in);
        m.i_g_beta = number(load * I * sin(angle - lag), one_in);
        if ((inputs & (VSG_INPUT_OPEN | VSG_INPUT_TRIPPED)) != 0U) {
            (void)vsg_control_synchronise(&x.control, &watch, m.v_alpha, m.v_beta, &m);
        }
        begun += (unsigned long)(x.field.restart != 0U);
        if (vsg_converter_sample(&x, &m, inputs, &out) != 0U) {
            if ((k >= calls) || (bits() % 3U == 0U)) { /* the background task takes its time, sometimes too much */
                ticks += 20000U;
                if (vsg_converter_cycle(&x, ticks, &answer) == 0U) {
                    fail(k, "a cycle was due and was not taken");
                }
                cycles += 1UL;
                valid += (unsigned long)(x.estimate.valid > VSG_C(0.5));
                spoilt += (unsigned long)(x.estimate.spoilt > VSG_C(0.5));
                if (!isfinite((double)x.estimate.R_g) || !isfinite((double)x.estimate.L_g) ||
                    !isfinite((double)x.estimate.sigma) || !isfinite((double)answer.gains.K_ip)) {
                    fail(k, "an answer that is no number");
                }
            }
        }
        if (!isfinite((double)out.v_b_alpha) || !isfinite((double)out.v_b_beta) || !isfinite((double)out.omega)) {
            fail(k, "an output that is no number");
        }
        if (!(fabs((double)x.field.u_d) <= most) || !(fabs((double)x.field.u_q) <= most)) {
            fail(k, "a probe beyond its largest amplitude");
        }
        if ((inputs != 0U) && ((x.field.u_d != VSG_C(0.0)) || (x.field.u_q != VSG_C(0.0))) &&
            ((inputs & VSG_INPUT_TRIPPED) == 0U)) {
            fail(k, "a probe that was switched off");
        }
    }
    if ((x.field.restart != 0U) || !(x.field.track.filled > VSG_C(3.5)) || (x.field.overruns == 0U)) {
        fail(k, "it has not recovered, or nothing was tried");
    }
    printf("%lu cycles, %lu valid, %lu spoilt, %lu samples that waited", cycles, valid, spoilt, begun);
    return 0;
}
