#include "berth/constrained.h"

#include "angle_inline.h"
#include "check.h"
#include "scalar.h"
#include "small.h"
#include "tracker_inline.h"

#include "berth/angle.h"

#include <math.h>

#define REAL float
#define REAL_SINCOS berth_sincos
#include "riccati_core.h"

/* Where a wheel stands in its box, and both in one number: right | left << 2. */
#define FREE 0u
#define LOW 1u
#define HIGH 2u
#define RIGHT_OF(wheels) ((wheels) & 3u)
#define LEFT_OF(wheels) ((wheels) >> 2)

/* Relative to the rim's travel: wheels this near to a limit are at it, and multipliers this small
 * are none. Without it rounding would move a wheel in and out of the limit. */
#define TOLERANCE 1.0e-6f

/* Of the rim speed: keeps commands clear of the limit by more than the rounding that follows. */
#define RIM_MARGIN 1.0e-6f

/* A pass that moves no rim by more than this is the last one, m/s. */
#define MOVE_MIN_MPS 2.0e-6f

/* Relative rise of the cost that is rounding. */
#define COST_TOLERANCE 1.0e-6f

/* Smallest part of a step that is tried. */
#define PART_MIN 0.02f

/* A pose this far from where the last step expected it has jumped, m and rad. */
#define JUMP 0.1f

/* Cost to go: e' P e + 2 l' e. */
typedef struct {
    riccati_p_t p;
    float l1, l2, l3;
} value_t;

/* Bounds of z: right wheel, left wheel. */
typedef struct {
    float low[2], high[2];
} box_t;

typedef struct {
    float x1, x2, x3;
} state_t;

typedef struct {
    float u1, u2;
} input_t;

/* ---- Small pieces ---- */

static inline float bound(const box_t *box, int wheel, unsigned where) {
    return where == LOW ? box->low[wheel] : box->high[wheel];
}

/* Curvatures are positive; rounding makes them 0 at worst, where weights are too far apart. */
static inline float reciprocal(float curvature) {
    return curvature != 0.0f ? 1.0f / curvature : 0.0f;
}

static inline unsigned place(float z, float low, float high) {
    if (z < low) {
        return LOW;
    }
    return z > high ? HIGH : FREE;
}

static inline float clip(float z, float low, float high) {
    return minimum(maximum(z, low), high);
}

static inline box_t stage_box(const berth_constrained_t *w, const berth_constrained_stage_t *s) {
    if (s == &w->stages[0]) {
        return (box_t){{w->low0[0], w->low0[1]}, {w->high0[0], w->high0[1]}};
    }
    const float turn = w->half_track_m * s->turn;
    const float right = s->way + turn;
    const float left = s->way - turn;
    return (box_t){{right - w->rim_m, left - w->rim_m}, {right + w->rim_m, left + w->rim_m}};
}

static inline input_t input_from_rims(const berth_constrained_t *w, float right, float left) {
    return (input_t){0.5f * (right + left), 0.5f * w->per_half_track * (right - left)};
}

static inline void save_value(berth_constrained_stage_t *s, const value_t *v) {
    s->p[0] = v->p.p11;
    s->p[1] = v->p.p12;
    s->p[2] = v->p.p13;
    s->p[3] = v->p.p22;
    s->p[4] = v->p.p23;
    s->p[5] = v->p.p33;
}

static inline void save_linear(berth_constrained_stage_t *s, const value_t *v) {
    s->linear[0] = v->l1;
    s->linear[1] = v->l2;
    s->linear[2] = v->l3;
}

static inline value_t saved_value(const berth_constrained_stage_t *s, bool has_linear) {
    value_t v = {{s->p[0], s->p[1], s->p[2], s->p[3], s->p[4], s->p[5]}, 0.0f, 0.0f, 0.0f};
    if (has_linear) {
        v.l1 = s->linear[0];
        v.l2 = s->linear[1];
        v.l3 = s->linear[2];
    }
    return v;
}

/* A e. */
static inline state_t drift(const berth_constrained_stage_t *s, const state_t *e) {
    return (state_t){e->x1 + s->turn * e->x2, (e->x2 - s->turn * e->x1) + s->way * e->x3, e->x3};
}

/* ---- The two-variable minimum in a box ---- */

/* The quadratic of one stage around its free minimum z, in rims: h11 and h22 are the curvatures of
 * either wheel, h12 couples them; all times 4. */
typedef struct {
    float z[2];
    float h11, h12, h22;
} rims_t;

static inline rims_t free_minimum(const berth_constrained_t *w, const value_t *v,
                                  const state_t *x) {
    const float k = w->per_half_track;
    const float a = v->p.p11 + w->rho1;
    const float b = k * v->p.p13;
    const float c = k * k * (v->p.p33 + w->rho2);
    const float g1 = v->p.p11 * x->x1 + v->p.p12 * x->x2 + v->p.p13 * x->x3 + v->l1;
    const float g2 = k * (v->p.p13 * x->x1 + v->p.p23 * x->x2 + v->p.p33 * x->x3 + v->l3);
    const float inverse = reciprocal(a * c - b * b);
    const float u1 = (b * g2 - c * g1) * inverse;
    const float u2 = (b * g1 - a * g2) * inverse;
    return (rims_t){{u1 + u2, u1 - u2}, a + c + 2.0f * b, a - c, a + c - 2.0f * b};
}

/* A minimum outside the box has at least one of the wheels that leave it at the limit that it
 * passes: on the way from the box's minimum to the free one the cost falls, so that way leads out
 * of the box at once. Returns where the wheels stand, with their travel in z. */
SMALL static unsigned box_minimum(const berth_constrained_t *w, const value_t *v, const state_t *x,
                                  const box_t *box, float z[2]) {
    const rims_t q = free_minimum(w, v, x);
    const unsigned right = place(q.z[0], box->low[0], box->high[0]);
    const unsigned left = place(q.z[1], box->low[1], box->high[1]);
    z[0] = q.z[0];
    z[1] = q.z[1];
    if (right != FREE) {
        z[0] = bound(box, 0, right);
        const float other = q.z[1] - q.h12 * reciprocal(q.h22) * (z[0] - q.z[0]);
        const unsigned where = place(other, box->low[1], box->high[1]);
        z[1] = clip(other, box->low[1], box->high[1]);
        const float slope = q.h11 * (z[0] - q.z[0]) + q.h12 * (z[1] - q.z[1]);
        if (left == FREE || (right == HIGH ? slope <= 0.0f : slope >= 0.0f)) {
            return right | where << 2;
        }
    }
    if (left != FREE) {
        z[1] = bound(box, 1, left);
        const float other = q.z[0] - q.h12 * reciprocal(q.h11) * (z[1] - q.z[1]);
        z[0] = clip(other, box->low[0], box->high[0]);
        return place(other, box->low[0], box->high[0]) | left << 2;
    }
    return FREE;
}

/* ---- Backwards ---- */

/* Both wheels free, nothing limited behind: no linear part. Where numbers are beyond float32,
 * rounding can make curvatures negative; as sizes they never add to 0 with the weight. */
static inline void eliminate_free(const berth_constrained_t *w, berth_constrained_stage_t *s,
                                  value_t *v) {
    v->p.p11 = fabsf(v->p.p11);
    (void)riccati_eliminate_u1(&v->p, w->rho1, s->row1);
    v->p.p33 = fabsf(v->p.p33);
    (void)riccati_eliminate_u2(&v->p, w->rho2, s->row2);
}

static void eliminate_both(const berth_constrained_t *w, berth_constrained_stage_t *s, value_t *v) {
    v->p.p11 = fabsf(v->p.p11);
    const float p12 = v->p.p12;
    const float p13 = v->p.p13;
    s->row1[3] = v->l1 * riccati_eliminate_u1(&v->p, w->rho1, s->row1);
    v->l1 = w->rho1 * s->row1[3];
    v->l2 -= p12 * s->row1[3];
    v->l3 -= p13 * s->row1[3];
    v->p.p33 = fabsf(v->p.p33);
    const float q13 = v->p.p13;
    const float q23 = v->p.p23;
    s->row2[3] = v->l3 * riccati_eliminate_u2(&v->p, w->rho2, s->row2);
    v->l1 -= q13 * s->row2[3];
    v->l2 -= q23 * s->row2[3];
    v->l3 = w->rho2 * s->row2[3];
}

/* One wheel stands at z = limit. With u = (limit + f, k f), k = +-2/b, it stays there whatever f
 * is: the column of f is (1, 0, k). */
static void eliminate_one(const berth_constrained_t *w, berth_constrained_stage_t *s, value_t *v,
                          float limit, float k) {
    const riccati_p_t p = v->p;
    const float g1 = p.p11 + k * p.p13;
    const float g2 = p.p12 + k * p.p23;
    const float g3 = p.p13 + k * p.p33;
    const float weight = w->rho1 + k * k * w->rho2;
    const float inverse = 1.0f / (weight + maximum(g1 + k * g3, 0.0f));
    const float t1 = g1 * inverse;
    const float t2 = g2 * inverse;
    const float t3 = g3 * inverse;
    const float rest = ((g1 + w->rho1) * limit + (v->l1 + k * v->l3)) * inverse;
    v->p.p11 -= t1 * g1;
    v->p.p12 -= t1 * g2;
    v->p.p13 -= t1 * g3;
    v->p.p22 -= t2 * g2;
    v->p.p23 -= t2 * g3;
    v->p.p33 -= t3 * g3;
    v->l1 += p.p11 * limit - g1 * rest;
    v->l2 += p.p12 * limit - g2 * rest;
    v->l3 += p.p13 * limit - g3 * rest;
    s->row1[0] = t1;
    s->row1[1] = t2;
    s->row1[2] = t3;
    s->row1[3] = rest;
}

/* Both wheels stand: the input moves the state, and that is all. */
static void eliminate_none(const berth_constrained_t *w, berth_constrained_stage_t *s, value_t *v,
                           const box_t *box) {
    const input_t u =
        input_from_rims(w, bound(box, 0, RIGHT_OF(s->wheels)), bound(box, 1, LEFT_OF(s->wheels)));
    v->l1 += v->p.p11 * u.u1 + v->p.p13 * u.u2;
    v->l2 += v->p.p12 * u.u1 + v->p.p23 * u.u2;
    v->l3 += v->p.p13 * u.u1 + v->p.p33 * u.u2;
}

static inline void eliminate(const berth_constrained_t *w, berth_constrained_stage_t *s, value_t *v,
                             const box_t *box) {
    const unsigned right = RIGHT_OF(s->wheels);
    const unsigned left = LEFT_OF(s->wheels);
    if (s->wheels == FREE) {
        eliminate_both(w, s, v);
    } else if (left == FREE) {
        eliminate_one(w, s, v, bound(box, 0, right), -w->per_half_track);
    } else if (right == FREE) {
        eliminate_one(w, s, v, bound(box, 1, left), w->per_half_track);
    } else {
        eliminate_none(w, s, v, box);
    }
}

static inline void propagate(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                             value_t *v) {
    riccati_propagate_euler(&v->p, s->turn, s->way, w->q);
    const float l1 = v->l1;
    v->l1 = l1 - s->turn * v->l2;
    v->l3 += s->way * v->l2;
    v->l2 += s->turn * l1;
}

/* Which limits a backward sweep takes the wheels to be at: those in `wheels`, those that the
 * forward sweep found, or those of the iterate's states with the cost to go that they have now. */
typedef enum { LIMITS_GIVEN, LIMITS_FOUND, LIMITS_MINIMISED } limits_t;

/* From stage i to the first, with what is known after stage i. */
static void sweep_limited(berth_constrained_t *w, int i, value_t *v, limits_t limits) {
    for (;; i--) {
        berth_constrained_stage_t *s = &w->stages[i];
        const box_t box = stage_box(w, s);
        save_value(s, v);
        save_linear(s, v);
        if (limits == LIMITS_FOUND) {
            s->wheels = s->found;
        } else if (limits == LIMITS_MINIMISED) {
            const state_t x = {s->x[0], s->x[1], s->x[2]};
            float z[2];
            s->wheels = (uint8_t)box_minimum(w, v, &x, &box, z);
        }
        if (s->wheels != FREE && i > w->last_limited) {
            w->last_limited = (int16_t)i;
        }
        eliminate(w, s, v, &box);
        if (i == 0) {
            return;
        }
        propagate(w, s, v);
    }
}

/* Redoes the backward sweep from stage i down. clean: nothing behind it is limited. */
static void sweep_again(berth_constrained_t *w, int i, bool clean, limits_t limits) {
    value_t v = saved_value(&w->stages[i], !clean && i < w->last_limited);
    if (clean || i >= w->last_limited) {
        w->last_limited = -1;
    }
    sweep_limited(w, i, &v, limits);
}

/* The first backward sweep of a step, which also reads the plan. Behind the last stage that is
 * limited there is no linear part. */
static void sweep_first(berth_constrained_t *w, const berth_plan_t *plan, uint32_t index,
                        value_t *v) {
    uint32_t k = riccati_last_stage(plan, index);
    int i = w->horizon - 1;
    *v = (value_t){{w->q[0], 0.0f, 0.0f, w->q[1], 0.0f, w->q[2]}, 0.0f, 0.0f, 0.0f};
    for (; i > w->last_limited; i--) {
        berth_constrained_stage_t *s = &w->stages[i];
        riccati_stage(plan, k, w->period_s, &s->turn, &s->way);
        k = riccati_stage_before(plan, k);
        save_value(s, v);
        eliminate_free(w, s, v);
        if (i == 0) {
            return;
        }
        riccati_propagate_euler(&v->p, s->turn, s->way, w->q);
    }
    for (int j = i; j >= 0; j--) {
        berth_constrained_stage_t *s = &w->stages[j];
        riccati_stage(plan, k, w->period_s, &s->turn, &s->way);
        k = riccati_stage_before(plan, k);
    }
    sweep_limited(w, i, v, LIMITS_GIVEN);
}

/* ---- Forwards ---- */

/* Without limits: whether the optimum needs none. */
static bool is_free(const berth_constrained_t *w, const state_t *error) {
    state_t e = *error;
    for (int i = 0; i < w->horizon; i++) {
        const berth_constrained_stage_t *s = &w->stages[i];
        const state_t x = drift(s, &e);
        const float u2 = s->row2[0] * x.x1 + s->row2[1] * x.x2 + s->row2[2] * x.x3;
        e.x3 = x.x3 - u2;
        const float u1 = s->row1[0] * x.x1 + s->row1[1] * x.x2 + s->row1[2] * e.x3;
        e.x1 = x.x1 - u1;
        e.x2 = x.x2;
        if (i == 0) {
            const float turn = w->half_track_m * u2;
            const float right = -u1 - turn;
            const float left = turn - u1;
            if (!(right >= w->low0[0] && right <= w->high0[0] && left >= w->low0[1] &&
                  left <= w->high0[1])) {
                return false;
            }
        } else if (!(fabsf(s->way + u1) + w->half_track_m * fabsf(s->turn + u2) <= w->rim_m)) {
            return false;
        }
    }
    return true;
}

/* Row 1 or 3 of the gradient of the cost to go after the stage. */
static inline float slope1(const value_t *v, const state_t *e) {
    return v->p.p11 * e->x1 + v->p.p12 * e->x2 + v->p.p13 * e->x3 + v->l1;
}

static inline float slope3(const value_t *v, const state_t *e) {
    return v->p.p13 * e->x1 + v->p.p23 * e->x2 + v->p.p33 * e->x3 + v->l3;
}

static inline bool pushes(unsigned where, float slope, float tolerance) {
    return where == HIGH ? slope <= tolerance : slope >= -tolerance;
}

static inline bool within(const berth_constrained_t *w, const box_t *box, int wheel, float z) {
    const float tolerance = TOLERANCE * w->rim_m;
    return z >= box->low[wheel] - tolerance && z <= box->high[wheel] + tolerance;
}

/* Both wheels free, as the backward sweep took them. */
static bool follow_free(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                        const state_t *x, const box_t *box, float z[2]) {
    const bool affine = s < &w->stages[w->last_limited > 0 ? w->last_limited : 0];
    const float c1 = affine ? s->row1[3] : 0.0f;
    const float c2 = affine ? s->row2[3] : 0.0f;
    const float u2 = -(s->row2[0] * x->x1 + s->row2[1] * x->x2 + s->row2[2] * x->x3 + c2);
    const float x3 = x->x3 + u2;
    const float u1 = -(s->row1[0] * x->x1 + s->row1[1] * x->x2 + s->row1[2] * x3 + c1);
    z[0] = u1 + w->half_track_m * u2;
    z[1] = u1 - w->half_track_m * u2;
    return within(w, box, 0, z[0]) && within(w, box, 1, z[1]);
}

/* One wheel at its limit: the other one follows its policy, and the limit must hold the first. */
static bool follow_one(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                       const state_t *x, const box_t *box, float z[2]) {
    const int wheel = RIGHT_OF(s->wheels) != FREE ? 0 : 1;
    const unsigned where = wheel == 0 ? RIGHT_OF(s->wheels) : LEFT_OF(s->wheels);
    const float limit = bound(box, wheel, where);
    const float k = wheel == 0 ? -w->per_half_track : w->per_half_track;
    const float f = -(s->row1[0] * x->x1 + s->row1[1] * x->x2 + s->row1[2] * x->x3 + s->row1[3]);
    const value_t v = saved_value(s, true);
    const float u1 = limit + f;
    const state_t next = {x->x1 + u1, x->x2, x->x3 + k * f};
    z[wheel] = limit;
    z[1 - wheel] = limit + 2.0f * f;
    return within(w, box, 1 - wheel, z[1 - wheel]) &&
           pushes(where, w->rho1 * u1 + slope1(&v, &next),
                  TOLERANCE * w->rim_m * (w->rho1 + v.p.p11));
}

/* Both wheels at limits, which must hold both. */
static bool follow_none(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                        const state_t *x, const box_t *box, float z[2]) {
    const unsigned right = RIGHT_OF(s->wheels);
    const unsigned left = LEFT_OF(s->wheels);
    z[0] = bound(box, 0, right);
    z[1] = bound(box, 1, left);
    const input_t u = input_from_rims(w, z[0], z[1]);
    const value_t v = saved_value(s, true);
    const state_t next = {x->x1 + u.u1, x->x2, x->x3 + u.u2};
    const float g1 = w->rho1 * u.u1 + slope1(&v, &next);
    const float g2 = w->per_half_track * (w->rho2 * u.u2 + slope3(&v, &next));
    const float tolerance = TOLERANCE * w->rim_m * (w->rho1 + v.p.p11);
    return pushes(right, g1 + g2, tolerance) && pushes(left, g1 - g2, tolerance);
}

/* Where the wheels stand at the stage's minimum, with their travel in z. */
static inline unsigned follow(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                              const state_t *x, const box_t *box, float z[2]) {
    bool held;
    if (s->wheels == FREE) {
        held = follow_free(w, s, x, box, z);
    } else if (RIGHT_OF(s->wheels) == FREE || LEFT_OF(s->wheels) == FREE) {
        held = follow_one(w, s, x, box, z);
    } else {
        held = follow_none(w, s, x, box, z);
    }
    if (held) {
        z[0] = clip(z[0], box->low[0], box->high[0]);
        z[1] = clip(z[1], box->low[1], box->high[1]);
        return s->wheels;
    }
    const value_t v = saved_value(s, s < &w->stages[w->last_limited > 0 ? w->last_limited : 0]);
    return box_minimum(w, &v, x, box, z);
}

typedef struct {
    float cost;
    float move;  /* largest change of a rim's travel */
    int changed; /* last stage where the wheels stand otherwise than assumed; -1 none */
} outcome_t;

static inline float stage_cost(const berth_constrained_t *w, const state_t *e, const input_t *u) {
    return (w->q[0] * e->x1 * e->x1 + w->q[1] * e->x2 * e->x2 + w->q[2] * e->x3 * e->x3) +
           (w->rho1 * u->u1 * u->u1 + w->rho2 * u->u2 * u->u2);
}

static outcome_t sweep_forward(berth_constrained_t *w, const state_t *error) {
    state_t e = *error;
    outcome_t outcome = {0.0f, 0.0f, -1};
    for (int i = 0; i < w->horizon; i++) {
        berth_constrained_stage_t *s = &w->stages[i];
        const box_t box = stage_box(w, s);
        const state_t x = drift(s, &e);
        float z[2];
        const unsigned wheels = follow(w, s, &x, &box, z);
        const input_t u = input_from_rims(w, z[0], z[1]);
        if (wheels != s->wheels) {
            outcome.changed = i;
        }
        s->found = (uint8_t)wheels;
        s->x[0] = x.x1;
        s->x[1] = x.x2;
        s->x[2] = x.x3;
        s->before[0] = s->u[0];
        s->before[1] = s->u[1];
        s->u[0] = u.u1;
        s->u[1] = u.u2;
        e = (state_t){x.x1 + u.u1, x.x2, x.x3 + u.u2};
        outcome.cost += stage_cost(w, &e, &u);
        outcome.move = maximum(outcome.move, fabsf(u.u1 - s->before[0]) +
                                                 w->half_track_m * fabsf(u.u2 - s->before[1]));
        if (i == 0) {
            w->expected[0] = e.x1;
            w->expected[1] = e.x2;
            w->expected[2] = e.x3;
            w->limited_now = wheels != FREE;
        }
    }
    return outcome;
}

/* The policy of the backward sweep, without regard to the box's other sides. */
static inline void aim(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                       const state_t *x, const box_t *box, float z[2]) {
    if (s->wheels == FREE) {
        (void)follow_free(w, s, x, box, z);
    } else if (RIGHT_OF(s->wheels) == FREE || LEFT_OF(s->wheels) == FREE) {
        (void)follow_one(w, s, x, box, z);
    } else {
        (void)follow_none(w, s, x, box, z);
    }
}

/* The forward sweep with a part of the step: from the iterate before. */
static outcome_t sweep_part(berth_constrained_t *w, const state_t *error, float part) {
    state_t e = *error;
    state_t e_before = *error;
    outcome_t outcome = {0.0f, 0.0f, w->horizon - 1};
    for (int i = 0; i < w->horizon; i++) {
        berth_constrained_stage_t *s = &w->stages[i];
        const box_t box = stage_box(w, s);
        const state_t x = drift(s, &e);
        const state_t x_before = drift(s, &e_before);
        const float half = w->half_track_m * s->before[1];
        const float z_before[2] = {s->before[0] + half, s->before[0] - half};
        float z[2];
        float aimed[2];
        aim(w, s, &x, &box, z);
        aim(w, s, &x_before, &box, aimed);
        for (int j = 0; j < 2; j++) {
            z[j] -= (1.0f - part) * (aimed[j] - z_before[j]);
            z[j] = clip(z[j], box.low[j], box.high[j]);
        }
        const input_t u = input_from_rims(w, z[0], z[1]);
        s->x[0] = x.x1;
        s->x[1] = x.x2;
        s->x[2] = x.x3;
        s->u[0] = u.u1;
        s->u[1] = u.u2;
        e = (state_t){x.x1 + u.u1, x.x2, x.x3 + u.u2};
        e_before = (state_t){x_before.x1 + s->before[0], x_before.x2, x_before.x3 + s->before[1]};
        outcome.cost += stage_cost(w, &e, &u);
        outcome.move = maximum(outcome.move, fabsf(u.u1 - s->before[0]) +
                                                 w->half_track_m * fabsf(u.u2 - s->before[1]));
    }
    return outcome;
}

/* Halves the step until the cost does not rise. False: it always does, and the iterate before is
 * back. */
static bool search_line(berth_constrained_t *w, const state_t *error, float before,
                        outcome_t *outcome) {
    for (float part = 0.5f; part >= PART_MIN; part *= 0.5f) {
        *outcome = sweep_part(w, error, part);
        if (outcome->cost <= (1.0f + COST_TOLERANCE) * before) {
            return true;
        }
    }
    *outcome = sweep_part(w, error, 0.0f);
    return false;
}

/* ---- One step ---- */

/* Passes until the optimum, or the last one allowed. */
static void iterate(berth_constrained_t *w, const state_t *error) {
    outcome_t now = sweep_forward(w, error);
    limits_t limits = LIMITS_MINIMISED;
    bool clean = false;
    while (now.changed >= 0) {
        if (w->passes >= w->passes_max) {
            w->stopped = true;
            return;
        }
        const float before = now.cost;
        sweep_again(w, now.changed, clean, limits);
        w->passes++;
        now = sweep_forward(w, error);
        limits = LIMITS_FOUND;
        clean = now.changed >= 0 && now.cost > (1.0f + COST_TOLERANCE) * before;
        if (clean) {
            limits = LIMITS_MINIMISED;
            if (!search_line(w, error, before, &now)) {
                w->stopped = true;
                return;
            }
        } else if (now.move <= MOVE_MIN_MPS * w->period_s) {
            return;
        }
    }
}

/* Takes the wheels that the reference itself asks too much of to be at their limits, with no others
 * known. Returns whether there are any. */
static bool guess_limits(berth_constrained_t *w) {
    for (int i = 0; i < w->horizon; i++) {
        berth_constrained_stage_t *s = &w->stages[i];
        const box_t box = stage_box(w, s);
        s->wheels = (uint8_t)(place(0.0f, box.low[0], box.high[0]) |
                              place(0.0f, box.low[1], box.high[1]) << 2);
        if (s->wheels != FREE) {
            w->last_limited = (int16_t)i;
        }
    }
    return w->last_limited >= 0;
}

/* Takes over the limits of the last step, one stage earlier, or starts with none. */
static void warm_up(berth_constrained_t *w, const berth_tracker_input_t *input) {
    const uint32_t total = input->reference->total;
    const berth_tracking_error_t *e = input->error;
    if (w->last_limited >= 0) {
        const bool near =
            w->warm && total - w->total == 1u && fabsf(e->e1_m - w->expected[0]) <= JUMP &&
            fabsf(e->e2_m - w->expected[1]) <= JUMP && fabsf(e->e3_rad - w->expected[2]) <= JUMP;
        const int last = w->last_limited;
        for (int i = 0; i <= last; i++) {
            const int from = i + 1 < w->horizon ? i + 1 : i;
            w->stages[i].wheels = near ? w->stages[from].wheels : FREE;
        }
        if (!near) {
            w->last_limited = -1;
        } else if (last + 1 < w->horizon) {
            w->last_limited = (int16_t)(last - 1);
        }
    }
    w->total = total;
    w->warm = true;
}

/* Box of the first stage, where the heading's error counts and the last command may. */
static void open_first_box(berth_constrained_t *w, const berth_tracker_input_t *input) {
    const float way = w->period_s * input->sample->v_mps * berth_cos_inline(input->error->e3_rad);
    const float turn = w->period_s * input->sample->omega_radps * w->half_track_m;
    const float last_way = w->period_s * input->last.v_mps;
    const float last_turn = w->period_s * input->last.omega_radps * w->half_track_m;
    for (int wheel = 0; wheel < 2; wheel++) {
        const float side = wheel == 0 ? 1.0f : -1.0f;
        const float base = way + side * turn;
        float low = -w->rim_m;
        float high = w->rim_m;
        if (w->rim_change_m > 0.0f) {
            const float last = last_way + side * last_turn;
            low = clip(last - w->rim_change_m, -w->rim_m, w->rim_m);
            high = clip(last + w->rim_change_m, -w->rim_m, w->rim_m);
        }
        w->low0[wheel] = base - high;
        w->high0[wheel] = base - low;
    }
    w->way0 = way;
}

static berth_twist_t limited_twist(berth_constrained_t *w, const berth_tracker_input_t *input) {
    input_t u = {w->stages[0].u[0], w->stages[0].u[1]};
    if (!(fabsf(u.u1) <= CHECK_FLOAT_MAX && fabsf(u.u2) <= CHECK_FLOAT_MAX)) {
        /* the numbers have left float32: the reference's own speeds, as far as the box allows */
        const float right = clip(0.0f, w->low0[0], w->high0[0]);
        const float left = clip(0.0f, w->low0[1], w->high0[1]);
        u = input_from_rims(w, right, left);
        berth_constrained_reset(w);
        w->stopped = true;
    }
    return (berth_twist_t){(w->way0 - u.u1) * w->frequency_hz,
                           input->sample->omega_radps - u.u2 * w->frequency_hz};
}

/* With no limit the command is the gain's: the table's, or the one that the sweep has found. */
static berth_twist_t free_twist(const berth_constrained_t *w, const berth_tracker_input_t *input,
                                const value_t *v) {
    if (input->gain != NULL) {
        return tracker_law_inline(input->sample, input->gain, input->error);
    }
    berth_gain_t gain;
    const riccati_a_t m = {1.0f, w->stages[0].turn, 0.0f, w->stages[0].way};
    riccati_gain_from_p(&v->p, &m, w->period_s, input->plan->mpc.r, gain.k);
    return tracker_law_inline(input->sample, &gain, input->error);
}

berth_twist_t berth_constrained_step(berth_constrained_t *workspace,
                                     const berth_tracker_input_t *input) {
    berth_constrained_t *w = workspace;
    const state_t error = {input->error->e1_m, input->error->e2_m, input->error->e3_rad};
    value_t v;
    warm_up(w, input);
    open_first_box(w, input);
    w->passes = 1;
    w->stopped = false;
    w->limited_now = false;
    sweep_first(w, input->plan, input->reference->index, &v);
    if (w->last_limited < 0) {
        if (is_free(w, &error)) {
            w->limited = false;
            return free_twist(w, input, &v);
        }
        if (guess_limits(w)) {
            sweep_again(w, w->last_limited, true, LIMITS_GIVEN);
        }
    }
    iterate(w, &error);
    w->limited = true;
    return limited_twist(w, input);
}

void berth_constrained_reset(berth_constrained_t *workspace) {
    workspace->warm = false;
}

berth_error_t berth_constrained_init(berth_constrained_t *workspace, const berth_plan_t *plan,
                                     const berth_limits_config_t *limits, float rim_change_max_mps2,
                                     berth_refusal_t *refusal) {
    berth_constrained_t *w = workspace;
    if (!check_value(BERTH_FIELD_PLAN_HORIZON, (float)plan->mpc.horizon, 1.0f,
                     (float)BERTH_CONSTRAINED_HORIZON_MAX, refusal) ||
        !check_value(BERTH_FIELD_PLAN_DISCRETIZATION, (float)plan->mpc.discretization,
                     (float)BERTH_DISCRETIZATION_EULER, (float)BERTH_DISCRETIZATION_EULER,
                     refusal)) {
        return BERTH_ERROR_PLAN;
    }
    if (rim_change_max_mps2 != 0.0f &&
        !check_value(BERTH_FIELD_RIM_CHANGE_MAX, rim_change_max_mps2, 0.001f, 10000.0f, refusal)) {
        return BERTH_ERROR_CONFIG;
    }
    const float period = (float)plan->period_us / 1000000.0f;
    const float frequency = 1.0f / period;
    const float wheels = limits->wheel_radius_m * limits->wheel_speed_max_radps;
    float rim = limits->v_max_mps + 0.5f * limits->track_m * limits->omega_max_radps;
    if (wheels > 0.0f) {
        rim = minimum(rim, wheels);
    }
    w->period_s = period;
    w->frequency_hz = frequency;
    w->rho1 = plan->mpc.r[0] * frequency * frequency;
    w->rho2 = plan->mpc.r[1] * frequency * frequency;
    for (int j = 0; j < 3; j++) {
        w->q[j] = plan->mpc.q[j];
    }
    w->half_track_m = 0.5f * limits->track_m;
    w->per_half_track = 1.0f / w->half_track_m;
    w->rim_m = rim * period * (1.0f - RIM_MARGIN);
    w->horizon = plan->mpc.horizon;
    w->passes_max = BERTH_CONSTRAINED_PASSES_MAX;
    w->rim_change_m = rim_change_max_mps2 * period * period;
    w->warm = false;
    w->last_limited = -1;
    for (int i = 0; i < w->horizon; i++) {
        w->stages[i].wheels = FREE;
    }
    return BERTH_OK;
}

berth_tracker_t berth_constrained_tracker(berth_constrained_t *workspace) {
    static const berth_tracker_api_t api = {berth_constrained_init, berth_constrained_reset,
                                            berth_constrained_step};
    return (berth_tracker_t){&api, workspace, 0.0f};
}
