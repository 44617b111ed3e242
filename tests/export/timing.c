/* Times of the exported C in ns: table lookup alone, gains, one step with an estimate, one step with a window. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>

#include "vsg.c" /* its static functions are timed, too */

static volatile vsg_real_t sink;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

#define TIME(repeats, statement)                     \
    do {                                             \
        double least_ns = 1e30;                      \
        int again;                                   \
        for (again = 0; again < 15; ++again) {       \
            const double begin = now();              \
            unsigned k;                              \
            double ns;                               \
            for (k = 0U; k < (repeats); ++k) {       \
                statement;                           \
            }                                        \
            ns = (now() - begin) / (double)(repeats); \
            least_ns = ns < least_ns ? ns : least_ns; \
        }                                            \
        printf("%.3f\n", least_ns);                  \
    } while (0)

static vsg_real_t scr[256], ratio[256], R[256], L[256];

int main(void)
{
    static vsg_real_t v[VSG_WINDOW], i[VSG_WINDOW];
    vsg_scheduler_t s;
    vsg_answer_t a;
    vsg_normalised_t n;
    uint32_t designed;
    unsigned j;
    for (j = 0U; j < 256U; ++j) {
        scr[j] = vsg_limits.scr_low +
                 (vsg_limits.scr_high - vsg_limits.scr_low) * (vsg_real_t)((j * 97U) % 256U) / (vsg_real_t)256;
        ratio[j] = vsg_limits.r_over_x_low + (vsg_limits.r_over_x_high - vsg_limits.r_over_x_low) *
                                                 (vsg_real_t)((j * 61U) % 256U) / (vsg_real_t)256;
        R[j] = (vsg_real_t)1.3 + (vsg_real_t)0.001 * (vsg_real_t)j;
        L[j] = (vsg_real_t)4e-3;
    }
    for (j = 0U; j < VSG_WINDOW; ++j) {
        v[j] = (vsg_real_t)2 * (vsg_real_t)((37U * j) % 101U) - (vsg_real_t)100;
        i[j] = (vsg_real_t)0.2 * (vsg_real_t)((53U * j) % 97U) - (vsg_real_t)10;
    }
    vsg_init(&s);
    TIME(200000U, vsg_normalised_at(&vsg_table, scr[k & 255U], ratio[k & 255U], &n, &designed);
         sink = n.k_1_or_H + n.d_1_or_zeta + n.k_2 + n.q + n.share_P + n.share_Q);
    TIME(200000U, vsg_update_estimate(&s, R[k & 255U], L[0], (vsg_real_t)3000, (vsg_real_t)500, (vsg_real_t)112,
                                      k * 20000U, &a);
         sink = a.gains.K_ip);
    TIME(20000U, v[k % VSG_WINDOW] = (vsg_real_t)(k % 100U);
         vsg_update(&s, v, i, (vsg_real_t)3000, (vsg_real_t)500, (vsg_real_t)112, k * 20000U, &a);
         sink = a.gains.K_ip);
    return 0;
}
