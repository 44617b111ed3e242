/* Any input at all into the exported C: no undefined behaviour (sanitizers), no gain outside the certified box, no step
 * above the rate. Arguments: number of calls, seed, and a file for the place, powers and gains of every answer. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vsg.h"
#include "vsg_data.h"

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

/* Mostly sensible, now and then anything: NaN, infinite, denormal, every pattern of bits. */
static vsg_real_t number(double low, double high)
{
    vsg_real_t x = (vsg_real_t)(low + (high - low) * uniform());
    const uint64_t kind = bits() % 40U;
    if (kind == 0U) {
        x = (vsg_real_t)NAN;
    } else if (kind == 1U) {
        x = (vsg_real_t)INFINITY * (vsg_real_t)(((bits() & 1U) != 0U) ? 1 : -1);
    } else if (kind == 2U) {
        x = (vsg_real_t)0 * (vsg_real_t)(((bits() & 1U) != 0U) ? 1 : -1);
    } else if (kind == 3U) {
        x = (vsg_real_t)1e-45F * (vsg_real_t)(bits() % 1000U);
    } else if (kind == 4U) {
        const uint64_t pattern = bits();
        memcpy(&x, &pattern, sizeof x);
    } else if (kind == 5U) {
        x = x * (vsg_real_t)1e6;
    } else {
        /* as it is */
    }
    return x;
}

static void fail(unsigned long call, const char *what)
{
    printf("call %lu: %s\n", call, what);
    exit(1);
}

int main(int count, char **arguments)
{
    const unsigned long calls = strtoul(arguments[1], NULL, 10);
    vsg_scheduler_t s;
    vsg_answer_t a;
    vsg_window_t w;
    uint32_t ticks = 0U;
    unsigned long k;
    unsigned long fresh = 0UL;
    unsigned long moved = 0UL;
    double R = 2.0;
    double L = 6e-3;
    const double factor = (1.0 + (double)vsg_limits.longest_ticks * (double)vsg_limits.rate_per_tick) * (1.0 + 1e-6);
    FILE *answers = (count == 4) ? fopen(arguments[3], "wb") : NULL;
    if (answers == NULL) {
        fail(0UL, "three arguments");
    }
    state = strtoull(arguments[2], NULL, 10) * 2654435769U + 88172645463325252U;
    vsg_init(&s);
    vsg_window_init(&w);
    for (k = 0UL; k < calls; ++k) {
        const vsg_scheduler_t before = s;
        const uint64_t kind = bits() % 100U;
        const vsg_real_t P = number(-6e3, 6e3);
        const vsg_real_t Q = number(-3e3, 3e3);
        const vsg_real_t V = number(80.0, 150.0);
        uint64_t j;
        ticks += (uint32_t)((bits() % 50U == 0U) ? bits() : 20000U); /* time goes backwards, too */
        if (bits() % 30U == 0U) { /* another grid; else the same for a while */
            R = 12.0 * uniform();
            L = 25e-3 * uniform();
        }
        vsg_tell(&s, (uint16_t)((bits() % 20U == 0U) ? bits() : 0U));
        if (kind < 40U) {
            vsg_covariance_t c;
            c.var_R = number(0.0, 0.5);
            c.cov_RL = number(-1e-5, 1e-5);
            c.var_L = number(0.0, 5e-6);
            vsg_update_estimate_with(&s, number(0.97 * R, 1.03 * R), number(0.97 * L, 1.03 * L),
                                     (bits() % 10U == 0U) ? NULL : &c, (uint16_t)((bits() % 10U == 0U) ? bits() : 0U), P, Q,
                                     V, ticks, &a);
        } else if (kind < 80U) {
            vsg_update_estimate(&s, number(0.97 * R, 1.03 * R), number(0.97 * L, 1.03 * L), P, Q, V, ticks, &a);
        } else if (kind < 90U) {
            vsg_hold(&s, P, Q, V, ticks, &a);
        } else if (kind < 95U) {
            vsg_real_t v[VSG_WINDOW];
            vsg_real_t i[VSG_WINDOW];
            for (j = 0U; j < VSG_WINDOW; ++j) {
                v[j] = (vsg_real_t)(300.0 * (uniform() - 0.5));
                i[j] = (vsg_real_t)(30.0 * (uniform() - 0.5));
            }
            if (bits() % 3U == 0U) {
                v[bits() % VSG_WINDOW] = number(-1e3, 1e3);
                i[bits() % VSG_WINDOW] = number(-1e2, 1e2);
            }
            vsg_update(&s, v, i, P, Q, V, ticks, &a);
        } else {
            vsg_real_t sample[2];
            sample[0] = number(-150.0, 150.0);
            sample[1] = number(-15.0, 15.0);
            for (j = bits() % 130U; j > 0U; --j) {
                (void)vsg_push(&w, &sample[0], &sample[1]);
            }
            vsg_update_pushed(&s, &w, P, Q, V, ticks, &a);
        }
        if (!(a.scr >= vsg_limits.scr_low && a.scr <= vsg_limits.scr_high && a.r_over_x >= vsg_limits.r_over_x_low &&
              a.r_over_x <= vsg_limits.r_over_x_high && s.P >= vsg_limits.P_low && s.P <= vsg_limits.P_high &&
              s.Q >= vsg_limits.Q_low && s.Q <= vsg_limits.Q_high && s.V_rms >= vsg_limits.V_low &&
              s.V_rms <= vsg_limits.V_high)) {
            fail(k, "outside the certified box");
        }
        if ((double)a.scr > (double)before.scr * factor || (double)a.scr * factor < (double)before.scr ||
            (double)a.r_over_x > (double)before.r_over_x * factor ||
            (double)a.r_over_x * factor < (double)before.r_over_x) {
            fail(k, "a step above the rate");
        }
        {
            const double told[13] = {(double)s.scr,           (double)s.r_over_x,      (double)s.P,
                                     (double)s.Q,             (double)s.V_rms,         (double)a.gains.K_ip,
                                     (double)a.gains.D_p,     (double)a.gains.K_iq,    (double)a.gains.D_q,
                                     (double)a.gains.K_pq,    (double)a.gains.K_qp,    (double)a.gains.k_P,
                                     (double)a.gains.k_Q};
            for (j = 0U; j < 13U; ++j) {
                if (!(fabs(told[j]) < 1e9)) {
                    fail(k, "a gain that is no number");
                }
            }
            if (fwrite(told, sizeof told, 1U, answers) != 1U) {
                fail(k, "the file cannot be written");
            }
        }
        if (((a.status & VSG_FRESH) != 0U) == ((a.status & VSG_HELD) != 0U) || a.status > 255U || a.reason > 9U ||
            ((a.reason == 0U) != ((a.status & VSG_FRESH) != 0U)) || ((a.status & VSG_FRESH) != 0U && s.doubt != 0U) ||
            ((a.status & VSG_PARTLY) != 0U && (a.status & VSG_FRESH) == 0U) ||
            (((a.status & VSG_DOUBT) != 0U) != (s.doubt != 0U)) || (s.told & (uint16_t)(VSG_TOLD_LIMITED | VSG_TOLD_SURPRISED)) != 0U ||
            ((a.status & VSG_FRESH) != 0U && s.told != 0U)) {
            fail(k, "a status that cannot be");
        }
        fresh += (a.status & VSG_FRESH) != 0U ? 1UL : 0UL;
        moved += (a.scr < before.scr || a.scr > before.scr) ? 1UL : 0UL;
    }
    if (fclose(answers) != 0) {
        fail(k, "the file cannot be written");
    }
    printf("%lu calls, %lu fresh, %lu moved\n", calls, fresh, moved);
    return 0;
}
