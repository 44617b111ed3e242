#include <math.h>
#include <stdint.h>
#include <string.h>

/* Single precision unless VSG_DOUBLE is defined, for every file alike. */
#ifdef VSG_DOUBLE
typedef double vsg_real_t;
#define VSG_C(x) (x)
#else
typedef float vsg_real_t;
#define VSG_C(x) (x##F)
#endif

/* A row of constants, and how many they are. */
typedef struct {
    const vsg_real_t *at;
    uint32_t count;
} vsg_numbers_t;

/* What an update is given. */
typedef struct {
    uint32_t said; /* The reason why there is no estimate; NO_REASON: there is one. */
    vsg_real_t R_g; /* The estimate of the grid's resistance, Ohm. */
    vsg_real_t L_g; /* The estimate of the grid's inductance, H. */
    uint32_t has_error; /* 1 where the covariance of the estimate's error is known, else 0. */
    vsg_real_t var_R; /* Variance of R_g, Ohm^2. */
    vsg_real_t cov_RL; /* Covariance of R_g and L_g, Ohm*H. */
    vsg_real_t var_L; /* Variance of L_g, H^2. */
    vsg_real_t P; /* Active power of the power loops, W. */
    vsg_real_t Q; /* Reactive power of the power loops, var. */
    vsg_real_t V_rms; /* Voltage of the power loops, V phase rms. */
    uint32_t ticks; /* The caller's counter, ticks. */
} vsg_scheduler_input_t;

/* Limits of a scheduler. Single precision holds every one of them as it is. */
typedef struct {
    vsg_real_t scr_low; /* Least SCR of the certified box. */
    vsg_real_t scr_high; /* Largest SCR of the certified box. */
    vsg_real_t r_over_x_low; /* Least R/X of the certified box. */
    vsg_real_t r_over_x_high; /* Largest R/X of the certified box. */
    vsg_real_t P_low; /* Least active power of the certified box, W. */
    vsg_real_t P_high; /* Largest active power of the certified box, W. */
    vsg_real_t Q_low; /* Least reactive power of the certified box, var. */
    vsg_real_t Q_high; /* Largest reactive power of the certified box, var. */
    vsg_real_t V_low; /* Least voltage of the certified box, V phase rms. */
    vsg_real_t V_high; /* Largest voltage of the certified box, V phase rms. */
    vsg_real_t R_g_low; /* Least plausible resistance, Ohm. */
    vsg_real_t R_g_high; /* Largest plausible resistance, Ohm. */
    vsg_real_t L_g_low; /* Least plausible inductance, H. */
    vsg_real_t L_g_high; /* Largest plausible inductance, H. */
    vsg_real_t power_range; /* Largest magnitude of P and Q that can be measured, VA. */
    vsg_real_t voltage_range; /* Largest voltage that can be measured, V. */
    vsg_real_t safe_scr; /* SCR of the safe place (eq. safe-place). */
    vsg_real_t safe_r_over_x; /* R/X of the safe place. */
    vsg_real_t rate_per_tick; /* Largest relative change of SCR and of R/X of the place of the gains in a tick. */
    vsg_real_t hysteresis; /* Relative change of SCR and R/X up to which an estimate does not move the goal. */
    vsg_real_t jump; /* Relative change from which on an estimate must be confirmed. */
    vsg_real_t ratio_floor; /* Where R/X is smaller than this, its changes are taken relative to this value. */
    vsg_real_t error_R; /* Error of R for which the gains are designed, as a share of R. */
    vsg_real_t error_X; /* Error of X for which the gains are designed, as a share of X. */
    vsg_real_t error_Z; /* Error of R and of X for which the gains are designed, as a share of the impedance. */
    uint32_t confirm; /* Number of windows that must agree on a jump. */
    uint32_t update_ticks; /* Nominal time between two updates, ticks. */
    uint32_t longest_ticks; /* Longest time for which a single update may move the place, ticks. */
    uint32_t stale_ticks; /* How long a doubt may last before the place moves to the safe place, ticks. */
    /* Age of the last good estimate from which on the place moves to the safe place without any doubt, ticks. */
    uint32_t lost_ticks;
} vsg_scheduler_limits_t;

/* Gains of the power-loop law (eq. power-loop-law). The published structure uses the first four. */
typedef struct {
    vsg_real_t K_ip; /* Integral gain of P in the frequency, rad/(s^2*W) */
    vsg_real_t D_p; /* P-f droop, W*s/rad */
    vsg_real_t K_iq; /* Integral gain of Q in the voltage, V/(s*var) */
    vsg_real_t D_q; /* Q-V droop, var/V (rms) */
    vsg_real_t K_pq; /* Integral gain of Q in the frequency, rad/(s^2*var) */
    vsg_real_t K_qp; /* Integral gain of P in the voltage, V/(s*W) */
    vsg_real_t k_P; /* Gain of P in the angle, rad/(s*W) */
    vsg_real_t k_Q; /* Gain of Q in the angle, rad/(s*var) */
} vsg_gains_t;

/* Everything, besides its inputs, on which the next answer depends. */
typedef struct {
    uint32_t started; /* Whether there was an update: 0 until the first one. */
    uint32_t ticks; /* The caller's counter at the last update, ticks. */
    uint32_t age; /* Time since the last estimate that was followed, ticks. */
    /* Time since the grid may have changed, or since the last surprise, without an estimate that was followed. 0: there
     * is no doubt, ticks. */
    uint32_t doubt;
    /* What was told since the last update: bits of TOLD_LIMITED, TOLD_SURPRISED and TOLD_CHANGED. The last one stays
     * until an estimate is accepted. SURPRISED_BEFORE is kept here, too. */
    uint32_t told;
    /* Windows that agree on a jump so far. While a confirmed jump is followed in part, it stays at their limit. */
    uint32_t agreed;
    /* Time since the estimator decided that the grid has left its place. 0: that place may be returned to, ticks. */
    uint32_t refuted;
    /* The place for which the gains are made. */
    vsg_real_t scr;
    vsg_real_t r_over_x;
    /* The goal: the place to which the present place moves. */
    vsg_real_t goal_scr;
    vsg_real_t goal_r_over_x;
    /* A jump that waits to be confirmed, or is followed in part. */
    vsg_real_t candidate_scr;
    vsg_real_t candidate_r_over_x;
    /* The place that the grid has left. */
    vsg_real_t left_scr;
    vsg_real_t left_r_over_x;
    vsg_real_t P; /* Last good active power, within the box, W. */
    vsg_real_t Q; /* Last good reactive power, within the box, var. */
    vsg_real_t V_rms; /* Last good voltage, within the box, V phase rms. */
    vsg_gains_t gains;
} vsg_scheduler_t;

/* What is left of an update's inputs after the first guards. */
typedef struct {
    uint32_t elapsed; /* Ticks since the last update. */
    uint32_t step; /* Ticks for which the place may move. */
    uint32_t reason; /* Why there is no estimate to follow. */
    uint32_t status; /* REFUSED, CLAMPED or 0. */
    /* What the gains are made for, within the box. */
    vsg_real_t P;
    vsg_real_t Q;
    vsg_real_t V_rms;
} vsg_checked_input_t;

/* Normalised gains over SCR and R/X, and the converter for which they are made. */
typedef struct {
    vsg_numbers_t scr; /* Nodes of SCR on the table's basis, ascending. */
    vsg_numbers_t r_over_x; /* Nodes of R/X, ascending. */
    /* k_1 or H, d_1 or zeta, k_2, q, share_P, share_Q of each node in SI: the nodes of R/X of the first SCR, then those
     * of the next. NO_DESIGN where there is no design. */
    vsg_numbers_t nodes;
    vsg_real_t Z_base; /* Base impedance, Ohm. */
    vsg_real_t omega; /* Nominal angular frequency, rad/s. */
    vsg_real_t R_2; /* Resistance of the filter's grid side, Ohm. */
    vsg_real_t L_2; /* Inductance of the filter's grid side, H. */
    vsg_real_t S_rated; /* Rated power, VA. */
    vsg_real_t D_p; /* P-f droop, W*s/rad; 0 where the gains determine it. */
    vsg_real_t D_q; /* Q-V droop, var/V; 0 where the gains determine it. */
    vsg_real_t V_n; /* Voltage that is assumed before the first measurement, V phase rms. */
} vsg_schedule_table_t;

/* What becomes of an estimate: the reason why it is not followed, and the goal. */
typedef struct {
    uint32_t reason; /* Why the estimate is not followed. */
    vsg_real_t share; /* How much of the way to the estimate is gone; 1: all of it. */
    /* The place to which the present place moves. */
    vsg_real_t goal_scr;
    vsg_real_t goal_r_over_x;
    /* A jump that waits to be confirmed, or is followed in part. */
    vsg_real_t candidate_scr;
    vsg_real_t candidate_r_over_x;
    uint32_t agreed; /* Windows that agree on the jump. */
    uint32_t refuted; /* Ticks since the grid has left a place. */
} vsg_followed_t;

/* The corners of the cell around a place: where their numbers begin, and their weights (eq. bilinear). */
typedef struct {
    /* The first word is the row, the second the column. */
    uint32_t low_low;
    uint32_t low_high;
    uint32_t high_low;
    uint32_t high_high;
    /* Weights in the same order. */
    vsg_real_t w00;
    vsg_real_t w01;
    vsg_real_t w10;
    vsg_real_t w11;
} vsg_corners_t;

/* The parameters of a schedule for one grid. With the Jacobian they give the gains (eq. structure-gains). */
typedef struct {
    vsg_real_t k_1_or_H;
    vsg_real_t d_1_or_zeta;
    vsg_real_t k_2;
    vsg_real_t q;
    vsg_real_t share_P;
    vsg_real_t share_Q;
} vsg_normalised_t;

/* Set points of the power loops. They may be changed between two samples. */
typedef struct {
    vsg_real_t P_ref; /* Active power, W */
    vsg_real_t Q_ref; /* Reactive power, var */
    vsg_real_t omega_0; /* Nominal frequency, rad/s */
    vsg_real_t V_n; /* Voltage of the Q-V droop, V phase rms */
} vsg_references_t;

/* Everything that the controller remembers from one sample to the next. */
typedef struct {
    vsg_real_t theta; /* Angle of the converter's d axis against the stationary alpha axis, rad. */
    vsg_real_t omega_i; /* Frequency integrator of the P loop, rad/s. */
    vsg_real_t V; /* Voltage integrator of the Q loop, V phase rms. */
    vsg_real_t P_f; /* Filtered active power, W. */
    vsg_real_t Q_f; /* Filtered reactive power, var. */
    /* Voltage-loop integrators, A peak. */
    vsg_real_t xi_vd;
    vsg_real_t xi_vq;
    /* Current-loop integrators, V peak. */
    vsg_real_t xi_id;
    vsg_real_t xi_iq;
    /* Grid current behind the low-pass of the transient impedance, A peak. */
    vsg_real_t i_f_d;
    vsg_real_t i_f_q;
    /* Bridge voltage of the last sample; with a delay of one sample it acts from this sample on, V peak. */
    vsg_real_t u_alpha;
    vsg_real_t u_beta;
    vsg_real_t ripple_P; /* Ripple of P at twice the grid's frequency, as the notch predicts it for this sample, W. */
    vsg_real_t ripple_Q; /* Ripple of Q at twice the grid's frequency, as the notch predicts it for this sample, var. */
    vsg_real_t mean_P; /* What the notch holds for the rest of P, W. */
    vsg_real_t mean_Q; /* What the notch holds for the rest of Q, var. */
} vsg_controller_state_t;

/* Constants of the controller, in SI units. They do not change while it runs. */
typedef struct {
    vsg_real_t T_s; /* Sampling period, s. */
    /* 1 - exp(-T_s/tau) of the power filters; 1 means no filter. */
    vsg_real_t smoothing_P;
    vsg_real_t smoothing_Q;
    vsg_real_t omega_C; /* Cross-coupling omega_0 C of the voltage loop, S. */
    vsg_real_t omega_L; /* Cross-coupling omega_0 L_1 of the current loop, Ohm. */
    vsg_real_t i_max_pk; /* Current limit, A peak. */
    vsg_real_t v_max_pk; /* Limit of the bridge voltage, V peak. */
    /* cos and sin of the angle omega_0(d + 1/2)T_s by which the output leads; d is the delay in samples. */
    vsg_real_t advance_cos;
    vsg_real_t advance_sin;
    vsg_real_t smoothing_t; /* 1 - exp(-omega_t T_s) of the transient impedance's low-pass. */
    /* cos and sin of omega_0 T_s/2, by which the frame turns in half a period. */
    vsg_real_t half_cos;
    vsg_real_t half_sin;
    vsg_real_t T_over_L; /* T_s/L_1 of the current prediction, s/H. */
    /* Constants of the notch in front of the power filters; zeros: there is none. */
    vsg_real_t notch_gain;
    vsg_real_t notch_step;
    vsg_real_t notch_back;
} vsg_controller_settings_t;

/* Changes of the power loops' integrators in this sample: theta in rad, omega_i in rad/s, V in V rms. */
typedef struct {
    vsg_real_t theta;
    vsg_real_t omega_i;
    vsg_real_t V;
} vsg_integrator_steps_t;

/* Gains of the voltage loop and the current loop. */
typedef struct {
    vsg_real_t K_pv; /* Proportional gain of the voltage loop, A/V */
    vsg_real_t K_iv; /* Integral gain of the voltage loop, A/(V*s) */
    vsg_real_t K_pc; /* Proportional gain of the current loop, V/A */
    vsg_real_t K_ic; /* Integral gain of the current loop, V/(A*s) */
    vsg_real_t K_ff; /* Share of the grid current that is fed forward */
    vsg_real_t R_t; /* Transient resistance, Ohm */
    vsg_real_t X_t; /* Transient reactance, Ohm */
    vsg_real_t kappa; /* Share of a period by which the converter current is predicted */
} vsg_inner_gains_t;

/* One sample as a limiter sees it. The dq components are peak values in the converter's own frame. */
typedef struct {
    /* Capacitor-node voltage, V. */
    vsg_real_t v_d;
    vsg_real_t v_q;
    /* Converter current, A. */
    vsg_real_t i_s_d;
    vsg_real_t i_s_q;
    /* Grid current, A. */
    vsg_real_t i_g_d;
    vsg_real_t i_g_q;
    /* Error of the voltage loop, V. */
    vsg_real_t e_d;
    vsg_real_t e_q;
    /* Converter current that the voltage loop asks for, A. */
    vsg_real_t i_want_d;
    vsg_real_t i_want_q;
    vsg_real_t V; /* Voltage that the Q loop asks for, phase rms V. */
    vsg_real_t omega_i; /* Frequency integrator of the P loop, rad/s. */
    /* Measured powers before their low-pass, and behind the notch if there is one, W and var. */
    vsg_real_t P;
    vsg_real_t Q;
    vsg_real_t K_pv; /* Proportional gain of the voltage loop, A/V. */
    vsg_real_t full; /* 1 where the bridge voltage of the last sample was at its limit, else 0. */
} vsg_limiter_view_t;

/* Z_hat: the grid impedance that the controller's gains are made for, R_g in Ohm and L_g in H, at the PCC. */
typedef struct {
    vsg_real_t R_g;
    vsg_real_t L_g;
} vsg_grid_estimate_t;

/* What limit answers. */
typedef struct {
    /* Converter current that the current loop gets, A peak. */
    vsg_real_t i_ref_d;
    vsg_real_t i_ref_q;
    /* Error that the integrators of the voltage loop take up, V peak; view.e to leave them alone. */
    vsg_real_t e_d;
    vsg_real_t e_q;
    /* Powers that go on to the power loops, W and var; view.P and view.Q to leave them alone. */
    vsg_real_t P;
    vsg_real_t Q;
    vsg_real_t limited; /* 1 where the limiter acts in this sample, else 0. */
} vsg_limited_sample_t;

/* Sampled alpha-beta components (peak): capacitor-node voltage, converter current, grid current. */
typedef struct {
    /* Voltage at the capacitor, V peak. */
    vsg_real_t v_alpha;
    vsg_real_t v_beta;
    /* Current of the converter, A peak. */
    vsg_real_t i_s_alpha;
    vsg_real_t i_s_beta;
    /* Current into the grid, A peak. */
    vsg_real_t i_g_alpha;
    vsg_real_t i_g_beta;
} vsg_measurement_t;

/* Bridge voltage in alpha-beta (V peak), the frequency used (rad/s), unfiltered P (W) and Q (var), and whether the
 * current limiter acted (1 or 0). */
typedef struct {
    /* Bridge voltage, V peak. */
    vsg_real_t v_b_alpha;
    vsg_real_t v_b_beta;
    vsg_real_t omega; /* Frequency used, rad/s. */
    vsg_real_t P; /* Unfiltered active power, W. */
    vsg_real_t Q; /* Unfiltered reactive power, var. */
    vsg_real_t limited; /* 1 if the current limiter acted, else 0. */
} vsg_controller_output_t;

/* The fundamental of the grid's voltage. Zero and the nominal frequency at first. */
typedef struct {
    /* V peak. */
    vsg_real_t v_alpha;
    vsg_real_t v_beta;
    vsg_real_t omega; /* Frequency, rad/s. */
} vsg_grid_watch_t;

/* What rounding left out of the integrators of vsg_controller_state_t; zero at first. */
typedef struct {
    vsg_real_t theta;
    vsg_real_t omega_i;
    vsg_real_t V;
    vsg_real_t xi_vd;
    vsg_real_t xi_vq;
    vsg_real_t xi_id;
    vsg_real_t xi_iq;
} vsg_controller_state_lost_t;

#ifdef VSG_DOUBLE
#define VSG_ABS fabs
#define VSG_ATAN2 atan2
#define VSG_COS cos
#define VSG_EXP exp
#define VSG_HYPOT hypot
#define VSG_LOG log
#define VSG_SIN sin
#define VSG_SQRT sqrt
#else
#define VSG_ABS fabsf
#define VSG_ATAN2 atan2f
#define VSG_COS cosf
#define VSG_EXP expf
#define VSG_HYPOT hypotf
#define VSG_LOG logf
#define VSG_SIN sinf
#define VSG_SQRT sqrtf
#endif
#ifdef VSG_PRINTED_MATH
#undef VSG_ATAN2
#define VSG_ATAN2 vsg_printed_atan2
#undef VSG_COS
#define VSG_COS vsg_printed_cos
#undef VSG_HYPOT
#define VSG_HYPOT vsg_printed_hypot
#undef VSG_SIN
#define VSG_SIN vsg_printed_sin
#endif

#define VSG_HALF_RANGE ((uint32_t)2147483648UL)
#define VSG_ROUNDED_CORRELATION VSG_C(1.001)
#define VSG_CHI_SQUARE_95 VSG_C(5.991464547107979)
#define VSG_OLDEST ((uint32_t)2147483647UL)
#define VSG_SURPRISED_BEFORE 8U
#define VSG_PHASES VSG_C(3.0)
#define VSG_POWER_MARGIN VSG_C(1.3)
#define VSG_LEAST_SHARE VSG_C(0.2)
#define VSG_ARRIVED VSG_C(1e-05)
#define VSG_TURN VSG_C(6.283185307179586)
#define VSG_SPACE_VECTOR_POWER VSG_C(1.5)
#define VSG_SQRT_2 VSG_C(1.4142135623730951)
#define VSG_AT_THE_LIMIT VSG_C(0.9999)
#define VSG_V_PLAUSIBLE VSG_C(5.0)
#define VSG_I_PLAUSIBLE VSG_C(20.0)
#define VSG_TIMES_NOMINAL VSG_C(10.0)
#define VSG_MOST_FED_BACK VSG_C(0.95)
#define VSG_WATCH_LEAST VSG_C(0.1)
#define VSG_WATCH_BANDWIDTH VSG_C(30.0)
#define VSG_WATCH_RANGE VSG_C(0.1)
#define VSG_IN_STEP VSG_C(0.03)
#define VSG_IN_STEP_V_LOW VSG_C(0.8)
#define VSG_IN_STEP_V_HIGH VSG_C(1.2)

/* Whether a number is neither infinite nor NaN, by its bits: no option of a compiler changes that. */
static inline int vsg_is_number(vsg_real_t x)
{
#ifdef VSG_DOUBLE
    const uint64_t exponent = 0x7FF0000000000000ULL;
    uint64_t bits;
#else
    const uint32_t exponent = 0x7F800000UL;
    uint32_t bits;
#endif
    memcpy(&bits, &x, sizeof(bits));
    return (bits & exponent) != exponent;
}

/* The larger of two; NaN where either is. */
static inline vsg_real_t vsg_max(vsg_real_t a, vsg_real_t b)
{
    return ((a >= b) || (a != a)) ? a : b;
}

/* The smaller of two; NaN where either is. */
static inline vsg_real_t vsg_min(vsg_real_t a, vsg_real_t b)
{
    return ((a <= b) || (a != a)) ? a : b;
}

/* x, drawn to between two limits; NaN where x is. */
static inline vsg_real_t vsg_clip(vsg_real_t x, vsg_real_t low, vsg_real_t high)
{
    const vsg_real_t y = ((x >= low) || (x != x)) ? x : low;
    return ((y <= high) || (y != y)) ? y : high;
}

/* The larger of two counts. */
static inline uint32_t vsg_max_count(uint32_t a, uint32_t b)
{
    return (a >= b) ? a : b;
}

/* The smaller of two counts. */
static inline uint32_t vsg_min_count(uint32_t a, uint32_t b)
{
    return (a <= b) ? a : b;
}

/* How many numbers of an ascending row are not above x. */
static inline uint32_t vsg_not_above(vsg_numbers_t row, vsg_real_t x)
{
    uint32_t found = (uint32_t)0;
    while ((found < row.count) && (row.at[found] <= x)) {
        found = found + (uint32_t)1;
    }
    return found;
}

/* The integrator x after its change dx of one sample. In single precision T_s times a rate may be less than the
 * last digit of x: what a sum leaves out is kept in lost for the next one (Kahan). In double it is x + dx. */
static inline vsg_real_t vsg_advanced(vsg_real_t x, vsg_real_t dx, vsg_real_t *lost)
{
#ifdef VSG_DOUBLE
    *lost = VSG_C(0.0);
    return x + dx;
#else
    const vsg_real_t change = dx - *lost;
    const vsg_real_t sum = x + change;
    *lost = (sum - x) - change;
    return sum;
#endif
}

/* Whether a number is neither infinite nor NaN. */
static inline int vsg_finite(vsg_real_t x)
{
    return vsg_is_number(x);
}

/* Whether every number of an estimate is finite. */
static inline int vsg_estimate_is_finite(const vsg_scheduler_input_t *given)
{
    return vsg_finite(given->R_g) && vsg_finite(given->L_g) && ((given->has_error == 0U) || (vsg_finite(given->var_R)
        && vsg_finite(given->cov_RL) && vsg_finite(given->var_L)));
}

/* Time and inputs: a measurement that is refused is replaced by the last good one. */
static inline void vsg_checked_input(const vsg_scheduler_limits_t *limits, const vsg_scheduler_t *s,
    const vsg_scheduler_input_t *given, vsg_checked_input_t *checked_input)
{
    const vsg_real_t P = given->P;
    const vsg_real_t Q = given->Q;
    const vsg_real_t V_rms = given->V_rms;
    const uint32_t said = given->said;
    const uint32_t elapsed = (s->started != 0U) ? given->ticks - s->ticks : 0U;
    const uint32_t step = vsg_min_count(elapsed, limits->longest_ticks);
    const int backwards = elapsed >= VSG_HALF_RANGE;
    const int numbers = vsg_finite(P) && vsg_finite(Q) && vsg_finite(V_rms);
    const int powers = (VSG_ABS(P) <= limits->power_range) && (VSG_ABS(Q) <= limits->power_range);
    const int in_range = powers && (V_rms >= VSG_C(0.0)) && (V_rms <= limits->voltage_range);
    const int no_number = said == VSG_REASON_NOT_FINITE;
    const int saturated = said == VSG_REASON_SATURATED;
    const int spoilt = (said == VSG_REASON_NONE) && !vsg_estimate_is_finite(given);
    const uint32_t elapsed_new = limits->update_ticks;
    const int condition = !numbers;
    const int condition_new = !in_range;
    const int condition_new_2 = no_number || saturated;
    const uint32_t reason = spoilt ? VSG_REASON_NOT_FINITE : said;
    const uint32_t status = spoilt ? VSG_REFUSED : 0U;
    const uint32_t reason_new = condition_new_2 ? said : reason;
    const uint32_t status_new = condition_new_2 ? VSG_REFUSED : status;
    const uint32_t reason_new_2 = condition_new ? VSG_REASON_RANGE : reason_new;
    const uint32_t status_new_2 = condition_new ? VSG_REFUSED : status_new;
    const uint32_t reason_new_3 = condition ? VSG_REASON_NOT_FINITE : reason_new_2;
    const uint32_t status_new_3 = condition ? VSG_REFUSED : status_new_2;
    const uint32_t elapsed_new_2 = backwards ? elapsed_new : elapsed;
    const uint32_t step_new = backwards ? 0U : step;
    const uint32_t reason_new_4 = backwards ? VSG_REASON_TIME : reason_new_3;
    const uint32_t status_new_4 = backwards ? VSG_REFUSED : status_new_3;
    const int condition_new_3 = status_new_4 == VSG_REFUSED;
    const vsg_real_t P_new = s->P;
    const vsg_real_t Q_new = s->Q;
    const vsg_real_t V_rms_new = s->V_rms;
    const vsg_real_t P_new_2 = vsg_clip(P, limits->P_low, limits->P_high);
    const vsg_real_t Q_new_2 = vsg_clip(Q, limits->Q_low, limits->Q_high);
    const vsg_real_t V_rms_new_2 = vsg_clip(V_rms, limits->V_low, limits->V_high);
    const uint32_t status_new_5 = ((P_new_2 != given->P) || (Q_new_2 != given->Q) || (V_rms_new_2 != given->V_rms))
        ? VSG_CLAMPED : 0U;
    const vsg_real_t P_new_3 = condition_new_3 ? P_new : P_new_2;
    const vsg_real_t Q_new_3 = condition_new_3 ? Q_new : Q_new_2;
    const vsg_real_t V_rms_new_3 = condition_new_3 ? V_rms_new : V_rms_new_2;
    const uint32_t status_new_6 = condition_new_3 ? status_new_4 : status_new_5;
    checked_input->elapsed = elapsed_new_2;
    checked_input->step = step_new;
    checked_input->reason = reason_new_4;
    checked_input->status = status_new_6;
    checked_input->P = P_new_3;
    checked_input->Q = Q_new_3;
    checked_input->V_rms = V_rms_new_3;
}

/* Whether finite numbers can be a covariance: no negative variance, no correlation beyond +-1. */
static inline int vsg_possible_covariance(vsg_real_t var_R, vsg_real_t cov_RL, vsg_real_t var_L)
{
    return (var_R >= VSG_C(0.0)) && (var_L >= VSG_C(0.0)) && (cov_RL * cov_RL <= VSG_ROUNDED_CORRELATION * var_R
        * var_L);
}

/* Whether an estimate can be one of a grid, and its covariance one of an error. */
static inline int vsg_plausible_estimate(const vsg_scheduler_limits_t *limits, const vsg_scheduler_input_t *given)
{
    const int inside = (limits->R_g_low <= given->R_g) && (given->R_g <= limits->R_g_high)
        && ((limits->L_g_low <= given->L_g) && (given->L_g <= limits->L_g_high));
    return inside && ((given->has_error == 0U) || vsg_possible_covariance(given->var_R, given->cov_RL, given->var_L));
}

/* Short-circuit ratio of a grid, taken on |Z_g|. */
static inline vsg_real_t vsg_scr_impedance(vsg_real_t R_g, vsg_real_t L_g, vsg_real_t Z_base, vsg_real_t omega)
{
    return Z_base / VSG_HYPOT(R_g, omega * L_g);
}

/* Returns (scr, r_over_x) of a grid with L_g > 0 (eq. scr). */
static inline void vsg_place_of(const vsg_schedule_table_t *table, vsg_real_t R_g, vsg_real_t L_g, vsg_real_t *scr_out,
    vsg_real_t *r_over_x_out)
{
    const vsg_real_t scr = vsg_scr_impedance(R_g, L_g, table->Z_base, table->omega);
    const vsg_real_t r_over_x = R_g / (table->omega * L_g);
    *scr_out = scr;
    *r_over_x_out = r_over_x;
}

/* Returns (drawn_scr, drawn_r_over_x): a place, drawn into the certified box. */
static inline void vsg_drawn_in(vsg_real_t scr, vsg_real_t r_over_x, const vsg_scheduler_limits_t *limits,
    vsg_real_t *drawn_scr_out, vsg_real_t *drawn_r_over_x_out)
{
    const vsg_real_t drawn_scr = vsg_clip(scr, limits->scr_low, limits->scr_high);
    const vsg_real_t drawn_r_over_x = vsg_clip(r_over_x, limits->r_over_x_low, limits->r_over_x_high);
    *drawn_scr_out = drawn_scr;
    *drawn_r_over_x_out = drawn_r_over_x;
}

/* Returns (R_g, L_g) in Ohm and H for a ratio taken on |Z_g| (eq. scr). */
static inline void vsg_grid_from_scr_impedance(vsg_real_t scr, vsg_real_t x_over_r, vsg_real_t Z_base, vsg_real_t omega,
    vsg_real_t *R_g_out, vsg_real_t *L_g)
{
    const vsg_real_t R_g = Z_base / scr / VSG_HYPOT(VSG_C(1.0), x_over_r);
    *R_g_out = R_g;
    *L_g = R_g * x_over_r / omega;
}

/* Returns (R_g, L_g) of a place in Ohm and H (eq. scr). */
static inline void vsg_grid_at(const vsg_schedule_table_t *table, vsg_real_t scr, vsg_real_t r_over_x,
    vsg_real_t *R_g_out, vsg_real_t *L_g)
{
    vsg_grid_from_scr_impedance(scr, VSG_C(1.0) / r_over_x, table->Z_base, table->omega, R_g_out, L_g);
}

/* Returns (h_R, h_X): by how much the estimate of a true grid R + jX may be off in R and in X (eq. error-set).
 *
 * The widths are those of the box around the true grid that contains both +-error_R of R with +-error_X of X, and every
 * error of at most error_Z*|Z| in any direction. R and X are in one unit, at the rated frequency. */
static inline void vsg_error_half_widths(vsg_real_t R, vsg_real_t X, vsg_real_t error_R, vsg_real_t error_X,
    vsg_real_t error_Z, vsg_real_t *h_R, vsg_real_t *h_X)
{
    const vsg_real_t least = error_Z * VSG_HYPOT(R, X);
    *h_R = vsg_max(error_R * VSG_ABS(R), least);
    *h_X = vsg_max(error_X * VSG_ABS(X), least);
}

/* 1 if the 95 % ellipse of an estimate fits a box of the half-widths h, otherwise the factor by which it would have to
 * shrink (eq. share-that-fits).
 *
 * Whatever the correlation, the ellipse reaches as far as sqrt (?^2 var) in each coordinate. The half-widths must be
 * positive. */
static inline vsg_real_t vsg_share_that_fits(vsg_real_t h_R, vsg_real_t h_X, vsg_real_t var_R, vsg_real_t var_X)
{
    const vsg_real_t reach_R = VSG_SQRT(VSG_CHI_SQUARE_95 * var_R);
    const vsg_real_t reach_X = VSG_SQRT(VSG_CHI_SQUARE_95 * var_X);
    return vsg_min(h_R / vsg_max(reach_R, h_R), h_X / vsg_max(reach_X, h_X));
}

/* The share of the way to an estimate that its covariance allows (eq. share-that-fits). 1: the whole way.
 *
 * The half-widths are those of the error set at the place of the estimate, drawn into the box. */
static inline vsg_real_t vsg_followed_share(const vsg_schedule_table_t *table, const vsg_scheduler_limits_t *limits,
    vsg_real_t scr, vsg_real_t r_over_x, const vsg_scheduler_input_t *given)
{
    vsg_real_t at_scr, at_r_over_x;
    vsg_drawn_in(scr, r_over_x, limits, &at_scr, &at_r_over_x);
    vsg_real_t R, L;
    vsg_grid_at(table, at_scr, at_r_over_x, &R, &L);
    vsg_real_t h_R, h_X;
    vsg_error_half_widths(R, table->omega * L, limits->error_R, limits->error_X, limits->error_Z, &h_R, &h_X);
    return vsg_share_that_fits(h_R, h_X, given->var_R, table->omega * table->omega * given->var_L);
}

/* Whether a place differs from another by at most a relative share (eq. place-band). */
static inline int vsg_near(vsg_real_t scr, vsg_real_t r_over_x, vsg_real_t of_scr, vsg_real_t of_r_over_x,
    vsg_real_t share, vsg_real_t floor_)
{
    const vsg_real_t f = VSG_C(1.0) + share;
    const vsg_real_t band = share * vsg_max(VSG_ABS(of_r_over_x), floor_);
    return (scr <= of_scr * f) && (of_scr <= scr * f) && (VSG_ABS(r_over_x - of_r_over_x) <= band);
}

/* Returns (moved_scr, moved_r_over_x): the goal, moved by a share of the way to an estimate in (ln SCR, ln R/X) (eq.
 * partly-followed).
 *
 * A step that leads towards the place that the grid has left is not made; where it has left none, give the goal itself.
 * All values must be positive. */
static inline void vsg_part_of_the_way(vsg_real_t goal_scr, vsg_real_t goal_r_over_x, vsg_real_t scr,
    vsg_real_t r_over_x, vsg_real_t share, vsg_real_t left_scr, vsg_real_t left_r_over_x, vsg_real_t *moved_scr,
    vsg_real_t *moved_r_over_x)
{
    const vsg_real_t way_scr = VSG_LOG(scr / goal_scr);
    const vsg_real_t way_r = VSG_LOG(r_over_x / goal_r_over_x);
    const vsg_real_t towards = way_scr * VSG_LOG(left_scr / goal_scr) + way_r * VSG_LOG(left_r_over_x / goal_r_over_x);
    const vsg_real_t step = (towards > VSG_C(0.0)) ? VSG_C(0.0) : share;
    *moved_scr = goal_scr * VSG_EXP(step * way_scr);
    *moved_r_over_x = goal_r_over_x * VSG_EXP(step * way_r);
}

/* Plausibility, jump, hysteresis and the estimate's own error. */
static inline void vsg_followed(const vsg_schedule_table_t *table, const vsg_scheduler_limits_t *limits,
    const vsg_scheduler_t *s, const vsg_scheduler_input_t *given, const vsg_checked_input_t *checked,
    vsg_followed_t *followed)
{
    const uint32_t reason = checked->reason;
    const vsg_real_t floor_ = limits->ratio_floor;
    const vsg_real_t goal_scr = s->goal_scr;
    const vsg_real_t goal_r_over_x = s->goal_r_over_x;
    const vsg_real_t candidate_scr = s->candidate_scr;
    const vsg_real_t candidate_r_over_x = s->candidate_r_over_x;
    const uint32_t refuted = (s->refuted > 0U) ? vsg_min_count(s->refuted + checked->elapsed, VSG_OLDEST) : 0U;
    const uint32_t refuted_new = (refuted > limits->stale_ticks) ? 0U : refuted;
    const int condition = (reason == VSG_REASON_NONE) && !vsg_plausible_estimate(limits, given);
    const uint32_t reason_new = condition ? VSG_REASON_IMPLAUSIBLE : reason;
    const int condition_new = (reason_new != VSG_REASON_NONE) && (s->agreed >= limits->confirm);
    /* A confirmed jump that is followed in part waits for its next estimate. */
    const uint32_t agreed = s->agreed;
    const uint32_t agreed_new = condition_new ? agreed : 0U;
    const int condition_new_2 = reason_new == VSG_REASON_NONE;
    vsg_real_t scr, r_over_x;
    vsg_place_of(table, given->R_g, given->L_g, &scr, &r_over_x);
    const int condition_new_3 = given->has_error != 0U;
    const vsg_real_t share = vsg_followed_share(table, limits, scr, r_over_x, given);
    const vsg_real_t share_new = condition_new_3 ? share : VSG_C(1.0);
    const int condition_new_4 = !vsg_near(scr, r_over_x, goal_scr, goal_r_over_x, limits->jump, floor_);
    const int same = (s->agreed > 0U) && vsg_near(scr, r_over_x, candidate_scr, candidate_r_over_x, limits->jump,
        floor_);
    const uint32_t agreed_new_2 = same ? vsg_min_count(s->agreed + 1U, limits->confirm) : 1U;
    const uint32_t agreed_new_3 = ((s->told & VSG_TOLD_CHANGED) != 0U) ? limits->confirm : agreed_new_2;
    const int condition_new_5 = agreed_new_3 < limits->confirm;
    const int condition_new_6 = share_new >= VSG_C(1.0);
    const uint32_t agreed_new_4 = condition_new_6 ? 0U : agreed_new_3;
    const uint32_t reason_new_2 = condition_new_5 ? VSG_REASON_JUMP : reason_new;
    const uint32_t agreed_new_5 = condition_new_5 ? agreed_new_3 : agreed_new_4;
    const uint32_t reason_new_3 = condition_new_4 ? reason_new_2 : reason_new;
    const uint32_t agreed_new_6 = condition_new_4 ? agreed_new_5 : agreed_new;
    const vsg_real_t candidate_scr_new = condition_new_4 ? scr : candidate_scr;
    const vsg_real_t candidate_r_over_x_new = condition_new_4 ? r_over_x : candidate_r_over_x;
    const int condition_new_7 = (reason_new_3 == VSG_REASON_NONE) && !vsg_near(scr, r_over_x, goal_scr, goal_r_over_x,
        limits->hysteresis, floor_);
    const int condition_new_8 = share_new >= VSG_C(1.0);
    vsg_real_t from_scr, from_r;
    vsg_drawn_in(goal_scr, goal_r_over_x, limits, &from_scr, &from_r);
    vsg_real_t to_scr, to_r;
    vsg_drawn_in(scr, r_over_x, limits, &to_scr, &to_r);
    vsg_real_t left_scr, left_r;
    vsg_drawn_in(s->left_scr, s->left_r_over_x, limits, &left_scr, &left_r);
    const int condition_new_9 = refuted_new == 0U;
    const vsg_real_t left_scr_new = condition_new_9 ? from_scr : left_scr;
    const vsg_real_t left_r_new = condition_new_9 ? from_r : left_r;
    vsg_real_t goal_scr_new, goal_r_over_x_new;
    vsg_part_of_the_way(from_scr, from_r, to_scr, to_r, share_new, left_scr_new, left_r_new, &goal_scr_new,
        &goal_r_over_x_new);
    const vsg_real_t goal_scr_new_2 = condition_new_8 ? scr : goal_scr_new;
    const vsg_real_t goal_r_over_x_new_2 = condition_new_8 ? r_over_x : goal_r_over_x_new;
    const vsg_real_t goal_scr_new_3 = condition_new_7 ? goal_scr_new_2 : goal_scr;
    const vsg_real_t goal_r_over_x_new_3 = condition_new_7 ? goal_r_over_x_new_2 : goal_r_over_x;
    const int condition_new_10 = (reason_new_3 == VSG_REASON_NONE) && (share_new >= VSG_C(1.0));
    const uint32_t refuted_new_2 = condition_new_10 ? 0U : refuted_new;
    const uint32_t reason_new_4 = condition_new_2 ? reason_new_3 : reason_new;
    const uint32_t agreed_new_7 = condition_new_2 ? agreed_new_6 : agreed_new;
    const vsg_real_t share_new_2 = condition_new_2 ? share_new : VSG_C(1.0);
    const vsg_real_t goal_scr_new_4 = condition_new_2 ? goal_scr_new_3 : goal_scr;
    const vsg_real_t goal_r_over_x_new_4 = condition_new_2 ? goal_r_over_x_new_3 : goal_r_over_x;
    const vsg_real_t candidate_scr_new_2 = condition_new_2 ? candidate_scr_new : candidate_scr;
    const vsg_real_t candidate_r_over_x_new_2 = condition_new_2 ? candidate_r_over_x_new : candidate_r_over_x;
    const uint32_t refuted_new_3 = condition_new_2 ? refuted_new_2 : refuted_new;
    followed->reason = reason_new_4;
    followed->share = share_new_2;
    followed->goal_scr = goal_scr_new_4;
    followed->goal_r_over_x = goal_r_over_x_new_4;
    followed->candidate_scr = candidate_scr_new_2;
    followed->candidate_r_over_x = candidate_r_over_x_new_2;
    followed->agreed = agreed_new_7;
    followed->refuted = refuted_new_3;
}

/* Ticks of doubt: they begin with a surprise, and anew with a new one. */
static inline uint32_t vsg_doubt_after(const vsg_scheduler_t *s, uint32_t reason, uint32_t elapsed)
{
    const int surprised = (s->told & VSG_TOLD_SURPRISED) != 0U;
    const int condition = (reason != VSG_REASON_NONE) && (s->doubt > 0U) && !(surprised
        && ((s->told & VSG_SURPRISED_BEFORE) == 0U));
    const uint32_t doubt = vsg_min_count(s->doubt + elapsed, VSG_OLDEST);
    const int condition_new = (reason != VSG_REASON_NONE) && ((s->told != 0U) || (reason == VSG_REASON_JUMP));
    const uint32_t doubt_new = condition_new ? 1U : 0U;
    const uint32_t doubt_new_2 = condition ? doubt : doubt_new;
    return doubt_new_2;
}

/* The goal, limited to at most a factor away from the present value (eq. place-rate). */
static inline vsg_real_t vsg_limited(vsg_real_t goal, vsg_real_t present, vsg_real_t factor)
{
    return vsg_clip(goal, present / factor, present * factor);
}

/* Returns (low, high, fraction): between which nodes of an axis a value is, and how far on the way.
 *
 * Beyond the ends it is at the end. An axis with one node has this node for every value. */
static inline void vsg_interval(vsg_numbers_t axis, vsg_real_t value, uint32_t *low_out, uint32_t *high_out,
    vsg_real_t *fraction)
{
    const uint32_t low = vsg_min_count(vsg_max_count(vsg_not_above(axis, value), 1U), vsg_max_count(axis.count, 2U)
        - 1U) - 1U;
    const uint32_t high = vsg_min_count(low + 1U, axis.count - 1U);
    const vsg_real_t width = (high > low) ? axis.at[high] - axis.at[low] : VSG_C(1.0);
    const vsg_real_t inside = vsg_clip(value, axis.at[0U], axis.at[axis.count - 1U]);
    *low_out = low;
    *high_out = high;
    *fraction = (inside - axis.at[low]) / width;
}

/* The weighted sum of the corners in a column of the table (eq. bilinear). */
static inline vsg_real_t vsg_blend(vsg_numbers_t nodes, const vsg_corners_t *at, uint32_t column)
{
    const vsg_real_t low = at->w00 * nodes.at[at->low_low + column] + at->w01 * nodes.at[at->low_high + column];
    return low + at->w10 * nodes.at[at->high_low + column] + at->w11 * nodes.at[at->high_high + column];
}

/* Whether a corner has a weight, but no design. */
static inline int vsg_outside(vsg_numbers_t nodes, uint32_t corner, vsg_real_t weight)
{
    return (nodes.at[corner] < VSG_C(0.0)) && (weight > VSG_C(0.0));
}

/* Returns (normalised, designed) at a place (eq. bilinear). designed is 0 where a node with a weight has no design;
 * then the first result means nothing. */
static inline void vsg_normalised_at(const vsg_schedule_table_t *table, vsg_real_t scr, vsg_real_t r_over_x,
    vsg_normalised_t *normalised, uint32_t *designed_out)
{
    uint32_t row, next_row;
    vsg_real_t r;
    vsg_interval(table->scr, scr, &row, &next_row, &r);
    uint32_t column, next_column;
    vsg_real_t c;
    vsg_interval(table->r_over_x, r_over_x, &column, &next_column, &c);
    const vsg_real_t r_left = VSG_C(1.0) - r;
    const vsg_real_t c_left = VSG_C(1.0) - c;
    const vsg_real_t w00 = r_left * c_left;
    const vsg_real_t w01 = r_left * c;
    const vsg_real_t w10 = r * c_left;
    const vsg_real_t w11 = r * c;
    const uint32_t columns = table->r_over_x.count;
    const vsg_numbers_t nodes = table->nodes;
    const uint32_t a = (row * columns + column) * 6U;
    const uint32_t b = (row * columns + next_column) * 6U;
    const uint32_t d = (next_row * columns + column) * 6U;
    const uint32_t e = (next_row * columns + next_column) * 6U;
    const vsg_corners_t at = {.low_low = a, .low_high = b, .high_low = d, .high_high = e, .w00 = w00, .w01 = w01,
        .w10 = w10, .w11 = w11};
    const vsg_real_t k_1_or_H = vsg_blend(nodes, &at, 0U);
    const vsg_real_t d_1_or_zeta = vsg_blend(nodes, &at, 1U);
    const vsg_real_t k_2 = vsg_blend(nodes, &at, 2U);
    const vsg_real_t q = vsg_blend(nodes, &at, 3U);
    const vsg_real_t share_P = vsg_blend(nodes, &at, 4U);
    const vsg_real_t share_Q = vsg_blend(nodes, &at, 5U);
    const int low = vsg_outside(nodes, a, w00) || vsg_outside(nodes, b, w01);
    const int high = vsg_outside(nodes, d, w10) || vsg_outside(nodes, e, w11);
    const uint32_t designed = (low || high) ? 0U : 1U;
    normalised->k_1_or_H = k_1_or_H;
    normalised->d_1_or_zeta = d_1_or_zeta;
    normalised->k_2 = k_2;
    normalised->q = q;
    normalised->share_P = share_P;
    normalised->share_Q = share_Q;
    *designed_out = designed;
}

/* Largest share of an impedance, at most 1, that carries P and Q with POWER_MARGIN (eq. drawn-in). */
static inline vsg_real_t vsg_carried_share(vsg_real_t P, vsg_real_t Q, vsg_real_t V_rms, vsg_real_t Z_sq)
{
    const vsg_real_t limit = VSG_PHASES * V_rms * V_rms;
    const vsg_real_t wanted_sq = VSG_POWER_MARGIN * VSG_POWER_MARGIN * (P * P + Q * Q) * Z_sq;
    return limit / VSG_SQRT(vsg_max(wanted_sq, limit * limit));
}

/* Returns (b, g) in W: 3V^2 times the susceptance X/Z^2 and the conductance R/Z^2 of a path. Z_sq is R^2 + X^2. */
static inline void vsg_admittance(vsg_real_t V_rms, vsg_real_t R, vsg_real_t X, vsg_real_t Z_sq, vsg_real_t *b,
    vsg_real_t *g)
{
    const vsg_real_t scale = VSG_PHASES * V_rms * V_rms / Z_sq;
    *b = scale * X;
    *g = scale * R;
}

/* Limits Q in both directions, so that A and D*V are at least LEAST_SHARE of b (eq. well-posed). */
static inline vsg_real_t vsg_well_posed_power(vsg_real_t Q, vsg_real_t b)
{
    const vsg_real_t most = (VSG_C(1.0) - VSG_LEAST_SHARE) * b;
    return vsg_clip(Q, -most, most);
}

/* The Jacobian of eq. jacobian-from-powers for b and g of admittance. Returns (A, B, C, D). */
static inline void vsg_jacobian_from_admittance(vsg_real_t P, vsg_real_t Q, vsg_real_t V_rms, vsg_real_t b,
    vsg_real_t g, vsg_real_t *A, vsg_real_t *B, vsg_real_t *C, vsg_real_t *D)
{
    *A = b - Q;
    *B = (P + g) / V_rms;
    *C = P - g;
    *D = (b + Q) / V_rms;
}

/* The Jacobian A, B, C, D from which gains are made, for an estimated impedance with X > 0 that may be wrong.
 *
 * An impedance that cannot carry the measured P and Q with POWER_MARGIN is too large. R and X are then drawn in: they
 * are reduced at constant angle until they carry P and Q with this margin (eq. drawn-in). Q is limited so that A and
 * D*V are at least LEAST_SHARE of b (eq. well-posed). Without these two measures the gains would grow without bound
 * near the power limit of a grid. The Jacobian is that of jacobian_from_powers. */
static inline void vsg_scheduled_jacobian(vsg_real_t P, vsg_real_t Q, vsg_real_t V_rms, vsg_real_t R, vsg_real_t X,
    vsg_real_t *A, vsg_real_t *B, vsg_real_t *C, vsg_real_t *D)
{
    const vsg_real_t share = vsg_carried_share(P, Q, V_rms, R * R + X * X);
    const vsg_real_t R_new = share * R;
    const vsg_real_t X_new = share * X;
    vsg_real_t b, g;
    vsg_admittance(V_rms, R_new, X_new, R_new * R_new + X_new * X_new, &b, &g);
    vsg_jacobian_from_admittance(P, vsg_well_posed_power(Q, b), V_rms, b, g, A, B, C, D);
}

/* Inverse of the Jacobian that the loops see (eq. decoupling). Returns (w11, w12, w21, w22).
 *
 * The loops see J + diag(0, D_q), since the Q loop acts on Q + D_q V. B is scaled by share_P and C by share_Q. A share
 * of 0 leaves the coupling as it is (the published diagonal), and a share of 1 cancels it. With share_P = 0 the
 * frequency depends on P alone. */
static inline void vsg_decoupling(vsg_real_t A, vsg_real_t B, vsg_real_t C, vsg_real_t D, vsg_real_t D_q,
    vsg_real_t share_P, vsg_real_t share_Q, vsg_real_t *w11, vsg_real_t *w12, vsg_real_t *w21, vsg_real_t *w22)
{
    const vsg_real_t b = share_P * B;
    const vsg_real_t c = share_Q * C;
    const vsg_real_t d = D + D_q;
    const vsg_real_t determinant = A * d - b * c;
    /* It is 0 - b and not -b, so that an entry with a share of 0 is 0 and not -0. */
    *w11 = d / determinant;
    *w12 = (VSG_C(0.0) - b) / determinant;
    *w21 = (VSG_C(0.0) - c) / determinant;
    *w22 = A / determinant;
}

/* The V row of the angle-damped structure (eq. voltage-row): K_qp = k_2 v1 and K_iq = k_2 v2.
 *
 * The droop is part of e_P, so a changing delta drives V by K_qp D_p ddelta/dt. With A - k_2 D_p in place of A, the
 * response of V to delta is proportional to K_qp D_p (s + k_2), and the pole of V cancels this zero. Returns (sigma,
 * v1, v2). sigma (W/rad) is k_2 D_p, or less where k_2 D_p comes close to 1/w11. The determinant of the row thus keeps
 * at least 0.47 of its size, and no droop makes the gains grow without bound. */
static inline void vsg_voltage_row(vsg_real_t A, vsg_real_t B, vsg_real_t C, vsg_real_t D, vsg_real_t k_2,
    vsg_real_t D_p, vsg_real_t D_q, vsg_real_t share_P, vsg_real_t share_Q, vsg_real_t *sigma_out, vsg_real_t *v1,
    vsg_real_t *v2)
{
    const vsg_real_t b = share_P * B;
    const vsg_real_t c = share_Q * C;
    const vsg_real_t d = D + D_q;
    const vsg_real_t pull = k_2 * D_p;
    const vsg_real_t x = pull * (d / (A * d - b * c));
    const vsg_real_t sigma = pull / (VSG_C(1.0) + x * x * x);
    const vsg_real_t a = A - sigma;
    const vsg_real_t determinant = a * d - b * c;
    *sigma_out = sigma;
    *v1 = (VSG_C(0.0) - c) / determinant;
    *v2 = a / determinant;
}

/* The angle-damped structure (eq. angle-damped-gains): both droops are free, and the angle path damps.
 *
 * The droop D_p already damps by k_1 w11 D_p. This is subtracted from d_1, so delta has the polynomial s^2 + d_1 s +
 * k_1 and V has s + k_2 on every grid. The V row cancels the effect of the droop on V (eq. voltage-row), so the
 * response to a step of a reference has these poles alone. Law inertia keeps that effect, and it alone uses S_rated
 * (VA) and omega_0 (rad/s). */
static inline void vsg_angle_damped_gains(vsg_real_t A, vsg_real_t B, vsg_real_t C, vsg_real_t D,
    const vsg_normalised_t *normalised, vsg_real_t D_p, vsg_real_t D_q, vsg_real_t S_rated, vsg_real_t omega_0,
    vsg_gains_t *gains)
{
    const vsg_real_t k_1 = normalised->k_1_or_H;
    const vsg_real_t d_1 = normalised->d_1_or_zeta;
    const vsg_real_t k_2 = normalised->k_2;
    const vsg_real_t droop = D_q + normalised->q * D;
    vsg_real_t w11, w12, w21, w22;
    vsg_decoupling(A, B, C, D, droop, normalised->share_P, normalised->share_Q, &w11, &w12, &w21, &w22);
    vsg_real_t sigma, v1, v2;
    vsg_voltage_row(A, B, C, D, k_2, D_p, droop, normalised->share_P, normalised->share_Q, &sigma, &v1, &v2);
    const vsg_real_t k_d = d_1 - k_1 * w11 * D_p;
    gains->K_ip = k_1 * w11;
    gains->D_p = D_p;
    gains->K_iq = k_2 * v2;
    gains->D_q = droop;
    gains->K_pq = k_1 * w12;
    gains->K_qp = k_2 * v1;
    gains->k_P = k_d * w11;
    gains->k_Q = k_d * w12;
    (void)S_rated;
    (void)omega_0;
}

/* Gains on the grid of a place at measured powers and voltage (eq. structure-gains). Returns (gains). */
static inline void vsg_gains_at(const vsg_schedule_table_t *table, const vsg_normalised_t *normalised, vsg_real_t scr,
    vsg_real_t r_over_x, vsg_real_t P, vsg_real_t Q, vsg_real_t V_rms, vsg_gains_t *gains)
{
    vsg_real_t R_g, L_g;
    vsg_grid_at(table, scr, r_over_x, &R_g, &L_g);
    const vsg_real_t R = R_g + table->R_2;
    const vsg_real_t X = table->omega * (L_g + table->L_2);
    vsg_real_t A, B, C, D;
    vsg_scheduled_jacobian(P, Q, V_rms, R, X, &A, &B, &C, &D);
    vsg_angle_damped_gains(A, B, C, D, normalised, table->D_p, table->D_q, table->S_rated, table->omega, gains);
}

/* Makes one update. Returns (following, status, reason).
 *
 * Whatever the inputs are, the gains are those of a place and of powers within the box. */
static inline void vsg_updated(const vsg_schedule_table_t *table, const vsg_scheduler_limits_t *limits,
    const vsg_scheduler_t *s, const vsg_scheduler_input_t *given, vsg_scheduler_t *following, uint32_t *status_out,
    uint32_t *reason_out)
{
    vsg_checked_input_t checked;
    vsg_checked_input(limits, s, given, &checked);
    vsg_followed_t found;
    vsg_followed(table, limits, s, given, &checked, &found);
    const uint32_t reason = found.reason;
    const uint32_t status = checked.status;
    const vsg_real_t goal_scr = found.goal_scr;
    const vsg_real_t goal_r_over_x = found.goal_r_over_x;
    const uint32_t age = vsg_min_count(s->age + checked.elapsed, VSG_OLDEST);
    const uint32_t doubt = vsg_doubt_after(s, reason, checked.elapsed);
    const int stale = (reason != VSG_REASON_NONE) && ((age > limits->lost_ticks) || (doubt > limits->stale_ticks));
    const vsg_real_t goal_scr_new = limits->safe_scr;
    const vsg_real_t goal_r_over_x_new = limits->safe_r_over_x;
    const vsg_real_t goal_scr_new_2 = stale ? goal_scr_new : goal_scr;
    const vsg_real_t goal_r_over_x_new_2 = stale ? goal_r_over_x_new : goal_r_over_x;
    const vsg_real_t factor = VSG_C(1.0) + (vsg_real_t)checked.step * limits->rate_per_tick;
    const vsg_real_t moved_scr = vsg_limited(goal_scr_new_2, s->scr, factor);
    const vsg_real_t moved_r = vsg_limited(goal_r_over_x_new_2, s->r_over_x, factor);
    vsg_real_t scr, r_over_x;
    vsg_drawn_in(moved_scr, moved_r, limits, &scr, &r_over_x);
    vsg_real_t aim_scr, aim_r;
    vsg_drawn_in(goal_scr_new_2, goal_r_over_x_new_2, limits, &aim_scr, &aim_r);
    const uint32_t clamped = ((aim_scr != goal_scr_new_2) || (aim_r != goal_r_over_x_new_2)) ? VSG_CLAMPED : 0U;
    const int far = (VSG_ABS(scr - aim_scr) > VSG_ARRIVED * aim_scr) || (VSG_ABS(r_over_x - aim_r) > VSG_ARRIVED
        * aim_r);
    const uint32_t moving = far ? (clamped | VSG_LIMITED) : clamped;
    const vsg_real_t P = checked.P;
    const vsg_real_t Q = checked.Q;
    const vsg_real_t V_rms = checked.V_rms;
    vsg_normalised_t normalised;
    uint32_t designed;
    vsg_normalised_at(table, scr, r_over_x, &normalised, &designed);
    const int condition = designed == 0U;
    const uint32_t reason_new = (reason == VSG_REASON_NONE) ? VSG_REASON_UNDESIGNED : reason;
    const uint32_t status_new = status & VSG_REFUSED;
    const vsg_real_t scr_new = s->scr;
    const vsg_real_t r_over_x_new = s->r_over_x;
    const vsg_real_t P_new = s->P;
    const vsg_real_t Q_new = s->Q;
    const vsg_real_t V_rms_new = s->V_rms;
    const uint32_t status_new_2 = status | moving;
    vsg_gains_t gains;
    vsg_gains_at(table, &normalised, scr, r_over_x, P, Q, V_rms, &gains);
    const uint32_t reason_new_2 = condition ? reason_new : reason;
    const uint32_t status_new_3 = condition ? status_new : status_new_2;
    const vsg_real_t scr_new_2 = condition ? scr_new : scr;
    const vsg_real_t r_over_x_new_2 = condition ? r_over_x_new : r_over_x;
    const vsg_real_t P_new_2 = condition ? P_new : P;
    const vsg_real_t Q_new_2 = condition ? Q_new : Q;
    const vsg_real_t V_rms_new_2 = condition ? V_rms_new : V_rms;
    const vsg_gains_t gains_new = condition ? s->gains : gains;
    const uint32_t status_new_4 = stale ? (status_new_3 | VSG_FALLBACK) : status_new_3;
    const uint32_t status_new_5 = (doubt > 0U) ? (status_new_4 | VSG_DOUBT) : status_new_4;
    const int condition_new = reason_new_2 == VSG_REASON_NONE;
    const uint32_t status_new_6 = (found.share < VSG_C(1.0)) ? ((status_new_5 | VSG_FRESH) | VSG_PARTLY)
        : (status_new_5 | VSG_FRESH);
    const uint32_t status_new_7 = status_new_5 | VSG_HELD;
    const uint32_t before = ((s->told & VSG_TOLD_SURPRISED) != 0U) ? VSG_SURPRISED_BEFORE : 0U;
    const uint32_t told = (s->told & VSG_TOLD_CHANGED) | before;
    const uint32_t status_new_8 = condition_new ? status_new_6 : status_new_7;
    const uint32_t age_new = condition_new ? 0U : age;
    const uint32_t told_new = condition_new ? 0U : told;
    const uint32_t ticks = given->ticks;
    following->started = 1U;
    following->ticks = ticks;
    following->age = age_new;
    following->doubt = doubt;
    following->told = told_new;
    following->agreed = found.agreed;
    following->refuted = found.refuted;
    following->scr = scr_new_2;
    following->r_over_x = r_over_x_new_2;
    following->goal_scr = goal_scr_new_2;
    following->goal_r_over_x = goal_r_over_x_new_2;
    following->candidate_scr = found.candidate_scr;
    following->candidate_r_over_x = found.candidate_r_over_x;
    following->left_scr = s->left_scr;
    following->left_r_over_x = s->left_r_over_x;
    following->P = P_new_2;
    following->Q = Q_new_2;
    following->V_rms = V_rms_new_2;
    following->gains = gains_new;
    *status_out = status_new_8;
    *reason_out = reason_new_2;
}

/* The state that was told something: bits of TOLD_LIMITED, TOLD_SURPRISED and TOLD_CHANGED. Returns (following).
 *
 * With TOLD_CHANGED, the goal of this moment is the place that the grid has left. */
static inline void vsg_told_state(const vsg_scheduler_t *s, uint32_t told, vsg_scheduler_t *following)
{
    const int changed = ((told & VSG_TOLD_CHANGED) != 0U) && ((s->told & VSG_TOLD_CHANGED) == 0U);
    const uint32_t told_new = s->told | told;
    const uint32_t refuted = changed ? 1U : s->refuted;
    const vsg_real_t left_scr = changed ? s->goal_scr : s->left_scr;
    const vsg_real_t left_r_over_x = changed ? s->goal_r_over_x : s->left_r_over_x;
    following->started = s->started;
    following->ticks = s->ticks;
    following->age = s->age;
    following->doubt = s->doubt;
    following->told = told_new;
    following->agreed = s->agreed;
    following->refuted = refuted;
    following->scr = s->scr;
    following->r_over_x = s->r_over_x;
    following->goal_scr = s->goal_scr;
    following->goal_r_over_x = s->goal_r_over_x;
    following->candidate_scr = s->candidate_scr;
    following->candidate_r_over_x = s->candidate_r_over_x;
    following->left_scr = left_scr;
    following->left_r_over_x = left_r_over_x;
    following->P = s->P;
    following->Q = s->Q;
    following->V_rms = s->V_rms;
    following->gains = s->gains;
}

/* Returns (scr, r_over_x, known) of a grid on which a scheduler is to begin.
 *
 * known is 0 where the grid is not in the box: the place is then the safe one. With nearest, a grid outside the box is
 * taken for the nearest place in it. */
static inline void vsg_start_place(const vsg_schedule_table_t *table, const vsg_scheduler_limits_t *limits,
    vsg_real_t R_g, vsg_real_t L_g, vsg_real_t *scr_out, vsg_real_t *r_over_x_out, uint32_t *known_out)
{
    const vsg_real_t scr = limits->safe_scr;
    const vsg_real_t r_over_x = limits->safe_r_over_x;
    const int condition = vsg_finite(R_g + L_g) && (L_g > VSG_C(0.0));
    vsg_real_t at_scr, at_r;
    vsg_place_of(table, R_g, L_g, &at_scr, &at_r);
    const int inside = (limits->scr_low <= at_scr) && (at_scr <= limits->scr_high) && ((limits->r_over_x_low <= at_r)
        && (at_r <= limits->r_over_x_high));
    vsg_normalised_t normalised;
    uint32_t designed;
    vsg_normalised_at(table, at_scr, at_r, &normalised, &designed);
    const int condition_new = inside && (designed != 0U);
    const vsg_real_t scr_new = condition_new ? at_scr : scr;
    const vsg_real_t r_over_x_new = condition_new ? at_r : r_over_x;
    const uint32_t known = condition_new ? 1U : 0U;
    const vsg_real_t scr_new_2 = condition ? scr_new : scr;
    const vsg_real_t r_over_x_new_2 = condition ? r_over_x_new : r_over_x;
    const uint32_t known_new = condition ? known : 0U;
    *scr_out = scr_new_2;
    *r_over_x_out = r_over_x_new_2;
    *known_out = known_new;
}

/* The state at a place with a design, without load, before any update. Returns (first). */
static inline void vsg_state_at(const vsg_schedule_table_t *table, const vsg_scheduler_limits_t *limits, vsg_real_t scr,
    vsg_real_t r_over_x, uint32_t age, vsg_scheduler_t *first)
{
    const vsg_real_t P = vsg_clip(VSG_C(0.0), limits->P_low, limits->P_high);
    const vsg_real_t Q = vsg_clip(VSG_C(0.0), limits->Q_low, limits->Q_high);
    const vsg_real_t V_rms = vsg_clip(table->V_n, limits->V_low, limits->V_high);
    vsg_normalised_t normalised;
    uint32_t designed;
    vsg_normalised_at(table, scr, r_over_x, &normalised, &designed);
    vsg_gains_t gains;
    vsg_gains_at(table, &normalised, scr, r_over_x, P, Q, V_rms, &gains);
    const vsg_real_t candidate_scr = limits->safe_scr;
    const vsg_real_t candidate_r_over_x = limits->safe_r_over_x;
    const vsg_real_t left_scr = limits->safe_scr;
    const vsg_real_t left_r_over_x = limits->safe_r_over_x;
    first->started = 0U;
    first->ticks = 0U;
    first->age = age;
    first->doubt = 0U;
    first->told = 0U;
    first->agreed = 0U;
    first->refuted = 0U;
    first->scr = scr;
    first->r_over_x = r_over_x;
    first->goal_scr = scr;
    first->goal_r_over_x = r_over_x;
    first->candidate_scr = candidate_scr;
    first->candidate_r_over_x = candidate_r_over_x;
    first->left_scr = left_scr;
    first->left_r_over_x = left_r_over_x;
    first->P = P;
    first->Q = Q;
    first->V_rms = V_rms;
    first->gains = gains;
}

/* Moves an angle in rad that has just passed +-2 pi back by one turn, so that it never loses digits. */
static inline vsg_real_t vsg_within_a_turn(vsg_real_t theta)
{
    return theta - VSG_TURN * ((theta > VSG_TURN) ? VSG_C(1.0) : VSG_C(0.0)) + VSG_TURN * ((theta < -VSG_TURN)
        ? VSG_C(1.0) : VSG_C(0.0));
}

/* omega_i in rad/s that makes omega = omega_0 where P, Q and V are at their set points (eq. rest-of-the-integrator). */
static inline vsg_real_t vsg_frequency_at_rest(const vsg_references_t *refs, const vsg_gains_t *gains)
{
    return refs->omega_0 + (gains->k_P * refs->P_ref + gains->k_Q * (refs->Q_ref + gains->D_q * refs->V_n));
}

/* Takes the predicted ripple from a measured power (eq. notch).
 *
 * ripple and mean are what it remembers, in the unit of value: the ripple that is predicted for this sample, and a mean
 * that equals the value at rest. Returns (passed, ripple, mean): what goes on to the power filter, and what to
 * remember. */
static inline void vsg_notch(vsg_real_t value, vsg_real_t ripple, vsg_real_t mean, vsg_real_t gain, vsg_real_t step,
    vsg_real_t back, vsg_real_t *passed_out, vsg_real_t *ripple_out, vsg_real_t *mean_out)
{
    const vsg_real_t passed = value - ripple;
    const vsg_real_t error = passed - mean;
    *passed_out = passed;
    *ripple_out = ripple - step * ripple + gain * error;
    *mean_out = mean + step * error + back * ripple;
}

/* The law of every structure (eq. power-loop-law). Returns (omega, domega_dt, dV_dt) in rad/s, rad/s^2 and V/s.
 *
 * omega = omega_i - k_P P - k_Q (Q + D_q V). With the errors e_P = P_ref - P + D_p (omega_0 - omega) and e_Q = Q_ref -
 * Q + D_q (V_n - V), domega_i/dt = K_ip e_P + K_pq e_Q and dV/dt = K_qp e_P + K_iq e_Q. In the steady state both errors
 * are zero, so the droops are exactly D_p and D_q whatever the other gains are.
 *
 * If the last four gains are zero, this is the published law with V in rms. The authors' released model differs: it
 * integrates the peak amplitude although its gains come from the Jacobian in rms. */
static inline void vsg_power_loops(vsg_real_t omega_i, vsg_real_t V_rms, vsg_real_t P, vsg_real_t Q,
    const vsg_references_t *refs, const vsg_gains_t *gains, vsg_real_t *omega_out, vsg_real_t *domega_dt_out,
    vsg_real_t *dV_dt_out)
{
    const vsg_real_t omega = omega_i - gains->k_P * P - gains->k_Q * (Q + gains->D_q * V_rms);
    const vsg_real_t e_P = refs->P_ref - P + gains->D_p * (refs->omega_0 - omega);
    const vsg_real_t e_Q = refs->Q_ref - Q + gains->D_q * (refs->V_n - V_rms);
    const vsg_real_t domega_dt = gains->K_ip * e_P + gains->K_pq * e_Q;
    const vsg_real_t dV_dt = gains->K_qp * e_P + gains->K_iq * e_Q;
    *omega_out = omega;
    *domega_dt_out = domega_dt;
    *dV_dt_out = dV_dt;
}

/* Power filters and power loops of one sample: the frequency omega, the new P_f and Q_f, and the steps.
 *
 * P and Q come from the notch. P_f and Q_f are those of the next sample. The steps are the changes of theta, omega_i
 * and V by forward Euler with period T_s. The step of theta uses the frequency of this sample. */
static inline void vsg_power_stage(const vsg_controller_state_t *state, vsg_real_t P, vsg_real_t Q,
    const vsg_references_t *refs, const vsg_gains_t *gains, const vsg_controller_settings_t *settings,
    vsg_real_t *omega_out, vsg_real_t *P_f_out, vsg_real_t *Q_f_out, vsg_integrator_steps_t *steps)
{
    const vsg_real_t P_f = state->P_f + settings->smoothing_P * (P - state->P_f);
    const vsg_real_t Q_f = state->Q_f + settings->smoothing_Q * (Q - state->Q_f);
    vsg_real_t omega, domega_dt, dV_dt;
    vsg_power_loops(state->omega_i, state->V, P_f, Q_f, refs, gains, &omega, &domega_dt, &dV_dt);
    const vsg_real_t theta = settings->T_s * omega;
    const vsg_real_t omega_i = settings->T_s * domega_dt;
    const vsg_real_t V = settings->T_s * dV_dt;
    *omega_out = omega;
    *P_f_out = P_f;
    *Q_f_out = Q_f;
    steps->theta = theta;
    steps->omega_i = omega_i;
    steps->V = V;
}

/* Three-phase power of peak space vectors in alpha-beta or dq (eq. instantaneous-power). Returns (P, Q) in W and var.
 */
static inline void vsg_instantaneous_power(vsg_real_t v_alpha, vsg_real_t v_beta, vsg_real_t i_alpha, vsg_real_t i_beta,
    vsg_real_t *P, vsg_real_t *Q)
{
    *P = VSG_SPACE_VECTOR_POWER * (v_alpha * i_alpha + v_beta * i_beta);
    *Q = VSG_SPACE_VECTOR_POWER * (v_beta * i_alpha - v_alpha * i_beta);
}

/* The vector (x, y) turned backward by an angle given by its cosine and sine (alpha-beta to dq).
 *
 * Returns (turned_x, turned_y). */
static inline void vsg_rotate_back(vsg_real_t x, vsg_real_t y, vsg_real_t cosine, vsg_real_t sine, vsg_real_t *turned_x,
    vsg_real_t *turned_y)
{
    *turned_x = x * cosine + y * sine;
    *turned_y = y * cosine - x * sine;
}

/* Voltage that is subtracted from the reference while the grid current changes (eq. transient-impedance).
 *
 * i_f is the grid current behind its low-pass. Returns (drop_d, drop_q, i_f_d, i_f_q): the drop in V, the new i_f in A.
 */
static inline void vsg_transient_impedance(vsg_real_t i_g_d, vsg_real_t i_g_q, vsg_real_t i_f_d, vsg_real_t i_f_q,
    const vsg_inner_gains_t *gains, vsg_real_t smoothing, vsg_real_t *drop_d_out, vsg_real_t *drop_q_out,
    vsg_real_t *i_f_d_out, vsg_real_t *i_f_q_out)
{
    const vsg_real_t h_d = i_g_d - i_f_d;
    const vsg_real_t h_q = i_g_q - i_f_q;
    const vsg_real_t drop_d = gains->R_t * h_d - gains->X_t * h_q;
    const vsg_real_t drop_q = gains->R_t * h_q + gains->X_t * h_d;
    *drop_d_out = drop_d;
    *drop_q_out = drop_q;
    *i_f_d_out = i_f_d + smoothing * h_d;
    *i_f_q_out = i_f_q + smoothing * h_q;
}

/* Phase rms to phase peak. */
static inline vsg_real_t vsg_rms_to_peak(vsg_real_t x_rms)
{
    return x_rms * VSG_SQRT_2;
}

/* Voltage error and the converter current that the loop asks for (eq. voltage-loop).
 *
 * Each axis has a PI controller, feed-forward of the grid current and omega C cross-coupling. Returns (e_d, e_q,
 * i_want_d, i_want_q), the errors in V and the currents in A. */
static inline void vsg_voltage_loop(vsg_real_t v_ref, vsg_real_t drop_d, vsg_real_t drop_q, vsg_real_t v_d,
    vsg_real_t v_q, vsg_real_t i_g_d, vsg_real_t i_g_q, vsg_real_t xi_d, vsg_real_t xi_q,
    const vsg_inner_gains_t *gains, vsg_real_t omega_C, vsg_real_t *e_d_out, vsg_real_t *e_q_out,
    vsg_real_t *i_want_d_out, vsg_real_t *i_want_q_out)
{
    /* The drop is subtracted last. Where it is zero it then changes no rounding, so published figures keep every bit.
     */
    const vsg_real_t e_d = v_ref - v_d - drop_d;
    const vsg_real_t e_q = -v_q - drop_q;
    const vsg_real_t i_want_d = gains->K_pv * e_d + xi_d + gains->K_ff * i_g_d - omega_C * v_q;
    const vsg_real_t i_want_q = gains->K_pv * e_q + xi_q + gains->K_ff * i_g_q + omega_C * v_d;
    *e_d_out = e_d;
    *e_q_out = e_q;
    *i_want_d_out = i_want_d;
    *i_want_q_out = i_want_q;
}

/* Shortens the vector (x, y) to the length limit if it is longer. Returns (short_x, short_y). */
static inline void vsg_limit_length(vsg_real_t x, vsg_real_t y, vsg_real_t limit, vsg_real_t *short_x,
    vsg_real_t *short_y)
{
    /* The squares are compared, so that the root is never taken at zero, where it has no derivative. */
    const vsg_real_t scale = limit / VSG_SQRT(vsg_max(x * x + y * y, limit * limit));
    *short_x = x * scale;
    *short_y = y * scale;
}

/* Shortens the requested current to the limit (eq. circular-limit) and leaves everything else unchanged. */
static inline void vsg_circular_limit(const vsg_limiter_view_t *view, const vsg_grid_estimate_t *grid,
    const vsg_references_t *refs, const vsg_gains_t *gains, const vsg_controller_settings_t *settings,
    vsg_limited_sample_t *limited_sample)
{
    vsg_real_t i_ref_d, i_ref_q;
    vsg_limit_length(view->i_want_d, view->i_want_q, settings->i_max_pk, &i_ref_d, &i_ref_q);
    const vsg_real_t length_sq = view->i_want_d * view->i_want_d + view->i_want_q * view->i_want_q;
    const vsg_real_t e_d = view->e_d;
    const vsg_real_t e_q = view->e_q;
    const vsg_real_t P = view->P;
    const vsg_real_t Q = view->Q;
    const vsg_real_t limited = VSG_C(1.0) * ((length_sq > settings->i_max_pk * settings->i_max_pk) ? VSG_C(1.0)
        : VSG_C(0.0));
    limited_sample->i_ref_d = i_ref_d;
    limited_sample->i_ref_q = i_ref_q;
    limited_sample->e_d = e_d;
    limited_sample->e_q = e_q;
    limited_sample->P = P;
    limited_sample->Q = Q;
    limited_sample->limited = limited;
    (void)grid;
    (void)refs;
    (void)gains;
}

/* The integrators xi_v of the voltage loop for the next sample (eq. voltage-loop).
 *
 * They integrate the error and cut, the change that the limiter made to the requested current: cut = i_ref - i* in A.
 * Returns (xi_d, xi_q). */
static inline void vsg_voltage_integrators(vsg_real_t e_d, vsg_real_t e_q, vsg_real_t cut_d, vsg_real_t cut_q,
    vsg_real_t xi_d, vsg_real_t xi_q, const vsg_inner_gains_t *gains, vsg_real_t T_s, vsg_real_t *xi_d_lost,
    vsg_real_t *xi_q_lost, vsg_real_t *xi_d_out, vsg_real_t *xi_q_out)
{
    const vsg_real_t unwind = gains->K_iv / gains->K_pv;
    const vsg_real_t xi_d_new = vsg_advanced(xi_d, T_s * (gains->K_iv * e_d + unwind * cut_d), xi_d_lost);
    const vsg_real_t xi_q_new = vsg_advanced(xi_q, T_s * (gains->K_iv * e_q + unwind * cut_q), xi_q_lost);
    *xi_d_out = xi_d_new;
    *xi_q_out = xi_q_new;
}

/* Converter current a share kappa of one period ahead (eq. current-prediction).
 *
 * u is the bridge voltage that was computed one sample ago and acts from this sample on. With kappa = 0 the function
 * returns the current unchanged to the last bit. Returns (i_d, i_q) in A peak. */
static inline void vsg_predicted_current(vsg_real_t i_d, vsg_real_t i_q, vsg_real_t v_d, vsg_real_t v_q, vsg_real_t u_d,
    vsg_real_t u_q, vsg_real_t kappa, vsg_real_t omega_L, vsg_real_t T_over_L, vsg_real_t *i_d_out, vsg_real_t *i_q_out)
{
    const vsg_real_t ahead = kappa * T_over_L;
    *i_d_out = i_d + ahead * (u_d - v_d + omega_L * i_q);
    *i_q_out = i_q + ahead * (u_q - v_q - omega_L * i_d);
}

/* Bridge voltage from the error of the predicted current (eq. current-loop).
 *
 * Each axis has a PI controller, feed-forward of the capacitor voltage and omega L cross-coupling. The voltage limit is
 * circular and has the same anti-windup. Returns (v_b_d, v_b_q, xi_d, xi_q) with the new integrators. */
static inline void vsg_current_loop(vsg_real_t i_ref_d, vsg_real_t i_ref_q, vsg_real_t i_d, vsg_real_t i_q,
    vsg_real_t v_d, vsg_real_t v_q, vsg_real_t u_d, vsg_real_t u_q, vsg_real_t xi_d, vsg_real_t xi_q,
    const vsg_inner_gains_t *gains, vsg_real_t omega_L, vsg_real_t T_over_L, vsg_real_t v_max_pk, vsg_real_t T_s,
    vsg_real_t *xi_d_lost, vsg_real_t *xi_q_lost, vsg_real_t *v_b_d_out, vsg_real_t *v_b_q_out, vsg_real_t *xi_d_out,
    vsg_real_t *xi_q_out)
{
    vsg_real_t ahead_d, ahead_q;
    vsg_predicted_current(i_d, i_q, v_d, v_q, u_d, u_q, gains->kappa, omega_L, T_over_L, &ahead_d, &ahead_q);
    const vsg_real_t e_d = i_ref_d - ahead_d;
    const vsg_real_t e_q = i_ref_q - ahead_q;
    const vsg_real_t want_d = gains->K_pc * e_d + xi_d + v_d - omega_L * i_q;
    const vsg_real_t want_q = gains->K_pc * e_q + xi_q + v_q + omega_L * i_d;
    vsg_real_t v_b_d, v_b_q;
    vsg_limit_length(want_d, want_q, v_max_pk, &v_b_d, &v_b_q);
    const vsg_real_t unwind = gains->K_ic / gains->K_pc;
    const vsg_real_t xi_d_new = vsg_advanced(xi_d, T_s * (gains->K_ic * e_d + unwind * (v_b_d - want_d)), xi_d_lost);
    const vsg_real_t xi_q_new = vsg_advanced(xi_q, T_s * (gains->K_ic * e_q + unwind * (v_b_q - want_q)), xi_q_lost);
    *v_b_d_out = v_b_d;
    *v_b_q_out = v_b_q;
    *xi_d_out = xi_d_new;
    *xi_q_out = xi_q_new;
}

/* The vector (x, y) turned forward by an angle given by its cosine and sine (dq to alpha-beta).
 *
 * Returns (turned_x, turned_y). */
static inline void vsg_rotate(vsg_real_t x, vsg_real_t y, vsg_real_t cosine, vsg_real_t sine, vsg_real_t *turned_x,
    vsg_real_t *turned_y)
{
    *turned_x = x * cosine - y * sine;
    *turned_y = x * sine + y * cosine;
}

/* Returns the steps that the power loops ask for. This limiter has no memory. */
static inline void vsg_circular_move(const vsg_limited_sample_t *sample, const vsg_limiter_view_t *view,
    vsg_real_t omega, const vsg_integrator_steps_t *steps, const vsg_controller_settings_t *settings,
    vsg_integrator_steps_t *steps_out)
{
    *steps_out = *steps;
    (void)sample;
    (void)view;
    (void)omega;
    (void)settings;
}

/* controller_step with its power loops open, for given powers P and Q and a commanded voltage V at angle theta.
 *
 * The linear model adds its disturbances at these inputs. */
static inline void vsg_controller_sample(const vsg_controller_state_t *state, const vsg_measurement_t *measured,
    vsg_real_t P, vsg_real_t Q, vsg_real_t theta, vsg_real_t V_rms, const vsg_grid_estimate_t *grid,
    const vsg_references_t *refs, const vsg_gains_t *power_gains, const vsg_inner_gains_t *inner_gains,
    const vsg_controller_settings_t *settings, vsg_controller_state_lost_t *state_lost,
    vsg_controller_state_t *following, vsg_controller_output_t *output)
{
    const vsg_real_t cosine = VSG_COS(theta);
    const vsg_real_t sine = VSG_SIN(theta);
    vsg_real_t v_d, v_q;
    vsg_rotate_back(measured->v_alpha, measured->v_beta, cosine, sine, &v_d, &v_q);
    vsg_real_t i_s_d, i_s_q;
    vsg_rotate_back(measured->i_s_alpha, measured->i_s_beta, cosine, sine, &i_s_d, &i_s_q);
    vsg_real_t i_g_d, i_g_q;
    vsg_rotate_back(measured->i_g_alpha, measured->i_g_beta, cosine, sine, &i_g_d, &i_g_q);
    vsg_real_t drop_d, drop_q, i_f_d, i_f_q;
    vsg_transient_impedance(i_g_d, i_g_q, state->i_f_d, state->i_f_q, inner_gains, settings->smoothing_t, &drop_d,
        &drop_q, &i_f_d, &i_f_q);
    vsg_real_t e_d, e_q, i_want_d, i_want_q;
    vsg_voltage_loop(vsg_rms_to_peak(V_rms), drop_d, drop_q, v_d, v_q, i_g_d, i_g_q, state->xi_vd, state->xi_vq,
        inner_gains, settings->omega_C, &e_d, &e_q, &i_want_d, &i_want_q);
    vsg_real_t passed_P, ripple_P, mean_P;
    vsg_notch(P, state->ripple_P, state->mean_P, settings->notch_gain, settings->notch_step, settings->notch_back,
        &passed_P, &ripple_P, &mean_P);
    vsg_real_t passed_Q, ripple_Q, mean_Q;
    vsg_notch(Q, state->ripple_Q, state->mean_Q, settings->notch_gain, settings->notch_step, settings->notch_back,
        &passed_Q, &ripple_Q, &mean_Q);
    const vsg_real_t full = VSG_C(1.0) * ((state->u_alpha * state->u_alpha + state->u_beta
        * state->u_beta >= VSG_AT_THE_LIMIT * settings->v_max_pk * settings->v_max_pk) ? VSG_C(1.0) : VSG_C(0.0));
    const vsg_limiter_view_t view = {.v_d = v_d, .v_q = v_q, .i_s_d = i_s_d, .i_s_q = i_s_q, .i_g_d = i_g_d,
        .i_g_q = i_g_q, .e_d = e_d, .e_q = e_q, .i_want_d = i_want_d, .i_want_q = i_want_q, .V = V_rms,
        .omega_i = state->omega_i, .P = passed_P, .Q = passed_Q, .K_pv = inner_gains->K_pv, .full = full};
    vsg_limited_sample_t sample;
    vsg_circular_limit(&view, grid, refs, power_gains, settings, &sample);
    vsg_real_t xi_vd, xi_vq;
    vsg_voltage_integrators(sample.e_d, sample.e_q, sample.i_ref_d - i_want_d, sample.i_ref_q - i_want_q, state->xi_vd,
        state->xi_vq, inner_gains, settings->T_s, &state_lost->xi_vd, &state_lost->xi_vq, &xi_vd, &xi_vq);
    /* The bridge voltage is constant in alpha-beta during a period while the dq frame turns. In the middle of the
     * period it is therefore half a period behind the frame. */
    vsg_real_t u_d, u_q;
    vsg_rotate_back(state->u_alpha, state->u_beta, cosine, sine, &u_d, &u_q);
    vsg_real_t u_d_new, u_q_new;
    vsg_rotate_back(u_d, u_q, settings->half_cos, settings->half_sin, &u_d_new, &u_q_new);
    vsg_real_t v_b_d, v_b_q, xi_id, xi_iq;
    vsg_current_loop(sample.i_ref_d, sample.i_ref_q, i_s_d, i_s_q, v_d, v_q, u_d_new, u_q_new, state->xi_id,
        state->xi_iq, inner_gains, settings->omega_L, settings->T_over_L, settings->v_max_pk, settings->T_s,
        &state_lost->xi_id, &state_lost->xi_iq, &v_b_d, &v_b_q, &xi_id, &xi_iq);
    vsg_real_t lead_d, lead_q;
    vsg_rotate(v_b_d, v_b_q, settings->advance_cos, settings->advance_sin, &lead_d, &lead_q);
    vsg_real_t v_b_alpha, v_b_beta;
    vsg_rotate(lead_d, lead_q, cosine, sine, &v_b_alpha, &v_b_beta);
    vsg_real_t omega, P_f, Q_f;
    vsg_integrator_steps_t wanted;
    vsg_power_stage(state, sample.P, sample.Q, refs, power_gains, settings, &omega, &P_f, &Q_f, &wanted);
    vsg_integrator_steps_t steps;
    vsg_circular_move(&sample, &view, omega, &wanted, settings, &steps);
    const vsg_real_t theta_new = vsg_advanced(state->theta, steps.theta, &state_lost->theta);
    const vsg_real_t omega_i = vsg_advanced(state->omega_i, steps.omega_i, &state_lost->omega_i);
    const vsg_real_t V = vsg_advanced(state->V, steps.V, &state_lost->V);
    following->theta = theta_new;
    following->omega_i = omega_i;
    following->V = V;
    following->P_f = P_f;
    following->Q_f = Q_f;
    following->xi_vd = xi_vd;
    following->xi_vq = xi_vq;
    following->xi_id = xi_id;
    following->xi_iq = xi_iq;
    following->i_f_d = i_f_d;
    following->i_f_q = i_f_q;
    following->u_alpha = v_b_alpha;
    following->u_beta = v_b_beta;
    following->ripple_P = ripple_P;
    following->ripple_Q = ripple_Q;
    following->mean_P = mean_P;
    following->mean_Q = mean_Q;
    output->v_b_alpha = v_b_alpha;
    output->v_b_beta = v_b_beta;
    output->omega = omega;
    output->P = P;
    output->Q = Q;
    output->limited = sample.limited;
}

/* One sample of the controller (eq. controller-step): the next state, and the output of this one. */
static inline void vsg_controller_step(const vsg_controller_state_t *state, const vsg_measurement_t *measured,
    const vsg_grid_estimate_t *grid, const vsg_references_t *refs, const vsg_gains_t *power_gains,
    const vsg_inner_gains_t *inner_gains, const vsg_controller_settings_t *settings,
    vsg_controller_state_lost_t *state_lost, vsg_controller_state_t *following, vsg_controller_output_t *output)
{
    vsg_real_t P, Q;
    vsg_instantaneous_power(measured->v_alpha, measured->v_beta, measured->i_g_alpha, measured->i_g_beta, &P, &Q);
    vsg_controller_sample(state, measured, P, Q, state->theta, state->V, grid, refs, power_gains, inner_gains, settings,
        state_lost, following, output);
}

/* 1 if six numbers can be a measurement, 0 if one of them is NaN, infinite or far beyond every limit. */
static inline vsg_real_t vsg_plausible(const vsg_measurement_t *measured, const vsg_controller_settings_t *settings)
{
    const vsg_real_t v = vsg_max(VSG_ABS(measured->v_alpha), VSG_ABS(measured->v_beta));
    const vsg_real_t i_s = vsg_max(VSG_ABS(measured->i_s_alpha), VSG_ABS(measured->i_s_beta));
    const vsg_real_t i_g = vsg_max(VSG_ABS(measured->i_g_alpha), VSG_ABS(measured->i_g_beta));
    return VSG_C(1.0) * ((v <= VSG_V_PLAUSIBLE * settings->v_max_pk) ? VSG_C(1.0) : VSG_C(0.0))
        * ((i_s <= VSG_I_PLAUSIBLE * settings->i_max_pk) ? VSG_C(1.0) : VSG_C(0.0)) * ((i_g <= VSG_I_PLAUSIBLE
        * settings->i_max_pk) ? VSG_C(1.0) : VSG_C(0.0));
}

/* A sample without a measurement (eq. skipped-step): the next state, and the output of this one.
 *
 * The frame and the bridge voltage go on turning at the frequency that the filtered powers ask for. All other state
 * variables keep their values. */
static inline void vsg_skipped_step(const vsg_controller_state_t *state, const vsg_references_t *refs,
    const vsg_gains_t *gains, const vsg_controller_settings_t *settings, vsg_controller_state_lost_t *state_lost,
    vsg_controller_state_t *following, vsg_controller_output_t *output)
{
    vsg_real_t omega, domega_dt, dV_dt;
    vsg_power_loops(state->omega_i, state->V, state->P_f, state->Q_f, refs, gains, &omega, &domega_dt, &dV_dt);
    /* At most half a turn in a sample: gains that make no sense may ask for any frequency. */
    const vsg_real_t fastest = VSG_C(0.5) * VSG_TURN / settings->T_s;
    const vsg_real_t omega_new = vsg_clip(omega, -fastest, fastest);
    const vsg_real_t turn = settings->T_s * omega_new;
    vsg_real_t u_alpha, u_beta;
    vsg_limit_length(state->u_alpha, state->u_beta, settings->v_max_pk, &u_alpha, &u_beta);
    vsg_real_t u_alpha_new, u_beta_new;
    vsg_rotate(u_alpha, u_beta, VSG_COS(turn), VSG_SIN(turn), &u_alpha_new, &u_beta_new);
    const vsg_real_t theta = vsg_advanced(state->theta, turn, &state_lost->theta);
    const vsg_real_t P = state->P_f;
    const vsg_real_t Q = state->Q_f;
    following->theta = theta;
    following->omega_i = state->omega_i;
    following->V = state->V;
    following->P_f = state->P_f;
    following->Q_f = state->Q_f;
    following->xi_vd = state->xi_vd;
    following->xi_vq = state->xi_vq;
    following->xi_id = state->xi_id;
    following->xi_iq = state->xi_iq;
    following->i_f_d = state->i_f_d;
    following->i_f_q = state->i_f_q;
    following->u_alpha = u_alpha_new;
    following->u_beta = u_beta_new;
    following->ripple_P = state->ripple_P;
    following->ripple_Q = state->ripple_Q;
    following->mean_P = state->mean_P;
    following->mean_Q = state->mean_Q;
    output->v_b_alpha = u_alpha_new;
    output->v_b_beta = u_beta_new;
    output->omega = omega_new;
    output->P = P;
    output->Q = Q;
    output->limited = VSG_C(0.0);
}

/* 1 if the frequency and the integrators of a state are where a converter can be, 0 if one is NaN or far beyond.
 *
 * A step that would leave this range is not taken, so that gains or references that make no sense leave nothing behind
 * in the integrators. */
static inline vsg_real_t vsg_sound(const vsg_controller_state_t *state, vsg_real_t omega, const vsg_references_t *refs,
    const vsg_controller_settings_t *settings)
{
    const vsg_real_t xi_v = vsg_max(VSG_ABS(state->xi_vd), VSG_ABS(state->xi_vq));
    const vsg_real_t xi_i = vsg_max(VSG_ABS(state->xi_id), VSG_ABS(state->xi_iq));
    return VSG_C(1.0) * ((VSG_ABS(omega) <= VSG_TIMES_NOMINAL * refs->omega_0) ? VSG_C(1.0) : VSG_C(0.0))
        * ((VSG_ABS(state->omega_i) <= VSG_TIMES_NOMINAL * refs->omega_0) ? VSG_C(1.0) : VSG_C(0.0))
        * ((VSG_ABS(state->V) <= VSG_TIMES_NOMINAL * refs->V_n) ? VSG_C(1.0) : VSG_C(0.0)) * ((xi_v <= VSG_I_PLAUSIBLE
        * settings->i_max_pk) ? VSG_C(1.0) : VSG_C(0.0)) * ((xi_i <= VSG_V_PLAUSIBLE * settings->v_max_pk)
        ? VSG_C(1.0) : VSG_C(0.0));
}

/* The omega_i in rad/s that keeps the frequency at which the integrator would rest when the gains change (eq.
 * gain-transfer).
 *
 * refs are the references with which old has been in force. No measurement enters, so that a surge leaves nothing
 * behind, and equal gains leave omega_i as it is to the last bit. 1 - k_P D_p is taken as at least 1 - MOST_FED_BACK,
 * so that the result is finite for any gains. */
static inline vsg_real_t vsg_gain_transfer(vsg_real_t omega_i, const vsg_references_t *refs, const vsg_gains_t *old,
    const vsg_gains_t *new)
{
    const vsg_real_t offset = (omega_i - vsg_frequency_at_rest(refs, old)) / vsg_max(VSG_C(1.0) - old->k_P * old->D_p,
        VSG_C(1.0) - VSG_MOST_FED_BACK);
    const vsg_real_t before = old->k_P * (refs->P_ref - old->D_p * offset) + old->k_Q * (refs->Q_ref + old->D_q
        * refs->V_n);
    const vsg_real_t after = new->k_P * (refs->P_ref - new->D_p * offset) + new->k_Q * (refs->Q_ref + new->D_q
        * refs->V_n);
    return omega_i + (after - before);
}

/* One sample of the grid's voltage in V peak (eq. grid-watch). */
static inline void vsg_watch_grid(const vsg_grid_watch_t *watch, vsg_real_t v_alpha, vsg_real_t v_beta,
    const vsg_references_t *refs, vsg_real_t T_s, vsg_grid_watch_t *grid_watch)
{
    const vsg_real_t turn = T_s * watch->omega;
    vsg_real_t ahead_alpha, ahead_beta;
    vsg_rotate(watch->v_alpha, watch->v_beta, VSG_COS(turn), VSG_SIN(turn), &ahead_alpha, &ahead_beta);
    const vsg_real_t e_alpha = v_alpha - ahead_alpha;
    const vsg_real_t e_beta = v_beta - ahead_beta;
    const vsg_real_t least = VSG_WATCH_LEAST * vsg_rms_to_peak(refs->V_n);
    const vsg_real_t length_sq = vsg_max(ahead_alpha * ahead_alpha + ahead_beta * ahead_beta, least * least);
    const vsg_real_t slip = (ahead_alpha * e_beta - ahead_beta * e_alpha) / length_sq;
    const vsg_real_t omega = watch->omega + VSG_WATCH_BANDWIDTH * VSG_WATCH_BANDWIDTH * T_s * slip;
    const vsg_real_t share = VSG_C(2.0) * VSG_WATCH_BANDWIDTH * T_s;
    const vsg_real_t lowest = (VSG_C(1.0) - VSG_WATCH_RANGE) * refs->omega_0;
    const vsg_real_t highest = (VSG_C(1.0) + VSG_WATCH_RANGE) * refs->omega_0;
    grid_watch->v_alpha = ahead_alpha + share * e_alpha;
    grid_watch->v_beta = ahead_beta + share * e_beta;
    grid_watch->omega = vsg_clip(omega, lowest, highest);
}

/* Phase peak to phase rms. */
static inline vsg_real_t vsg_peak_to_rms(vsg_real_t x_pk)
{
    return x_pk / VSG_SQRT_2;
}

/* The controller's state with the angle, the voltage and the frequency of the grid, without power (eq. synchronised).
 * The inner loops and the limiter keep theirs. */
static inline void vsg_synchronised(const vsg_controller_state_t *state, const vsg_grid_watch_t *watch,
    const vsg_gains_t *gains, vsg_controller_state_t *controller_state)
{
    const vsg_real_t V = vsg_peak_to_rms(VSG_HYPOT(watch->v_alpha, watch->v_beta));
    const vsg_real_t theta = VSG_ATAN2(watch->v_beta, watch->v_alpha);
    const vsg_real_t omega_i = watch->omega + gains->k_Q * gains->D_q * V;
    controller_state->theta = theta;
    controller_state->omega_i = omega_i;
    controller_state->V = V;
    controller_state->P_f = VSG_C(0.0);
    controller_state->Q_f = VSG_C(0.0);
    controller_state->xi_vd = state->xi_vd;
    controller_state->xi_vq = state->xi_vq;
    controller_state->xi_id = state->xi_id;
    controller_state->xi_iq = state->xi_iq;
    controller_state->i_f_d = state->i_f_d;
    controller_state->i_f_q = state->i_f_q;
    controller_state->u_alpha = state->u_alpha;
    controller_state->u_beta = state->u_beta;
    controller_state->ripple_P = VSG_C(0.0);
    controller_state->ripple_Q = VSG_C(0.0);
    controller_state->mean_P = VSG_C(0.0);
    controller_state->mean_Q = VSG_C(0.0);
}

/* 1 if the breaker may close: the converter's voltage is the grid's, which is near the nominal one; else 0. */
static inline vsg_real_t vsg_in_step(const vsg_measurement_t *measured, const vsg_grid_watch_t *watch,
    const vsg_references_t *refs)
{
    const vsg_real_t nominal = vsg_rms_to_peak(refs->V_n);
    const vsg_real_t apart = VSG_HYPOT(measured->v_alpha - watch->v_alpha, measured->v_beta - watch->v_beta);
    const vsg_real_t grid = VSG_HYPOT(watch->v_alpha, watch->v_beta);
    return VSG_C(1.0) * ((apart <= VSG_IN_STEP * nominal) ? VSG_C(1.0) : VSG_C(0.0)) * ((grid >= VSG_IN_STEP_V_LOW
        * nominal) ? VSG_C(1.0) : VSG_C(0.0)) * ((grid <= VSG_IN_STEP_V_HIGH * nominal) ? VSG_C(1.0) : VSG_C(0.0));
}
