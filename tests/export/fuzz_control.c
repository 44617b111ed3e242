/* Any input at all into the exported controller, its retune and its scheduler: no undefined behaviour (sanitizers),
 * every output finite, the bridge voltage within its limit, V within the box of a limiter that has one.
 * Arguments: number of calls and seed. fuzz_settings.h has the converter: see fuzzing.py. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vsg.h"
#include "vsg_data.h"

#include "fuzz_settings.h"

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

/* Anything but a sensible number. */
static vsg_real_t hostile(vsg_real_t x)
{
    const uint64_t kind = bits() % 7U;
    const uint64_t pattern = bits();
    if (kind == 0U) {
        x = (vsg_real_t)NAN;
    } else if (kind == 1U) {
        x = (vsg_real_t)INFINITY * (vsg_real_t)(((pattern & 1U) != 0U) ? 1 : -1);
    } else if (kind == 2U) {
        x = (vsg_real_t)0 * (vsg_real_t)(((pattern & 1U) != 0U) ? 1 : -1);
    } else if (kind == 3U) {
        x = (vsg_real_t)1e-45F * (vsg_real_t)(pattern % 1000U);
    } else if (kind == 4U) {
        memcpy(&x, &pattern, sizeof x);
    } else if (kind == 5U) {
        x = x * (vsg_real_t)1e6;
    } else {
        x = (vsg_real_t)((pattern & 1U) != 0U ? 3e38 : -3e38);
    }
    return x;
}

/* Now and then anything. */
static vsg_real_t number(double x, uint64_t one_in)
{
    return (bits() % one_in == 0U) ? hostile((vsg_real_t)x) : (vsg_real_t)x;
}

static void fail(unsigned long call, const char *what)
{
    printf("call %lu: %s\n", call, what);
    exit(1);
}

static int bad(vsg_real_t x, double limit)
{
    return !(fabs((double)x) <= limit);
}

int main(int count, char **arguments)
{
    static vsg_control_t c;
    vsg_scheduler_t s;
    vsg_answer_t answer;
    vsg_grid_estimate_t grid;
    const vsg_inner_gains_t inner = FUZZ_INNER_GAINS;
    const vsg_references_t refs = FUZZ_REFERENCES;
    const vsg_controller_settings_t settings = FUZZ_SETTINGS;
    const double V = FUZZ_V_PK, I = FUZZ_I_PK;
    const double v_max = (double)settings.v_max_pk * (1.0 + 1e-5);
    uint32_t ticks = 0U;
    unsigned long k, used = 0UL, limited = 0UL, retuned = 0UL, last_used = 0UL, calls;
    double angle = 0.0, size = 1.0, load = 0.5, lag = 0.0;
    if (count != 3) {
        fail(0UL, "two arguments");
    }
    calls = strtoul(arguments[1], NULL, 10);
    state = strtoull(arguments[2], NULL, 10) * 2654435769U + 88172645463325252U;
    vsg_init(&s);
    vsg_hold(&s, VSG_C(0.0), VSG_C(0.0), refs.V_n, ticks, &answer);
    vsg_grid_of(&answer, &grid);
    vsg_control_init(&c, &answer.gains, &inner, &grid, &refs, &settings);
    for (k = 0UL; k < calls; ++k) {
        vsg_measurement_t m;
        vsg_controller_output_t out;
        angle += (1.0 + 0.02 * (uniform() - 0.5)) * (double)refs.omega_0 * (double)settings.T_s;
        if (bits() % 400U == 0U) { /* another state of the grid */
            size = 1.5 * uniform();
            load = 3.0 * uniform();
            lag = 6.3 * uniform();
            angle += (bits() % 4U == 0U) ? 6.3 * uniform() : 0.0;
        }
        m.v_alpha = number(size * V * cos(angle), 500U);
        m.v_beta = number(size * V * sin(angle), 500U);
        m.i_s_alpha = number(load * I * cos(angle - lag), 500U);
        m.i_s_beta = number(load * I * sin(angle - lag), 500U);
        m.i_g_alpha = number(load * I * cos(angle - lag), 500U);
        m.i_g_beta = number(load * I * sin(angle - lag), 500U);
        if (bits() % 200U == 0U) { /* the scheduler, told anything */
            ticks += (uint32_t)((bits() % 50U == 0U) ? bits() : 20000U);
            vsg_tell(&s, (uint16_t)bits());
            if (bits() % 3U != 0U) {
                vsg_update_estimate(&s, number(1.0 + uniform(), 20U), number(4e-3 + 4e-3 * uniform(), 20U),
                                    number((double)c.state.P_f, 20U), number((double)c.state.Q_f, 20U),
                                    number((double)c.state.V, 20U), ticks, &answer);
            } else {
                vsg_hold(&s, c.state.P_f, c.state.Q_f, c.state.V, ticks, &answer);
            }
            vsg_grid_of(&answer, &grid);
            retuned += vsg_control_retune(&c, &answer.gains, &grid);
        }
        if (bits() % 5000U == 0U) { /* gains and a grid from elsewhere */
            vsg_gains_t gains = answer.gains;
            vsg_grid_estimate_t other = grid;
            const uint64_t which = bits() % 10U;
            vsg_real_t *at[10];
            at[0] = &gains.K_ip; at[1] = &gains.D_p; at[2] = &gains.K_iq; at[3] = &gains.D_q; at[4] = &gains.K_pq;
            at[5] = &gains.K_qp; at[6] = &gains.k_P; at[7] = &gains.k_Q; at[8] = &other.R_g; at[9] = &other.L_g;
            *at[which] = hostile(*at[which]);
            retuned += vsg_control_retune(&c, &gains, &other);
        }
        if (bits() % 20000U == 0U) { /* set points from elsewhere, for a while */
            c.refs.P_ref = hostile(c.refs.P_ref);
        } else if (bits() % 200U == 0U) {
            c.refs = refs;
        } else {
            /* as they are */
        }
        if (bits() % 20000U == 0U) {
            vsg_control_init(&c, &answer.gains, &inner, &grid, &refs, &settings);
        }
        if (vsg_control_step(&c, &m, &out) != 0U) {
            used += 1UL;
            last_used = k;
        } else if (k - last_used > 5000UL) {
            fail(k, "every sample is left out for good");
        } else {
            /* one that is left out */
        }
        if (!(hypot((double)out.v_b_alpha, (double)out.v_b_beta) <= v_max)) {
            fail(k, "a bridge voltage beyond its limit");
        }
        if (bad(out.omega, 1e30) || bad(out.P, 1e30) || bad(out.Q, 1e30) || bad(out.limited, 1.0)) {
            fail(k, "an output that is no number");
        }
        if (bad(c.state.theta, 1e12) || bad(c.state.omega_i, 1e12) || bad(c.state.V, 1e12) ||
            bad(c.state.xi_vd, 1e12) || bad(c.state.xi_id, 1e12) || bad(c.state.i_f_d, 1e12)) {
            fail(k, "a state that is no number");
        }
#ifdef FUZZ_V_BOX
        if (!((double)c.state.V >= FUZZ_V_LOW * (1.0 - 1e-5) && (double)c.state.V <= FUZZ_V_HIGH * (1.0 + 1e-5))) {
            fail(k, "V outside its box");
        }
#endif
        limited += (unsigned long)(out.limited > VSG_C(0.5));
    }
    printf("%lu calls, %lu used, %lu limited, %lu retuned\n", calls, used, limited, retuned);
    return 0;
}
