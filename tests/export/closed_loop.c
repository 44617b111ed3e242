/* The exported controller on an LCL filter and a grid, in closed loop. The circuit is in double precision whatever the
 * controller's is. Arguments: a file of doubles to read, and one to write P, Q and the frequency of every sample to. */
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

int main(int count, char **arguments)
{
    static vsg_control_t c; /* zero: nothing is lost yet */
    vsg_gains_t other;
    double Phi[3][3], Gamma[3], source[3][2], x[3][2], pending[2], E[2], turn[2], R_c, P_ref;
    long steps, event, retune, k;
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
    event = (long)next();
    P_ref = next();
    retune = (long)next();
    R_c = next();
    for (row = 0; row < 9; ++row) {
        Phi[row / 3][row % 3] = next();
    }
    for (row = 0; row < 3; ++row) {
        Gamma[row] = next();
    }
    for (row = 0; row < 6; ++row) {
        source[row / 2][row % 2] = next();
    }
    for (row = 0; row < 6; ++row) {
        x[row / 2][row % 2] = next();
    }
    E[0] = next();
    E[1] = next();
    turn[0] = next();
    turn[1] = next();
    fill(&c.state, REALS(c.state));
    fill(&c.gains, REALS(c.gains));
    fill(&other, REALS(other));
    fill(&c.inner_gains, REALS(c.inner_gains));
    fill(&c.refs, REALS(c.refs));
    fill(&c.settings, REALS(c.settings));
    pending[0] = (double)c.state.u_alpha;
    pending[1] = (double)c.state.u_beta;
    for (k = 0; k < steps; ++k) {
        vsg_measurement_t m;
        vsg_controller_output_t out;
        double v_b[2], re, im, told[3];
        int axis;
        if (k == event) {
            c.refs.P_ref = (vsg_real_t)P_ref;
        }
        if (k == retune) {
            vsg_control_retune(&c, &other, &c.grid);
        }
        m.v_alpha = (vsg_real_t)(x[1][0] + R_c * (x[0][0] - x[2][0]));
        m.v_beta = (vsg_real_t)(x[1][1] + R_c * (x[0][1] - x[2][1]));
        m.i_s_alpha = (vsg_real_t)x[0][0];
        m.i_s_beta = (vsg_real_t)x[0][1];
        m.i_g_alpha = (vsg_real_t)x[2][0];
        m.i_g_beta = (vsg_real_t)x[2][1];
        vsg_control_step(&c, &m, &out);
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
                x[row][axis] = Phi[row][0] * old[0] + Phi[row][1] * old[1] + Phi[row][2] * old[2] + Gamma[row] * v_b[axis];
            }
        }
        for (row = 0; row < 3; ++row) {
            x[row][0] += source[row][0] * E[0] - source[row][1] * E[1];
            x[row][1] += source[row][0] * E[1] + source[row][1] * E[0];
        }
        re = E[0] * turn[0] - E[1] * turn[1];
        im = E[0] * turn[1] + E[1] * turn[0];
        E[0] = re;
        E[1] = im;
    }
    return (fclose(output) == 0) ? 0 : 2;
}
