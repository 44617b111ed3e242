/* The exported controller on an LCL filter and a grid, in closed loop. The circuit is in double precision whatever the
 * controller's is. Arguments: a file of doubles to read, and one to write P, Q, the
 * frequency and the converter's current of every sample to. */
#include <stdio.h>
#include <stdlib.h>

#include "vsg.h"

#define REALS(x) (sizeof(x) / sizeof(vsg_real_t))

static FILE *input;

static double next(void)
{
    double x = 0.0;
    if (fread(&x, sizeof x, 1U, input) != 1U) {
        exit(2);
    }
    return x;
}

/* Every number of a struct of numbers. */
static void fill(void *record, size_t count)
{
    vsg_real_t *at = (vsg_real_t *)record;
    size_t k;
    for (k = 0U; k < count; ++k) {
        at[k] = (vsg_real_t)next();
    }
}

/* What changes at a sample: the circuit and the source with it, then the gains, then the set point. */
typedef struct {
    long sample;
    double Phi[3][3], Gamma[3], source[3][2];
    double turned[2]; /* the source's vector is multiplied by this complex number */
    int retuned;
    vsg_gains_t gains;
    vsg_grid_estimate_t grid;
    vsg_real_t P_ref;
} change_t;

static void read_change(change_t *change)
{
    int k;
    change->sample = (long)next();
    for (k = 0; k < 9; ++k) {
        change->Phi[k / 3][k % 3] = next();
    }
    for (k = 0; k < 3; ++k) {
        change->Gamma[k] = next();
    }
    for (k = 0; k < 6; ++k) {
        change->source[k / 2][k % 2] = next();
    }
    change->turned[0] = next();
    change->turned[1] = next();
    change->retuned = (int)next();
    fill(&change->gains, REALS(change->gains));
    fill(&change->grid, REALS(change->grid));
    change->P_ref = (vsg_real_t)next();
}

static void multiply(double z[2], const double by[2])
{
    const double re = z[0] * by[0] - z[1] * by[1];
    z[1] = z[0] * by[1] + z[1] * by[0];
    z[0] = re;
}

int main(int count, char **arguments)
{
    static vsg_control_t c; /* zero: nothing is lost yet */
    static change_t changes[16];
    const change_t *now = changes;
    double x[3][2], pending[2], E[2], turn[2], R_c;
    long steps, many, following = 0, k;
    int row, delay;
    FILE *output;
    if (count != 3) {
        return 2;
    }
    input = fopen(arguments[1], "rb");
    output = fopen(arguments[2], "wb");
    if ((input == NULL) || (output == NULL)) {
        return 2;
    }
    steps = (long)next();
    delay = (int)next();
    R_c = next();
    for (row = 0; row < 6; ++row) {
        x[row / 2][row % 2] = next();
    }
    E[0] = next();
    E[1] = next();
    turn[0] = next();
    turn[1] = next();
    fill(&c.state, REALS(c.state));
    fill(&c.inner_gains, REALS(c.inner_gains));
    fill(&c.refs, REALS(c.refs));
    fill(&c.settings, REALS(c.settings));
    many = (long)next();
    if ((many < 1) || (many > 16)) {
        return 2;
    }
    for (k = 0; k < many; ++k) {
        read_change(&changes[k]);
    }
    c.gains = changes[0].gains; /* in force from the start: no change */
    c.grid = changes[0].grid;
    pending[0] = (double)c.state.u_alpha;
    pending[1] = (double)c.state.u_beta;
    for (k = 0; k < steps; ++k) {
        vsg_measurement_t m;
        vsg_controller_output_t out;
        double v_b[2], told[5];
        int axis;
        if ((following < many) && (changes[following].sample == k)) {
            now = &changes[following];
            multiply(E, now->turned);
            if ((now->retuned != 0) && (vsg_control_retune(&c, &now->gains, &now->grid) == 0U)) {
                return 3;
            }
            c.refs.P_ref = now->P_ref;
            following += 1;
        }
        m.v_alpha = (vsg_real_t)(x[1][0] + R_c * (x[0][0] - x[2][0]));
        m.v_beta = (vsg_real_t)(x[1][1] + R_c * (x[0][1] - x[2][1]));
        m.i_s_alpha = (vsg_real_t)x[0][0];
        m.i_s_beta = (vsg_real_t)x[0][1];
        m.i_g_alpha = (vsg_real_t)x[2][0];
        m.i_g_beta = (vsg_real_t)x[2][1];
        told[3] = x[0][0];
        told[4] = x[0][1];
        if (vsg_control_step(&c, &m, &out) == 0U) {
            return 4;
        }
        told[0] = (double)out.P;
        told[1] = (double)out.Q;
        told[2] = (double)out.omega;
        if (fwrite(told, sizeof told, 1U, output) != 1U) {
            return 2;
        }
        v_b[0] = (delay != 0) ? pending[0] : (double)out.v_b_alpha;
        v_b[1] = (delay != 0) ? pending[1] : (double)out.v_b_beta;
        pending[0] = (double)out.v_b_alpha;
        pending[1] = (double)out.v_b_beta;
        for (axis = 0; axis < 2; ++axis) {
            const double old[3] = {x[0][axis], x[1][axis], x[2][axis]};
            for (row = 0; row < 3; ++row) {
                x[row][axis] = now->Phi[row][0] * old[0] + now->Phi[row][1] * old[1] + now->Phi[row][2] * old[2] +
                               now->Gamma[row] * v_b[axis];
            }
        }
        for (row = 0; row < 3; ++row) {
            x[row][0] += now->source[row][0] * E[0] - now->source[row][1] * E[1];
            x[row][1] += now->source[row][0] * E[1] + now->source[row][1] * E[0];
        }
        multiply(E, turn);
    }
    return (fclose(output) == 0) ? 0 : 2;
}
