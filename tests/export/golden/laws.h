#include <math.h>

/* Single precision unless VSG_DOUBLE is defined, for every file alike. */
#ifdef VSG_DOUBLE
typedef double vsg_real_t;
#define VSG_C(x) (x)
#else
typedef float vsg_real_t;
#define VSG_C(x) (x##F)
#endif

/* The parameters of a schedule for one grid. With the Jacobian they give the gains (eq. structure-gains). */
typedef struct {
    vsg_real_t k_1_or_H;
    vsg_real_t d_1_or_zeta;
    vsg_real_t k_2;
    vsg_real_t q;
    vsg_real_t share_P;
    vsg_real_t share_Q;
} vsg_normalised_t;

/* Gains of the power-loop law (eq. power-loop-law). The published structure uses the first four. */
typedef struct {
    vsg_real_t K_ip; /* rad/(s^2*W) */
    vsg_real_t D_p; /* W*s/rad */
    vsg_real_t K_iq; /* V/(s*var) */
    vsg_real_t D_q; /* var/V (rms) */
    vsg_real_t K_pq; /* rad/(s^2*var) */
    vsg_real_t K_qp; /* V/(s*W) */
    vsg_real_t k_P; /* rad/(s*W) */
    vsg_real_t k_Q; /* rad/(s*var) */
} vsg_gains_t;

/* Set points of the power loops. They may be changed between two samples. */
typedef struct {
    vsg_real_t P_ref; /* W */
    vsg_real_t Q_ref; /* var */
    vsg_real_t omega_0; /* rad/s */
    vsg_real_t V_n; /* V, phase rms */
} vsg_references_t;

/* Everything that the controller remembers from one sample to the next. */
typedef struct {
    vsg_real_t theta; /* Angle of the converter's d axis against the stationary alpha axis, rad. */
    vsg_real_t omega_i; /* Frequency integrator of the P loop, rad/s. */
    vsg_real_t V; /* Voltage integrator of the Q loop, phase rms V. */
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
    /* Bridge voltage of the last sample, V peak; with a delay of one sample it acts from this sample on. */
    vsg_real_t u_alpha;
    vsg_real_t u_beta;
    /* Ripple of P (W) and Q (var) at twice the grid's frequency, as the notch predicts it for this sample. */
    vsg_real_t ripple_P;
    vsg_real_t ripple_Q;
    /* What the notch holds for the rest of P (W) and Q (var). */
    vsg_real_t mean_P;
    vsg_real_t mean_Q;
} vsg_controller_state_t;

/* Constants of the controller, in SI units. They do not change while it runs. */
typedef struct {
    vsg_real_t T_s; /* Sampling period, s. */
    /* 1 - exp(-T_s/tau) of the power filters; 1 means no filter. */
    vsg_real_t smoothing_P;
    vsg_real_t smoothing_Q;
    /* Cross-coupling omega_0 C (S) and omega_0 L_1 (Ohm). */
    vsg_real_t omega_C;
    vsg_real_t omega_L;
    /* Current and bridge-voltage limits, peak. */
    vsg_real_t i_max_pk;
    vsg_real_t v_max_pk;
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
    vsg_real_t K_pv; /* A/V */
    vsg_real_t K_iv; /* A/(V*s) */
    vsg_real_t K_pc; /* V/A */
    vsg_real_t K_ic; /* V/(A*s) */
    vsg_real_t K_ff; /* 1 */
    vsg_real_t R_t; /* Ohm */
    vsg_real_t X_t; /* Ohm */
    vsg_real_t kappa; /* 1 */
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
    vsg_real_t v_alpha;
    vsg_real_t v_beta;
    vsg_real_t i_s_alpha;
    vsg_real_t i_s_beta;
    vsg_real_t i_g_alpha;
    vsg_real_t i_g_beta;
} vsg_measurement_t;

/* Bridge voltage in alpha-beta (V peak), the frequency used (rad/s), unfiltered P (W) and Q (var), and whether the
 * current limiter acted (1 or 0). */
typedef struct {
    vsg_real_t v_b_alpha;
    vsg_real_t v_b_beta;
    vsg_real_t omega;
    vsg_real_t P;
    vsg_real_t Q;
    vsg_real_t limited;
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

#define VSG_CHI_SQUARE_95 VSG_C(5.991464547107979)
#define VSG_PHASES VSG_C(3.0)
#define VSG_POWER_MARGIN VSG_C(1.3)
#define VSG_LEAST_SHARE VSG_C(0.2)
#define VSG_TURN VSG_C(6.283185307179586)
#define VSG_SPACE_VECTOR_POWER VSG_C(1.5)
#define VSG_SQRT_2 VSG_C(1.4142135623730951)
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

/* Short-circuit ratio of a grid, taken on |Z_g|. */
static inline vsg_real_t vsg_scr_impedance(vsg_real_t R_g, vsg_real_t L_g, vsg_real_t Z_base, vsg_real_t omega)
{
    return Z_base / VSG_HYPOT(R_g, omega * L_g);
}

/* Returns (R_g, L_g) in Ohm and H for a ratio taken on |Z_g| (eq. scr). */
static inline void vsg_grid_from_scr_impedance(vsg_real_t scr, vsg_real_t x_over_r, vsg_real_t Z_base, vsg_real_t omega,
    vsg_real_t *R_g_out, vsg_real_t *L_g)
{
    const vsg_real_t R_g = Z_base / scr / VSG_HYPOT(VSG_C(1.0), x_over_r);
    *R_g_out = R_g;
    *L_g = R_g * x_over_r / omega;
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
    return vsg_min(vsg_max(Q, -most), most);
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
    const vsg_limiter_view_t view = {.v_d = v_d, .v_q = v_q, .i_s_d = i_s_d, .i_s_q = i_s_q, .i_g_d = i_g_d,
        .i_g_q = i_g_q, .e_d = e_d, .e_q = e_q, .i_want_d = i_want_d, .i_want_q = i_want_q, .V = V_rms,
        .omega_i = state->omega_i, .P = passed_P, .Q = passed_Q, .K_pv = inner_gains->K_pv};
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
    const vsg_real_t omega_new = vsg_min(vsg_max(omega, -fastest), fastest);
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
    grid_watch->omega = vsg_min(vsg_max(omega, lowest), highest);
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
