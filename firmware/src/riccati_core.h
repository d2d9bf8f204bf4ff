/* The Riccati recursion over an arithmetic type. Private to firmware/src.
 *
 * The includer defines REAL (float on the board; double in the test that shows the recursion itself
 * to be exact) and REAL_SINCOS(angle, &sine, &cosine).
 *
 * With R diagonal, minimising over u1 and then over u2 gives the same P as minimising over both,
 * and each is a rank-one update: for a column b of B_d with weight r,
 *
 *     g = P b,  s = r + b'g,  P <- P - g g'/s.
 *
 * In the Euler form the columns are T e1 and T e3. Scaling the weights by 1/T^2 takes T out of the
 * stage, and the updated row of P, p1 r/s, is written without the subtraction, so nothing cancels.
 * P stays symmetric by construction: only its six distinct entries exist.
 */
#ifndef BERTH_SRC_RICCATI_CORE_H
#define BERTH_SRC_RICCATI_CORE_H

#include "berth/reference.h"
#include "small.h"

/* MISRA D9, T1 in this file. */

typedef struct {
    REAL p11, p12, p13, p22, p23, p33;
} riccati_p_t;

/* Minimises over u1 in the Euler form: column e1, weight rho = r1 / T^2. The minimum is at
 * T u1 = -row e, e being what A makes of the error, with T u2 in it. Returns 1 / s. */
static inline REAL riccati_eliminate_u1(riccati_p_t *p, REAL rho, REAL row[3]) {
    const REAL inverse = (REAL)1 / (p->p11 + rho);
    const REAL t1 = p->p11 * inverse;
    const REAL t2 = p->p12 * inverse;
    const REAL t3 = p->p13 * inverse;
    row[0] = t1;
    row[1] = t2;
    row[2] = t3;
    p->p22 -= t2 * p->p12;
    p->p23 -= t2 * p->p13;
    p->p33 -= t3 * p->p13;
    p->p11 = rho * t1;
    p->p12 = rho * t2;
    p->p13 = rho * t3;
    return inverse;
}

/* The same over u2: column e3, weight rho = r2 / T^2. u1 has gone, so the minimum depends on what A
 * makes of the error alone. */
static inline REAL riccati_eliminate_u2(riccati_p_t *p, REAL rho, REAL row[3]) {
    const REAL inverse = (REAL)1 / (p->p33 + rho);
    const REAL t1 = p->p13 * inverse;
    const REAL t2 = p->p23 * inverse;
    const REAL t3 = p->p33 * inverse;
    row[0] = t1;
    row[1] = t2;
    row[2] = t3;
    p->p11 -= t1 * p->p13;
    p->p12 -= t1 * p->p23;
    p->p22 -= t2 * p->p23;
    p->p13 = rho * t1;
    p->p23 = rho * t2;
    p->p33 = rho * t3;
    return inverse;
}

/* A_k = [[c, a, f], [-a, c, g], [0, 0, 1]]; the Euler form has c = 1 and f = 0. */
typedef struct {
    REAL c, a, f, g;
} riccati_a_t;

/* P <- Q + A' P A in the Euler form: A = [[1, a, 0], [-a, 1, g], [0, 0, 1]]. */
static inline void riccati_propagate_euler(riccati_p_t *p, REAL a, REAL g, const REAL q[3]) {
    const REAL m11 = p->p11 - a * p->p12;
    const REAL m12 = a * p->p11 + p->p12;
    const REAL m13 = g * p->p12 + p->p13;
    const REAL m21 = p->p12 - a * p->p22;
    const REAL m22 = a * p->p12 + p->p22;
    const REAL m23 = g * p->p22 + p->p23;
    const REAL m33 = g * p->p23 + p->p33;
    p->p11 = q[0] + (m11 - a * m21);
    p->p12 = m12 - a * m22;
    p->p13 = m13 - a * m23;
    p->p22 = q[1] + (a * m12 + m22);
    p->p23 = a * m13 + m23;
    p->p33 = q[2] + (g * m23 + m33);
}

/* row <- row A, for a row vector. */
SMALL static void riccati_row_times_a(REAL row[3], const riccati_a_t *m) {
    const REAL x = row[0];
    const REAL y = row[1];
    row[0] = m->c * x - m->a * y;
    row[1] = m->a * x + m->c * y;
    row[2] = m->f * x + m->g * y + row[2];
}

#ifndef BERTH_WITHOUT_ZOH

/* P <- Q + A' P A in the general form. */
static inline void riccati_propagate_zoh(riccati_p_t *p, const riccati_a_t *m, const REAL q[3]) {
    REAL row1[3] = {p->p11, p->p12, p->p13};
    REAL row2[3] = {p->p12, p->p22, p->p23};
    REAL row3[3] = {p->p13, p->p23, p->p33};
    riccati_row_times_a(row1, m);
    riccati_row_times_a(row2, m);
    riccati_row_times_a(row3, m);
    p->p11 = q[0] + (m->c * row1[0] - m->a * row2[0]);
    p->p12 = m->c * row1[1] - m->a * row2[1];
    p->p13 = m->c * row1[2] - m->a * row2[2];
    p->p22 = q[1] + (m->a * row1[1] + m->c * row2[1]);
    p->p23 = m->a * row1[2] + m->c * row2[2];
    p->p33 = q[2] + (m->f * row1[2] + m->g * row2[2] + row3[2]);
}

/* Rank-one update by the column b with weight r. gain <- g'/s, the feedback row before A. */
SMALL static void riccati_eliminate_column(riccati_p_t *p, const REAL b[3], REAL r, REAL gain[3]) {
    const REAL g1 = p->p11 * b[0] + p->p12 * b[1] + p->p13 * b[2];
    const REAL g2 = p->p12 * b[0] + p->p22 * b[1] + p->p23 * b[2];
    const REAL g3 = p->p13 * b[0] + p->p23 * b[1] + p->p33 * b[2];
    const REAL inverse = (REAL)1 / (r + (b[0] * g1 + b[1] * g2 + b[2] * g3));
    gain[0] = g1 * inverse;
    gain[1] = g2 * inverse;
    gain[2] = g3 * inverse;
    p->p11 -= gain[0] * g1;
    p->p12 -= gain[0] * g2;
    p->p13 -= gain[0] * g3;
    p->p22 -= gain[1] * g2;
    p->p23 -= gain[1] * g3;
    p->p33 -= gain[2] * g3;
}

/* (1 - cos a) / a^2 and (a - sin a) / a^3. Both closed forms cancel near 0; below 0.25 rad the
 * series' first omitted terms are under 1e-14. */
static inline void riccati_turn_factors(REAL a, REAL *c2, REAL *s3) {
    const REAL z = a * a;
    if (z < (REAL)0.0625) {
        *c2 = (REAL)1 / (REAL)2 +
              z * ((REAL)-1 / (REAL)24 +
                   z * ((REAL)1 / (REAL)720 +
                        z * ((REAL)-1 / (REAL)40320 + z * ((REAL)1 / (REAL)3628800))));
        *s3 = (REAL)1 / (REAL)6 +
              z * ((REAL)-1 / (REAL)120 +
                   z * ((REAL)1 / (REAL)5040 +
                        z * ((REAL)-1 / (REAL)362880 + z * ((REAL)1 / (REAL)39916800))));
        return;
    }
    REAL sine;
    REAL cosine;
    REAL_SINCOS(a, &sine, &cosine);
    *c2 = ((REAL)1 - cosine) / z;
    *s3 = (a - sine) / (a * z);
}

/* Exact discretisation of A(v, omega) and B for inputs held over T, turn = omega T, way = v T. */
static inline void riccati_discretise_zoh(REAL turn, REAL way, REAL period, riccati_a_t *m,
                                          REAL b1[3], REAL b2[3]) {
    REAL c2;
    REAL s3;
    riccati_turn_factors(turn, &c2, &s3);
    const REAL sinc = (REAL)1 - turn * turn * s3; /* sin(turn) / turn */
    const REAL cosc = turn * c2;                  /* (1 - cos(turn)) / turn */
    m->c = (REAL)1 - turn * cosc;
    m->a = turn * sinc;
    m->f = way * cosc;
    m->g = way * sinc;
    b1[0] = period * sinc;
    b1[1] = -period * cosc;
    b1[2] = 0;
    b2[0] = way * period * (turn * s3);
    b2[1] = way * period * c2;
    b2[2] = period;
}

#endif

/* Turn omega T and way v T of the stage at sample k: zero past the end of an open plan. */
static inline void riccati_stage(const berth_plan_t *plan, uint32_t k, REAL period, REAL *turn,
                                 REAL *way) {
    if (k < plan->count) {
        const berth_sample_t *sample = &plan->samples[k];
        *turn = period * (REAL)sample->omega_radps;
        *way = period * (REAL)sample->v_mps;
    } else {
        *turn = 0;
        *way = 0;
    }
}

/* The stages run backwards from the last one, k + N - 1, with the plan's wrap. */
static inline uint32_t riccati_last_stage(const berth_plan_t *plan, uint32_t k) {
    const uint32_t last = k + plan->mpc.horizon - 1u;
    return plan->closed ? last % plan->count : last;
}

static inline uint32_t riccati_stage_before(const berth_plan_t *plan, uint32_t k) {
    return plan->closed && k == 0u ? plan->count - 1u : k - 1u;
}

/* With both inputs eliminated, K = R^-1 B' P A (Euler form). */
static inline void riccati_gain_from_p(const riccati_p_t *p, const riccati_a_t *m, REAL period,
                                       const float r[2], REAL gain[2][3]) {
    const REAL scale1 = period / (REAL)r[0];
    const REAL scale2 = period / (REAL)r[1];
    REAL row1[3] = {scale1 * p->p11, scale1 * p->p12, scale1 * p->p13};
    REAL row2[3] = {scale2 * p->p13, scale2 * p->p23, scale2 * p->p33};
    riccati_row_times_a(row1, m);
    riccati_row_times_a(row2, m);
    for (int j = 0; j < 3; j++) {
        gain[0][j] = row1[j];
        gain[1][j] = row2[j];
    }
}

static inline void riccati_gain_euler(const berth_plan_t *plan, uint32_t k, REAL period,
                                      REAL gain[2][3]) {
    const REAL q[3] = {(REAL)plan->mpc.q[0], (REAL)plan->mpc.q[1], (REAL)plan->mpc.q[2]};
    const REAL frequency = (REAL)1 / period;
    const REAL rho1 = (REAL)plan->mpc.r[0] * frequency * frequency;
    const REAL rho2 = (REAL)plan->mpc.r[1] * frequency * frequency;
    riccati_p_t p = {q[0], 0, 0, q[1], 0, q[2]};
    uint32_t stage = riccati_last_stage(plan, k);
    REAL turn;
    REAL way;
    REAL unused[3];
    uint32_t i = plan->mpc.horizon;
    for (;;) {
        riccati_stage(plan, stage, period, &turn, &way);
        (void)riccati_eliminate_u1(&p, rho1, unused);
        (void)riccati_eliminate_u2(&p, rho2, unused);
        if (i <= 1u) {
            break;
        }
        riccati_propagate_euler(&p, turn, way, q);
        stage = riccati_stage_before(plan, stage);
        i--;
    }
    riccati_gain_from_p(&p, &(riccati_a_t){1, turn, 0, way}, period, plan->mpc.r, gain);
}

#ifndef BERTH_WITHOUT_ZOH

static inline void riccati_gain_zoh(const berth_plan_t *plan, uint32_t k, REAL period,
                                    REAL gain[2][3]) {
    const REAL q[3] = {(REAL)plan->mpc.q[0], (REAL)plan->mpc.q[1], (REAL)plan->mpc.q[2]};
    riccati_p_t p = {q[0], 0, 0, q[1], 0, q[2]};
    uint32_t stage = riccati_last_stage(plan, k);
    for (uint32_t i = plan->mpc.horizon; i > 0u; i--) {
        REAL turn;
        REAL way;
        riccati_a_t m;
        REAL b1[3];
        REAL b2[3];
        riccati_stage(plan, stage, period, &turn, &way);
        riccati_discretise_zoh(turn, way, period, &m, b1, b2);
        riccati_eliminate_column(&p, b1, (REAL)plan->mpc.r[0], gain[0]);
        riccati_eliminate_column(&p, b2, (REAL)plan->mpc.r[1], gain[1]);
        if (i > 1u) {
            riccati_propagate_zoh(&p, &m, q);
            stage = riccati_stage_before(plan, stage);
            continue;
        }
        /* u1 was minimised first, for a state that u2 still moves: u1 = -gain1 (e + b2 u2) */
        const REAL coupling = gain[0][0] * b2[0] + gain[0][1] * b2[1] + gain[0][2] * b2[2];
        for (int j = 0; j < 3; j++) {
            gain[0][j] -= coupling * gain[1][j];
        }
        riccati_row_times_a(gain[0], &m);
        riccati_row_times_a(gain[1], &m);
    }
}

#endif

static inline void riccati_gain(const berth_plan_t *plan, uint32_t k, REAL gain[2][3]) {
    const REAL period = (REAL)plan->period_us / (REAL)1000000;
    if (k >= plan->count) {
        /* past an open plan's end all stages are alike; a large k must not overflow with N */
        k = plan->closed ? k % plan->count : plan->count;
    }
#ifndef BERTH_WITHOUT_ZOH
    if (plan->mpc.discretization == BERTH_DISCRETIZATION_ZOH) {
        riccati_gain_zoh(plan, k, period, gain);
        return;
    }
#endif
    riccati_gain_euler(plan, k, period, gain);
}

#endif
