/* A recorded run through the exported field estimator. Arguments: a file of doubles to read (number of samples, and 1 if
 * the probe is the record's; then of every sample the voltage, the grid current, theta with the probe, whether the limiter
 * acted, and the probe), and two to write: the sample and the answer of every cycle, and the probe of every sample. Prints nanoseconds: a sample's mean, its 99 % and its longest, a conclusion's
 * mean and longest; then bytes of the state. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "vsg.h"

#define SLOTS 100000
#define CYCLES 20

typedef struct {
    vsg_real_t v[2], i[2], theta, limited, sent[2];
} row_t;

static double now(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static double told[2];

static uint16_t sample(vsg_field_t *f, const row_t *row, vsg_real_t V_n, int exact)
{
    vsg_field_sent_t sent;
    vsg_measurement_t m;
    vsg_field_probe(f, 0U, V_n, row->theta, V_n, &sent);
    if (exact == 2) {
        sent.alpha = row->sent[0];
        sent.beta = row->sent[1];
    } else if (exact == 1) { /* theta of the record has the probe's part already */
        const vsg_real_t c = (vsg_real_t)cos((double)row->theta), s = (vsg_real_t)sin((double)row->theta);
        sent.alpha = f->u_d * c - f->u_q * s;
        sent.beta = f->u_d * s + f->u_q * c;
    }
    told[0] = (double)sent.alpha;
    told[1] = (double)sent.beta;
    m.v_alpha = row->v[0];
    m.v_beta = row->v[1];
    m.i_g_alpha = m.i_s_alpha = row->i[0];
    m.i_g_beta = m.i_s_beta = row->i[1];
    return vsg_field_listen(f, &m, 1U, &sent, (uint16_t)(row->limited > VSG_C(0.5)), 0U, vsg_references.omega_0);
}

int main(int count, char **arguments)
{
    static vsg_field_t f;
    static long slots[SLOTS];
    vsg_field_answer_t answer;
    const vsg_real_t V_n = vsg_references.V_n;
    double header[2], begin, overhead, conclusion = 0.0, block = 0.0, longest = 0.0, mean = 0.0, worst = 0.0;
    long n, k, cycles = 0, within = 0, slot, from = 0;

    row_t *rows;
    FILE *input, *output, *probes;
    if (count != 4) {
        return 2;
    }
    input = fopen(arguments[1], "rb");
    output = fopen(arguments[2], "wb");
    probes = fopen(arguments[3], "wb");
    if ((input == NULL) || (output == NULL) || (probes == NULL) || (fread(header, sizeof header, 1U, input) != 1U)) {
        return 2;
    }
    n = (long)header[0];
    rows = malloc((size_t)n * sizeof *rows);
    if (rows == NULL) {
        return 2;
    }
    for (k = 0; k < n; ++k) {
        double x[8];
        if (fread(x, sizeof x, 1U, input) != 1U) {
            return 2;
        }
        rows[k].v[0] = (vsg_real_t)x[0];
        rows[k].v[1] = (vsg_real_t)x[1];
        rows[k].i[0] = (vsg_real_t)x[2];
        rows[k].i[1] = (vsg_real_t)x[3];
        rows[k].theta = (vsg_real_t)x[4];
        rows[k].limited = (vsg_real_t)x[5];
        rows[k].sent[0] = (vsg_real_t)x[6];
        rows[k].sent[1] = (vsg_real_t)x[7];
    }
    vsg_field_init(&f, &vsg_field_settings, vsg_references.omega_0);
    for (k = 0; k < n; ++k) {
        const uint16_t due = sample(&f, &rows[k], V_n, (header[1] > 0.5) ? 2 : 1);
        if (fwrite(told, sizeof told, 1U, probes) != 1U) {
            return 2;
        }
        if (due != 0U) {
            const vsg_real_t *said = (const vsg_real_t *)&answer;
            double row[1 + sizeof answer / sizeof(vsg_real_t)];
            size_t j;
            (void)vsg_field_conclude(&f, &answer);
            row[0] = (double)k;
            for (j = 0U; j < sizeof answer / sizeof(vsg_real_t); ++j) {
                row[1U + j] = (double)said[j];
            }
            if (fwrite(row, sizeof row, 1U, output) != 1U) {
                return 2;
            }
        }
    }
    begin = now();
    for (k = 0; k < 1000; ++k) {
        (void)now();
    }
    overhead = (now() - begin) / 1000.0;
    /* Means of blocks, of which the least counts: other work on the machine only adds. */
    vsg_field_init(&f, &vsg_field_settings, vsg_references.omega_0);
    begin = now();
    for (k = 0; k < n; ++k) {
        if (sample(&f, &rows[k], V_n, 0) != 0U) { /* a cycle is a block, */
            const double each = (now() - begin - overhead) / (double)(k - from);
            double took;
            mean = ((cycles == 0) || (each < mean)) ? each : mean;
            begin = now();
            (void)vsg_field_conclude(&f, &answer);
            took = now() - begin - overhead;
            longest = (took > longest) ? took : longest;
            block += took;
            cycles += 1;
            if (cycles % CYCLES == 0) { /* and for conclusions so many of them */
                conclusion = ((conclusion <= 0.0) || (block < conclusion)) ? block : conclusion;
                block = 0.0;
            }
            from = k;
            begin = now();
        }
    }
    conclusion /= (double)CYCLES;
    vsg_field_init(&f, &vsg_field_settings, vsg_references.omega_0);
    for (k = 0; k < n; ++k) {
        double took;
        uint16_t due;
        begin = now();
        due = sample(&f, &rows[k], V_n, 0);
        took = now() - begin - overhead;
        worst = (took > worst) ? took : worst;
        slots[(took < 0.0) ? 0 : ((took < (double)SLOTS) ? (long)took : SLOTS - 1)] += 1;
        if (due != 0U) {
            (void)vsg_field_conclude(&f, &answer);
        }
    }
    for (slot = 0; (slot < SLOTS - 1) && (within + slots[slot] < n - n / 100); ++slot) {
        within += slots[slot];
    }
    printf("%.2f %ld %.0f %.0f %.0f %lu %lu %lu", mean, slot, worst, conclusion, longest,
           (unsigned long)sizeof f, (unsigned long)sizeof f.lock, (unsigned long)sizeof f.track);
    free(rows);
    return ((fclose(output) == 0) && (fclose(probes) == 0)) ? 0 : 2;
}
