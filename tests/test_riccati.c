/* The gain against DESIGN's stacked form, in double, for both shapes, horizons, weights and
 * discretisations; and the recursion itself in double, as an optimum of the cost.
 *
 * The reference shares nothing with the recursion: E = F e + G U is built block by block from A_k
 * and B_k, and (G' Qb G + Rb) U = -G' Qb F e is solved by Cholesky. The zero-order hold comes from
 * the matrix exponential's series.
 */
#include "support.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static void sincos_double(double angle_rad, double *sine, double *cosine) {
    *sine = sin(angle_rad);
    *cosine = cos(angle_rad);
}

#define REAL double
#define REAL_SINCOS sincos_double
#include "../firmware/src/riccati_core.h"

#define N_MAX 50
#define FLOAT_LIMIT 1.0e-4
#define DOUBLE_LIMIT 1.0e-10

static support_plan_t trajectory;

void setUp(void) {}

void tearDown(void) {}

/* ---- The model: A_k and B_k of one stage ---- */

typedef struct {
    double a[3][3];
    double b[3][2];
} model_t;

/* Speeds of stage k; nothing moves beyond the end of an open plan. */
static void stage_speeds(const berth_plan_t *plan, uint64_t k, double *v, double *omega) {
    *v = 0.0;
    *omega = 0.0;
    if (plan->closed || k < plan->count) {
        *v = (double)plan->samples[k % plan->count].v_mps;
        *omega = (double)plan->samples[k % plan->count].omega_radps;
    }
}

static void multiply5(double x[5][5], double y[5][5], double out[5][5]) {
    for (int i = 0; i < 5; i++) {
        for (int j = 0; j < 5; j++) {
            out[i][j] = 0.0;
            for (int k = 0; k < 5; k++) {
                out[i][j] += x[i][k] * y[k][j];
            }
        }
    }
}

/* m <- exp(m): Taylor series of m / 2^10, then squared ten times. */
static void exponential5(double m[5][5]) {
    double sum[5][5] = {{0.0}};
    double term[5][5] = {{0.0}};
    double next[5][5];
    for (int i = 0; i < 5; i++) {
        sum[i][i] = term[i][i] = 1.0;
        for (int j = 0; j < 5; j++) {
            m[i][j] /= 1024.0;
        }
    }
    for (int n = 1; n < 20; n++) {
        multiply5(term, m, next);
        for (int i = 0; i < 25; i++) {
            term[i / 5][i % 5] = next[i / 5][i % 5] / n;
            sum[i / 5][i % 5] += term[i / 5][i % 5];
        }
    }
    for (int n = 0; n < 10; n++) {
        multiply5(sum, sum, next);
        memcpy(sum, next, sizeof sum);
    }
    memcpy(m, sum, sizeof sum);
}

/* Euler: A_k = I + T A, B = T B. Zero-order hold: exp([A B; 0 0] T) = [A_k B_k; 0 I]. */
static model_t stage_model(const berth_plan_t *plan, uint64_t k) {
    const double period = plan->period_us / 1.0e6;
    double v;
    double omega;
    stage_speeds(plan, k, &v, &omega);
    double m[5][5] = {
        {0.0, omega, 0.0, 1.0, 0.0},
        {-omega, 0.0, v, 0.0, 0.0},
        {0.0, 0.0, 0.0, 0.0, 1.0},
    };
    for (int i = 0; i < 25; i++) {
        m[i / 5][i % 5] *= period;
    }
    if (plan->mpc.discretization == BERTH_DISCRETIZATION_ZOH) {
        exponential5(m);
    } else {
        for (int i = 0; i < 5; i++) {
            m[i][i] += 1.0;
        }
    }
    model_t model;
    for (int i = 0; i < 3; i++) {
        memcpy(model.a[i], m[i], sizeof model.a[i]);
        memcpy(model.b[i], &m[i][3], sizeof model.b[i]);
    }
    return model;
}

/* ---- The stacked form ---- */

/* E = F e + G U over the horizon n. hessian = G' Qb G + Rb, rhs = G' Qb F; then k_all, 2n x 3, with
 * hessian k_all = rhs. */
static double stacked_f[3 * N_MAX][3];
static double stacked_g[3 * N_MAX][2 * N_MAX];
static double hessian[2 * N_MAX][2 * N_MAX];
static double k_all[2 * N_MAX][3];

/* Rows 3 i to 3 i + 2 belong to e(k + i + 1) = A e(k + i) + B u(k + i). */
static void build_block_row(const berth_plan_t *plan, uint64_t k, int i) {
    const model_t model = stage_model(plan, k + (uint64_t)i);
    for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 3; column++) {
            stacked_f[3 * i + row][column] = i == 0 ? model.a[row][column] : 0.0;
            for (int l = 0; i > 0 && l < 3; l++) {
                stacked_f[3 * i + row][column] +=
                    model.a[row][l] * stacked_f[3 * (i - 1) + l][column];
            }
        }
        for (int column = 0; column < 2 * N_MAX; column++) {
            stacked_g[3 * i + row][column] = 0.0;
            for (int l = 0; i > 0 && l < 3; l++) {
                stacked_g[3 * i + row][column] +=
                    model.a[row][l] * stacked_g[3 * (i - 1) + l][column];
            }
        }
        stacked_g[3 * i + row][2 * i] = model.b[row][0];
        stacked_g[3 * i + row][2 * i + 1] = model.b[row][1];
    }
}

static void build_normal_equations(const berth_mpc_t *mpc, int n) {
    for (int i = 0; i < 2 * n; i++) {
        const int first = 3 * (i / 2); /* G is block lower triangular: zeros above */
        for (int j = 0; j <= i; j++) {
            hessian[i][j] = i == j ? (double)mpc->r[i % 2] : 0.0;
            for (int l = first; l < 3 * n; l++) {
                hessian[i][j] += stacked_g[l][i] * (double)mpc->q[l % 3] * stacked_g[l][j];
            }
            hessian[j][i] = hessian[i][j];
        }
        for (int j = 0; j < 3; j++) {
            k_all[i][j] = 0.0;
            for (int l = first; l < 3 * n; l++) {
                k_all[i][j] += stacked_g[l][i] * (double)mpc->q[l % 3] * stacked_f[l][j];
            }
        }
    }
}

/* hessian = L L' in place, then L L' x = rhs for the three columns of k_all. */
static void solve_by_cholesky(int size) {
    for (int j = 0; j < size; j++) {
        for (int i = j; i < size; i++) {
            double sum = hessian[i][j];
            for (int l = 0; l < j; l++) {
                sum -= hessian[i][l] * hessian[j][l];
            }
            TEST_ASSERT_TRUE_MESSAGE(i != j || sum > 0.0, "Hessian not positive definite");
            hessian[i][j] = i == j ? sqrt(sum) : sum / hessian[j][j];
        }
    }
    for (int c = 0; c < 3; c++) {
        for (int i = 0; i < size; i++) {
            for (int l = 0; l < i; l++) {
                k_all[i][c] -= hessian[i][l] * k_all[l][c];
            }
            k_all[i][c] /= hessian[i][i];
        }
        for (int i = size - 1; i >= 0; i--) {
            for (int l = i + 1; l < size; l++) {
                k_all[i][c] -= hessian[l][i] * k_all[l][c];
            }
            k_all[i][c] /= hessian[i][i];
        }
    }
}

/* K_k is the first two rows of k_all; U* = -k_all e. */
static void solve_stacked(const berth_plan_t *plan, uint64_t k) {
    const int n = plan->mpc.horizon;
    TEST_ASSERT_TRUE(n <= N_MAX);
    for (int i = 0; i < n; i++) {
        build_block_row(plan, k, i);
    }
    build_normal_equations(&plan->mpc, n);
    solve_by_cholesky(2 * n);
}

/* ---- Comparison ---- */

/* Worst error and where it was. */
typedef struct {
    double error;
    char where[160];
} worst_t;

static worst_t worst_float;
static worst_t worst_double;

static void describe(char where[160], const berth_plan_t *plan, uint64_t k) {
    const berth_mpc_t *mpc = &plan->mpc;
    (void)snprintf(where, 160, "k=%llu/%u %s %s N=%u Q=%g,%g,%g R=%g,%g v=%g omega=%g T=%uus",
                   (unsigned long long)k, plan->count, plan->closed ? "closed" : "open",
                   mpc->discretization == BERTH_DISCRETIZATION_ZOH ? "zoh" : "euler", mpc->horizon,
                   (double)mpc->q[0], (double)mpc->q[1], (double)mpc->q[2], (double)mpc->r[0],
                   (double)mpc->r[1], (double)plan->samples[k % plan->count].v_mps,
                   (double)plan->samples[k % plan->count].omega_radps, plan->period_us);
}

static void note(worst_t *worst, double error, const berth_plan_t *plan, uint64_t k) {
    if (!(error <= worst->error)) { /* NaN too */
        worst->error = error;
        describe(worst->where, plan, k);
    }
}

/* Largest difference in a row, relative to the norm of the row. A row of zeros must be zeros. */
static double row_error(const double expected[3], const double actual[3]) {
    const double norm =
        sqrt(expected[0] * expected[0] + expected[1] * expected[1] + expected[2] * expected[2]);
    double difference = 0.0;
    for (int j = 0; j < 3; j++) {
        const double d = fabs(actual[j] - expected[j]);
        difference = d <= difference ? difference : d;
    }
    if (norm > 0.0) {
        return difference / norm;
    }
    return difference == 0.0 ? 0.0 : HUGE_VAL;
}

/* Both recursions against the stacked form at sample k. */
static void compare(const berth_plan_t *plan, uint32_t k) {
    solve_stacked(plan, k);
    berth_gain_t gain;
    berth_riccati_gain(plan, k, &gain);
    double exact[2][3];
    riccati_gain(plan, k, exact);
    for (int row = 0; row < 2; row++) {
        const double rounded[3] = {(double)gain.k[row][0], (double)gain.k[row][1],
                                   (double)gain.k[row][2]};
        note(&worst_float, row_error(k_all[row], rounded), plan, k);
        note(&worst_double, row_error(k_all[row], exact[row]), plan, k);
    }
}

static void reset_worst(void) {
    worst_float = (worst_t){0};
    worst_double = (worst_t){0};
}

static void report(const char *what) {
    printf("%s: float32 %.2e at %s\n", what, worst_float.error, worst_float.where);
    printf("%s: double  %.2e at %s\n", what, worst_double.error, worst_double.where);
    TEST_ASSERT_TRUE_MESSAGE(worst_float.error <= FLOAT_LIMIT, worst_float.where);
    TEST_ASSERT_TRUE_MESSAGE(worst_double.error <= DOUBLE_LIMIT, worst_double.where);
}

static const uint16_t horizons[] = {1, 5, 20, 50};

/* The reference takes time with the horizon's cube: not the long ones where little is to be done.
 */
static size_t horizon_count(void) {
    return support_runs(40) >= 4 ? 4 : 2;
}

static uint32_t coarser(uint32_t stride) {
    return support_runs(40) >= 4 ? stride : 4 * stride;
}

static const struct {
    float q[3], r[2];
} weights[] = {
    {{10.0f, 40.0f, 1.0f}, {0.5f, 0.1f}}, /* the experiments' */
    {{1.0f, 1.0f, 1.0f}, {1.0f, 1.0f}},         {{10.0f, 40.0f, 0.0f}, {0.1f, 0.1f}},
    {{0.0f, 1.0f, 0.0f}, {0.01f, 0.01f}},       {{1.0f, 0.0f, 0.0f}, {0.5f, 0.1f}},
    {{0.0f, 0.0f, 2.0f}, {0.5f, 0.1f}},         {{0.0f, 0.0f, 0.0f}, {0.5f, 0.1f}},
    {{200.0f, 500.0f, 100.0f}, {0.05f, 0.02f}}, {{0.1f, 0.2f, 0.05f}, {20.0f, 50.0f}},
};

#define WEIGHTS (sizeof weights / sizeof weights[0])

static void set_weights(berth_plan_t *plan, size_t i) {
    memcpy(plan->mpc.q, weights[i].q, sizeof plan->mpc.q);
    memcpy(plan->mpc.r, weights[i].r, sizeof plan->mpc.r);
}

/* Every few samples, and near the end all that see it differently. */
static void compare_along(const berth_plan_t *plan) {
    const uint32_t count = plan->count;
    const uint32_t stride = count / support_runs(6);
    for (uint32_t k = 0; k < count; k += stride) {
        compare(plan, k);
    }
    const uint32_t back[] = {1, 2, 5, 20, 21, 50};
    for (size_t i = 0; i < support_runs(sizeof back / sizeof back[0]); i++) {
        compare(plan, count - back[i]);
    }
    compare(plan, count);
    compare(plan, count + 7);
}

static void compare_all(support_shape_t shape, bool closed, uint8_t discretization) {
    support_plan(&trajectory, shape, closed ? 419 : 600, closed);
    trajectory.plan.mpc.discretization = discretization;
    for (size_t n = 0; n < horizon_count(); n++) {
        trajectory.plan.mpc.horizon = horizons[n];
        for (size_t i = 0; i < WEIGHTS; i++) {
            set_weights(&trajectory.plan, i);
            compare_along(&trajectory.plan);
        }
    }
}

static void compare_discretization(uint8_t discretization, const char *what) {
    reset_worst();
    compare_all(SUPPORT_CIRCLE, false, discretization);
    compare_all(SUPPORT_CIRCLE, true, discretization);
    compare_all(SUPPORT_EIGHT, false, discretization);
    compare_all(SUPPORT_EIGHT, true, discretization);
    report(what);
}

static void test_euler_against_the_stacked_form(void) {
    compare_discretization(BERTH_DISCRETIZATION_EULER, "shapes, euler");
}

static void test_zero_order_hold_against_the_stacked_form(void) {
    compare_discretization(BERTH_DISCRETIZATION_ZOH, "shapes, zero-order hold");
}

/* ---- Stages that the shapes do not have ---- */

/* Ten samples of the same speeds. */
static void constant_plan(float v, float omega, uint32_t period_us, bool closed) {
    support_plan(&trajectory, SUPPORT_CIRCLE, 10, closed);
    trajectory.plan.period_us = period_us;
    for (uint32_t k = 0; k < trajectory.plan.count; k++) {
        trajectory.samples[k].v_mps = v;
        trajectory.samples[k].omega_radps = omega;
    }
}

/* With forward Euler a turn makes the model unstable: each stage stretches e by sqrt(1 + turn^2),
 * and the stacked form, which multiplies all stages, runs out of digits. The recursion does not. */
static bool stacked_form_is_sound(const berth_plan_t *plan) {
    const double turn = (double)plan->samples[0].omega_radps * plan->period_us / 1.0e6;
    return plan->mpc.discretization == BERTH_DISCRETIZATION_ZOH ||
           plan->mpc.horizon * 0.5 * log(1.0 + turn * turn) < log(100.0);
}

static void compare_constant(float v, float omega, uint32_t period_us) {
    for (int i = 0; i < 4; i++) {
        constant_plan(v, omega, period_us, i % 2 == 0);
        trajectory.plan.mpc.discretization =
            i < 2 ? BERTH_DISCRETIZATION_EULER : BERTH_DISCRETIZATION_ZOH;
        for (size_t n = 0; n < horizon_count(); n++) {
            trajectory.plan.mpc.horizon = horizons[n];
            if (stacked_form_is_sound(&trajectory.plan)) {
                compare(&trajectory.plan, 0);
                compare(&trajectory.plan, 8);
            }
        }
    }
}

static void test_standstill(void) {
    reset_worst();
    compare_constant(0.0f, 0.0f, 50000);
    compare_constant(0.5f, 0.0f, 50000);
    compare_constant(0.0f, 1.0f, 50000);
    compare_constant(-0.5f, 0.3f, 50000);
    report("standing, straight, turning on the spot, backwards");
}

/* e2 cannot be controlled while the reference stands: its column of the gain is 0. */
static void test_standstill_leaves_e2_alone(void) {
    constant_plan(0.0f, 0.0f, 50000, true);
    for (uint8_t d = 0; d < 2; d++) {
        trajectory.plan.mpc.discretization = d;
        berth_gain_t gain;
        berth_riccati_gain(&trajectory.plan, 0, &gain);
        TEST_ASSERT_EQUAL_FLOAT(0.0f, gain.k[0][1]);
        TEST_ASSERT_EQUAL_FLOAT(0.0f, gain.k[1][1]);
        TEST_ASSERT_TRUE(gain.k[0][0] > 0.0f);
        TEST_ASSERT_TRUE(gain.k[1][2] > 0.0f);
    }
}

/* A standstill in the middle of a trajectory, shorter and longer than the horizon. */
static void test_standstill_within_a_trajectory(void) {
    reset_worst();
    for (uint8_t d = 0; d < 2; d++) {
        for (uint32_t length = 1; length <= 40; length += 13) {
            support_plan(&trajectory, SUPPORT_EIGHT, 200, false);
            trajectory.plan.mpc.discretization = d;
            for (uint32_t k = 100; k < 100 + length; k++) {
                trajectory.samples[k].v_mps = 0.0f;
                trajectory.samples[k].omega_radps = 0.0f;
            }
            for (uint32_t k = 70; k < 145; k += coarser(3)) {
                compare(&trajectory.plan, k);
            }
        }
    }
    report("standstill on the way");
}

/* Turn per period from nearly nothing to a quarter turn, both signs, and closely on both sides of
 * 0.25 rad, where the zero-order hold changes from its series to sine and cosine. */
static void test_turn_rates_on_both_sides_of_the_series(void) {
    const float turns[] = {1.0e-30f, 1.0e-8f,  1.0e-4f, 0.01f,      0.1f, 0.2f, 0.249f,
                           0.24999f, 0.25001f, 0.251f,  0.2500001f, 0.3f, 0.7f, 1.5707f};
    reset_worst();
    for (size_t i = 0; i < sizeof turns / sizeof turns[0]; i++) {
        compare_constant(0.3f, turns[i] / 0.05f, 50000);
        compare_constant(0.8f, -turns[i] / 0.05f, 50000);
        compare_constant(0.3f, turns[i] / 0.5f, 500000);
    }
    report("turn rates");
}

/* The series and the closed form meet: the gain does not jump at the threshold. */
static void test_no_jump_at_the_series_threshold(void) {
    berth_gain_t below;
    berth_gain_t above;
    constant_plan(0.3f, 4.999999f, 50000, true);
    trajectory.plan.mpc.discretization = BERTH_DISCRETIZATION_ZOH;
    berth_riccati_gain(&trajectory.plan, 0, &below);
    constant_plan(0.3f, 5.000001f, 50000, true);
    trajectory.plan.mpc.discretization = BERTH_DISCRETIZATION_ZOH;
    berth_riccati_gain(&trajectory.plan, 0, &above);
    for (int i = 0; i < 6; i++) {
        TEST_ASSERT_FLOAT_WITHIN(2.0e-5f, below.k[i / 3][i % 3], above.k[i / 3][i % 3]);
    }
}

static void test_periods_from_shortest_to_longest(void) {
    const uint32_t periods[] = {1000, 10000, 20000, 100000, 333333, 1000000};
    reset_worst();
    for (size_t i = 0; i < sizeof periods / sizeof periods[0]; i++) {
        compare_constant(0.4f, 0.3f, periods[i]);
    }
    report("periods");
}

/* Random speeds in every sample, so that no stage is like the next. */
static void test_random_trajectories(void) {
    support_random_start();
    reset_worst();
    for (uint32_t run = 0; run < support_runs(600); run++) {
        support_plan(&trajectory, SUPPORT_CIRCLE, 60, support_index(2) == 0);
        for (uint32_t k = 0; k < trajectory.plan.count; k++) {
            trajectory.samples[k].v_mps = (float)support_uniform(-0.8, 0.8);
            trajectory.samples[k].omega_radps = (float)support_uniform(-3.0, 3.0);
        }
        trajectory.plan.mpc.discretization = (uint8_t)support_index(2);
        trajectory.plan.mpc.horizon = (uint16_t)(1u + support_index(30));
        set_weights(&trajectory.plan, support_index(WEIGHTS));
        compare(&trajectory.plan, support_index(61));
    }
    report("random trajectories");
}

/* ---- Ends and wraps ---- */

static void check_same_gain(const berth_plan_t *plan, uint32_t k, const berth_plan_t *other,
                            uint32_t other_k) {
    berth_gain_t gain;
    berth_gain_t other_gain;
    berth_riccati_gain(plan, k, &gain);
    berth_riccati_gain(other, other_k, &other_gain);
    TEST_ASSERT_EQUAL_MEMORY(&gain, &other_gain, sizeof gain);
}

/* Beyond an open plan all stages stand, so it is one gain, and the horizon does not see the plan.
 */
static void test_beyond_the_end_is_one_gain(void) {
    static support_plan_t standing;
    support_plan(&trajectory, SUPPORT_EIGHT, 100, false);
    support_plan(&standing, SUPPORT_EIGHT, 100, true);
    for (uint32_t k = 0; k < 100; k++) {
        standing.samples[k].v_mps = 0.0f;
        standing.samples[k].omega_radps = 0.0f;
    }
    const uint32_t beyond[] = {100, 101, 150, 1000000, UINT32_MAX - 19, UINT32_MAX};
    for (uint8_t d = 0; d < 2; d++) {
        trajectory.plan.mpc.discretization = d;
        standing.plan.mpc.discretization = d;
        for (size_t i = 0; i < sizeof beyond / sizeof beyond[0]; i++) {
            check_same_gain(&trajectory.plan, beyond[i], &standing.plan, 0);
        }
    }
}

static void test_closed_wraps(void) {
    support_plan(&trajectory, SUPPORT_EIGHT, 97, true);
    const uint32_t laps[] = {1, 2, 1000, UINT32_MAX / 97};
    for (uint8_t d = 0; d < 2; d++) {
        trajectory.plan.mpc.discretization = d;
        for (size_t i = 0; i < sizeof laps / sizeof laps[0]; i++) {
            for (uint32_t k = 0; k < 97 && k <= UINT32_MAX - 97 * laps[i]; k++) {
                check_same_gain(&trajectory.plan, k + 97 * laps[i], &trajectory.plan, k);
            }
        }
    }
}

/* A horizon longer than a closed plan goes round it more than once. */
static void test_horizon_longer_than_the_plan(void) {
    reset_worst();
    for (int i = 0; i < 4; i++) {
        for (uint32_t count = 1; count <= 60; count += coarser(7)) {
            support_plan(&trajectory, SUPPORT_EIGHT, 60, false);
            trajectory.plan.count = count;
            trajectory.plan.closed = i % 2 == 0;
            trajectory.plan.mpc.discretization =
                i < 2 ? BERTH_DISCRETIZATION_EULER : BERTH_DISCRETIZATION_ZOH;
            trajectory.plan.mpc.horizon = 50;
            for (uint32_t k = 0; k <= count; k += coarser(5)) {
                compare(&trajectory.plan, k);
            }
        }
    }
    report("short plans");
}

/* Mirrored (omega and e2, e3, u2 change sign) the gain mirrors, to the bit. */
static void test_mirrored_trajectory_gives_the_mirrored_gain(void) {
    static support_plan_t mirrored;
    support_plan(&trajectory, SUPPORT_EIGHT, 300, false);
    support_plan(&mirrored, SUPPORT_EIGHT, 300, false);
    for (uint32_t k = 0; k < 300; k++) {
        mirrored.samples[k].omega_radps = -mirrored.samples[k].omega_radps;
    }
    static const float sign[2][3] = {{1.0f, -1.0f, -1.0f}, {-1.0f, 1.0f, 1.0f}};
    for (uint32_t k = 0; k < 600; k++) {
        trajectory.plan.mpc.discretization = k % 2;
        mirrored.plan.mpc.discretization = k % 2;
        berth_gain_t gain;
        berth_gain_t other;
        berth_riccati_gain(&trajectory.plan, k / 2, &gain);
        berth_riccati_gain(&mirrored.plan, k / 2, &other);
        for (int i = 0; i < 6; i++) {
            TEST_ASSERT_EQUAL_FLOAT(gain.k[i / 3][i % 3],
                                    sign[i / 3][i % 3] * other.k[i / 3][i % 3]);
        }
    }
}

/* ---- The recursion's inputs are the optimum ---- */

/* J by rolling the model out: no stacked matrices, no recursion. */
static double cost(const berth_plan_t *plan, uint32_t k, const double start[3],
                   double inputs[N_MAX][2]) {
    double e[3] = {start[0], start[1], start[2]};
    double sum = 0.0;
    for (int i = 0; i < plan->mpc.horizon; i++) {
        const model_t m = stage_model(plan, (uint64_t)k + (uint64_t)i);
        const double *u = inputs[i];
        double next[3];
        for (int row = 0; row < 3; row++) {
            next[row] = m.a[row][0] * e[0] + m.a[row][1] * e[1] + m.a[row][2] * e[2] +
                        m.b[row][0] * u[0] + m.b[row][1] * u[1];
            sum += (double)plan->mpc.q[row] * next[row] * next[row];
        }
        memcpy(e, next, sizeof e);
        sum += (double)plan->mpc.r[0] * u[0] * u[0] + (double)plan->mpc.r[1] * u[1] * u[1];
    }
    return sum;
}

/* U* from the recursion: the gain of stage i is that of the problem that starts there with what is
 * left of the horizon (Bellman's principle). */
static void optimal_inputs(const berth_plan_t *plan, uint32_t k, const double start[3],
                           double inputs[N_MAX][2]) {
    berth_plan_t rest = *plan;
    double e[3] = {start[0], start[1], start[2]};
    for (int i = 0; i < plan->mpc.horizon; i++) {
        rest.mpc.horizon = (uint16_t)(plan->mpc.horizon - i);
        double gain[2][3];
        riccati_gain(&rest, k + (uint32_t)i, gain);
        const model_t m = stage_model(plan, (uint64_t)k + (uint64_t)i);
        double next[3];
        for (int row = 0; row < 2; row++) {
            inputs[i][row] = -(gain[row][0] * e[0] + gain[row][1] * e[1] + gain[row][2] * e[2]);
        }
        for (int row = 0; row < 3; row++) {
            next[row] = m.a[row][0] * e[0] + m.a[row][1] * e[1] + m.a[row][2] * e[2] +
                        m.b[row][0] * inputs[i][0] + m.b[row][1] * inputs[i][1];
        }
        memcpy(e, next, sizeof e);
    }
}

typedef struct {
    const berth_plan_t *plan;
    uint32_t k;
    double start[3];
    double inputs[N_MAX][2];
    double optimum;
} problem_t;

static problem_t random_problem(void) {
    support_plan(&trajectory, support_index(2) == 0 ? SUPPORT_CIRCLE : SUPPORT_EIGHT, 200,
                 support_index(2) == 0);
    trajectory.plan.mpc.discretization = (uint8_t)support_index(2);
    trajectory.plan.mpc.horizon = horizons[support_index(4)];
    set_weights(&trajectory.plan, support_index(WEIGHTS));
    problem_t problem = {.plan = &trajectory.plan, .k = support_index(200)};
    for (int i = 0; i < 3; i++) {
        problem.start[i] = support_uniform(-1.0, 1.0);
    }
    optimal_inputs(problem.plan, problem.k, problem.start, problem.inputs);
    problem.optimum = cost(problem.plan, problem.k, problem.start, problem.inputs);
    return problem;
}

/* J is quadratic, so a central difference is its derivative but for rounding. */
static void test_gradient_of_the_cost_vanishes(void) {
    support_random_start();
    double worst = 0.0;
    for (uint32_t run = 0; run < support_runs(100); run++) {
        problem_t problem = random_problem();
        for (int i = 0; i < 2 * problem.plan->mpc.horizon; i++) {
            double *u = &problem.inputs[i / 2][i % 2];
            const double kept = *u;
            *u = kept + 1.0;
            const double up = cost(problem.plan, problem.k, problem.start, problem.inputs);
            *u = kept - 1.0;
            const double down = cost(problem.plan, problem.k, problem.start, problem.inputs);
            *u = kept;
            const double curvature = up + down - 2.0 * problem.optimum;
            worst = fmax(worst, fabs(up - down) / (2.0 * curvature + problem.optimum));
        }
    }
    printf("gradient of the cost at U*, relative: %.2e\n", worst);
    TEST_ASSERT_TRUE(worst <= 1.0e-10);
}

static void test_cost_rises_for_every_perturbation(void) {
    support_random_start();
    for (uint32_t run = 0; run < support_runs(500); run++) {
        problem_t problem = random_problem();
        const double size = support_log_uniform(1.0e-4, 1.0);
        for (int i = 0; i < 2 * problem.plan->mpc.horizon; i++) {
            problem.inputs[i / 2][i % 2] += support_uniform(-size, size);
        }
        const double other = cost(problem.plan, problem.k, problem.start, problem.inputs);
        TEST_ASSERT_TRUE(other > problem.optimum);
    }
}

/* The whole of U*, not only its first input, is the stacked form's solution. */
static void test_optimal_inputs_are_the_stacked_solution(void) {
    support_random_start();
    double worst = 0.0;
    for (uint32_t run = 0; run < support_runs(200); run++) {
        problem_t problem = random_problem();
        solve_stacked(problem.plan, problem.k);
        double size = 0.0;
        double difference = 0.0;
        for (int i = 0; i < 2 * problem.plan->mpc.horizon; i++) {
            const double stacked =
                -(k_all[i][0] * problem.start[0] + k_all[i][1] * problem.start[1] +
                  k_all[i][2] * problem.start[2]);
            size = fmax(size, fabs(stacked));
            difference = fmax(difference, fabs(stacked - problem.inputs[i / 2][i % 2]));
        }
        worst = fmax(worst, size > 0.0 ? difference / size : difference);
    }
    printf("U* of the recursion against the stacked form: %.2e\n", worst);
    TEST_ASSERT_TRUE(worst <= DOUBLE_LIMIT);
}

/* Weights of 0 on all errors: doing nothing is best. */
static void test_no_weights_no_gain(void) {
    support_plan(&trajectory, SUPPORT_EIGHT, 100, true);
    set_weights(&trajectory.plan, 6);
    for (uint8_t d = 0; d < 2; d++) {
        trajectory.plan.mpc.discretization = d;
        berth_gain_t gain;
        berth_riccati_gain(&trajectory.plan, 10, &gain);
        for (int i = 0; i < 6; i++) {
            TEST_ASSERT_EQUAL_FLOAT(0.0f, gain.k[i / 3][i % 3]);
        }
    }
}

/* (1 - cos a) / a^2 without cancellation, and (a - sin a) / a^3 by as many terms as it takes. */
static void expected_turn_factors(double a, double *c2, double *s3) {
    const double half = sin(0.5 * a) / a;
    *c2 = 2.0 * half * half;
    double sum = 0.0;
    double term = 1.0 / 6.0;
    for (int n = 4; n < 60; n += 2) {
        sum += term;
        term *= -a * a / (double)(n * (n + 1));
    }
    *s3 = sum;
}

static void expect_turn_factors(double a, double tolerance) {
    double c2;
    double s3;
    double expected_c2;
    double expected_s3;
    riccati_turn_factors(a, &c2, &s3);
    expected_turn_factors(a, &expected_c2, &expected_s3);
    TEST_ASSERT_TRUE(fabs(c2 - expected_c2) <= tolerance * expected_c2);
    TEST_ASSERT_TRUE(fabs(s3 - expected_s3) <= tolerance * expected_s3);
}

/* Below 0.25 rad the series, with what it omits; from there on the closed forms, which cancel the
 * more the smaller the turn. */
static void test_turn_factors_up_to_where_the_forms_meet_and_beyond(void) {
    for (int sign = -1; sign <= 1; sign += 2) {
        for (int i = 1; i <= 1000; i++) {
            const double share = (double)sign * (double)i / 1000.0;
            expect_turn_factors(0.2499999 * share, 7.0e-15);
            expect_turn_factors((double)sign * 0.25 + 3.0 * share, 4.0e-14);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_euler_against_the_stacked_form);
    RUN_TEST(test_zero_order_hold_against_the_stacked_form);
    RUN_TEST(test_standstill);
    RUN_TEST(test_standstill_leaves_e2_alone);
    RUN_TEST(test_standstill_within_a_trajectory);
    RUN_TEST(test_turn_rates_on_both_sides_of_the_series);
    RUN_TEST(test_no_jump_at_the_series_threshold);
    RUN_TEST(test_periods_from_shortest_to_longest);
    RUN_TEST(test_random_trajectories);
    RUN_TEST(test_beyond_the_end_is_one_gain);
    RUN_TEST(test_closed_wraps);
    RUN_TEST(test_horizon_longer_than_the_plan);
    RUN_TEST(test_mirrored_trajectory_gives_the_mirrored_gain);
    RUN_TEST(test_gradient_of_the_cost_vanishes);
    RUN_TEST(test_cost_rises_for_every_perturbation);
    RUN_TEST(test_optimal_inputs_are_the_stacked_solution);
    RUN_TEST(test_no_weights_no_gain);
    RUN_TEST(test_turn_factors_up_to_where_the_forms_meet_and_beyond);
    return UNITY_END();
}
