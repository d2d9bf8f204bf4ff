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

/* MISRA D9, T1, T3 in this file. */

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

/* Keeps rounding out of the bound that shows a plan's wheels free. */
#define RESERVE_PART 0.999f

/* Relative rise of the cost that is rounding. */
#define COST_TOLERANCE 1.0e-6f

/* How often a step is halved at most. */
#define HALVINGS 5

/* A pose this far from where the last step expected it has jumped, m and rad. */
#define JUMP 0.1f

/* Cost to go: e' P e + 2 l' e. */
typedef struct {
    riccati_p_t p;
    float l1, l2, l3;
} value_t;

/* Where z may be, right wheel and left wheel: centre +- radius. */
typedef struct {
    float centre[2], radius[2];
} box_t;

typedef struct {
    float x1, x2, x3;
} state_t;

typedef struct {
    float u1, u2;
} input_t;

/* ---- Small pieces ---- */

static inline float bound(const box_t *box, int wheel, unsigned where) {
    return where == LOW ? box->centre[wheel] - box->radius[wheel]
                        : box->centre[wheel] + box->radius[wheel];
}

/* Curvatures are positive; rounding makes them 0 at worst, where weights are too far apart. */
static inline float reciprocal(float curvature) {
    return curvature != 0.0f ? 1.0f / curvature : 0.0f;
}

static inline unsigned place(const box_t *box, int wheel, float z) {
    const float off = z - box->centre[wheel];
    if (off < -box->radius[wheel]) {
        return LOW;
    }
    return off > box->radius[wheel] ? HIGH : FREE;
}

static inline float clip(float z, float low, float high) {
    return minimum(maximum(z, low), high);
}

static inline float clip_to(const box_t *box, int wheel, float z) {
    return clip(z, bound(box, wheel, LOW), bound(box, wheel, HIGH));
}

static inline box_t stage_box(const berth_constrained_t *w, const berth_constrained_stage_t *s) {
    if (s == &w->stages[0]) {
        return (box_t){{w->centre0[0], w->centre0[1]}, {w->radius0[0], w->radius0[1]}};
    }
    const float turn = w->half_track_m * s->turn;
    return (box_t){{s->way + turn, s->way - turn}, {w->rim_m, w->rim_m}};
}

static inline input_t input_from_rims(const berth_constrained_t *w, float right, float left) {
    return (input_t){0.5f * (right + left), 0.5f * w->per_half_track * (right - left)};
}

static inline void save_value(berth_constrained_stage_t *s, const riccati_p_t *p) {
    s->p[0] = p->p11;
    s->p[1] = p->p12;
    s->p[2] = p->p13;
    s->p[3] = p->p22;
    s->p[4] = p->p23;
    s->p[5] = p->p33;
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
    const unsigned right = place(box, 0, q.z[0]);
    const unsigned left = place(box, 1, q.z[1]);
    z[0] = q.z[0];
    z[1] = q.z[1];
    if (right != FREE) {
        z[0] = bound(box, 0, right);
        const float other = q.z[1] - q.h12 * reciprocal(q.h22) * (z[0] - q.z[0]);
        const unsigned where = place(box, 1, other);
        z[1] = where == FREE ? other : bound(box, 1, where);
        const float slope = q.h11 * (z[0] - q.z[0]) + q.h12 * (z[1] - q.z[1]);
        if (left == FREE || (right == HIGH ? slope <= 0.0f : slope >= 0.0f)) {
            return right | (where << 2);
        }
    }
    if (left != FREE) {
        z[1] = bound(box, 1, left);
        const float other = q.z[0] - q.h12 * reciprocal(q.h11) * (z[1] - q.z[1]);
        const unsigned where = place(box, 0, other);
        z[0] = where == FREE ? other : bound(box, 0, where);
        return where | (left << 2);
    }
    return FREE;
}

/* ---- Backwards ---- */

/* Both wheels free, nothing limited behind: no linear part. Where numbers are beyond float32,
 * rounding can make curvatures negative; as sizes they never add to 0 with the weight. */
static inline void eliminate_free(berth_constrained_stage_t *s, riccati_p_t *p, float rho1,
                                  float rho2) {
    p->p11 = fabsf(p->p11);
    (void)riccati_eliminate_u1(p, rho1, s->row1);
    p->p33 = fabsf(p->p33);
    (void)riccati_eliminate_u2(p, rho2, s->row2);
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
    const float inverse = 1.0f / (w->rho_one + maximum(g1 + k * g3, 0.0f));
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
static void eliminate_none(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                           value_t *v, const box_t *box) {
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
    for (;;) {
        berth_constrained_stage_t *s = &w->stages[i];
        const box_t box = stage_box(w, s);
        save_value(s, &v->p);
        save_linear(s, v);
        if (limits == LIMITS_FOUND) {
            s->wheels = s->found;
        } else if (limits == LIMITS_MINIMISED) {
            const state_t x = {s->x[0], s->x[1], s->x[2]};
            float z[2];
            s->wheels = (uint8_t)box_minimum(w, v, &x, &box, z);
        } else {
            /* as given */
        }
        if (s->wheels != FREE && i > w->last_limited) {
            w->last_limited = (int16_t)i;
        }
        eliminate(w, s, v, &box);
        if (i == 0) {
            return;
        }
        propagate(w, s, v);
        i--;
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

/* Reads the plan from its end, one stage after the other. */
typedef struct {
    const berth_sample_t *sample; /* of the next stage inside the plan */
    const berth_sample_t *first;
    const berth_sample_t *last; /* comes before the first in a closed plan */
    int outside;                /* stages from here on lie beyond an open plan's end */
    float period_s;
} reader_t;

static reader_t open_reader(const berth_constrained_t *w, const berth_plan_t *plan,
                            uint32_t index) {
    const uint32_t k = riccati_last_stage(plan, index);
    const uint32_t last = plan->count - 1u;
    const uint32_t left = index < plan->count ? plan->count - index : 0u;
    const bool ends = !plan->closed && left < w->horizon;
    return (reader_t){.sample = &plan->samples[k < last ? k : last],
                      .first = plan->samples,
                      .last = &plan->samples[last],
                      .outside = ends ? (int)left : w->horizon,
                      .period_s = w->period_s};
}

static inline void read_stage(reader_t *reader, berth_constrained_stage_t *s, int i) {
    float turn = 0.0f;
    float way = 0.0f;
    if (i < reader->outside) {
        const berth_sample_t *sample = reader->sample;
        turn = reader->period_s * sample->omega_radps;
        way = reader->period_s * sample->v_mps;
        /* MISRA D11 */
        reader->sample = sample == reader->first ? reader->last : sample - 1;
    }
    s->turn = turn;
    s->way = way;
}

/* The first backward sweep of a step, which also reads the plan. Behind the last stage that is
 * limited there is no linear part. */
static void sweep_first(berth_constrained_t *w, const berth_plan_t *plan, uint32_t index,
                        value_t *value) {
    reader_t reader = open_reader(w, plan, index);
    const float q[3] = {w->q[0], w->q[1], w->q[2]};
    const float rho1 = w->rho1;
    const float rho2 = w->rho2;
    const int stop = w->last_limited;
    riccati_p_t p = {q[0], 0.0f, 0.0f, q[1], 0.0f, q[2]};
    int i = w->horizon - 1;
    for (; i > stop; i--) {
        berth_constrained_stage_t *s = &w->stages[i];
        read_stage(&reader, s, i);
        save_value(s, &p);
        eliminate_free(s, &p, rho1, rho2);
        if (i == 0) {
            *value = (value_t){p, 0.0f, 0.0f, 0.0f};
            return;
        }
        riccati_propagate_euler(&p, s->turn, s->way, q);
    }
    for (int j = i; j >= 0; j--) {
        read_stage(&reader, &w->stages[j], j);
    }
    *value = (value_t){p, 0.0f, 0.0f, 0.0f};
    sweep_limited(w, i, value, LIMITS_GIVEN);
}

/* ---- Forwards ---- */

/* The policy of a stage with both wheels free and nothing limited behind: u2, then u1 of the state
 * that u2 has moved. Moves x to the next state. */
static inline input_t follow_plain(const berth_constrained_stage_t *s, state_t *x) {
    const float u2 = s->row2[0] * x->x1 + s->row2[1] * x->x2 + s->row2[2] * x->x3;
    x->x3 -= u2;
    const float u1 = s->row1[0] * x->x1 + s->row1[1] * x->x2 + s->row1[2] * x->x3;
    x->x1 -= u1;
    return (input_t){-u1, -u2};
}

/* e' P e. */
static inline float size(const riccati_p_t *p, const state_t *e) {
    return e->x1 * (p->p11 * e->x1 + 2.0f * (p->p12 * e->x2 + p->p13 * e->x3)) +
           (e->x2 * (p->p22 * e->x2 + 2.0f * p->p23 * e->x3) + p->p33 * e->x3 * e->x3);
}

/* Whether the optimum without limits, whose cost to go before the first input is p, needs none. The
 * effort of all inputs together is at most that cost, which bounds what they can add to the rims'
 * speeds of the reference. Otherwise the roll-out decides. */
static bool is_free(const berth_constrained_t *w, const riccati_p_t *p, const state_t *error) {
    const float half = w->half_track_m;
    const float rim = w->rim_m;
    const berth_constrained_stage_t *s = w->stages;
    state_t e = drift(s, error);
    if (w->rim_change_m == 0.0f && w->reserve2 > 0.0f && size(p, &e) <= w->reserve2) {
        return true;
    }
    input_t u = follow_plain(s, &e);
    if (!(fabsf(w->centre0[0] - (u.u1 + half * u.u2)) <= w->radius0[0] &&
          fabsf(w->centre0[1] - (u.u1 - half * u.u2)) <= w->radius0[1])) {
        return false;
    }
    const berth_constrained_stage_t *end = &s[w->horizon];
    for (s = &s[1]; s < end; s++) {
        e = drift(s, &e);
        u = follow_plain(s, &e);
        if (!(fabsf(s->way - u.u1) + half * fabsf(s->turn - u.u2) <= rim)) {
            return false;
        }
    }
    return true;
}

/* How far a wheel's travel is within its box; negative: outside. */
static inline float room(const box_t *box, int wheel, float z) {
    return box->radius[wheel] - fabsf(z - box->centre[wheel]);
}

static inline bool is_affine(const berth_constrained_t *w, const berth_constrained_stage_t *s) {
    return s - w->stages < w->last_limited; /* MISRA D11 */
}

/* The policy of the backward sweep, whatever the box says to it. */
static inline input_t aim_free(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                               const state_t *x) {
    state_t next = *x;
    if (!is_affine(w, s)) {
        return follow_plain(s, &next);
    }
    const float u2 = s->row2[0] * x->x1 + s->row2[1] * x->x2 + s->row2[2] * x->x3 + s->row2[3];
    const float x3 = x->x3 - u2;
    const float u1 = s->row1[0] * x->x1 + s->row1[1] * x->x2 + s->row1[2] * x3 + s->row1[3];
    return (input_t){-u1, -u2};
}

static inline float aim_one(const berth_constrained_stage_t *s, const state_t *x) {
    return -(s->row1[0] * x->x1 + s->row1[1] * x->x2 + s->row1[2] * x->x3 + s->row1[3]);
}

/* Each returns whether the box agrees with what the backward sweep took the wheels to be at:
 * clearly, or up to rounding (nearly), when the input may need clipping. */
typedef enum { DISAGREES, NEARLY, AGREES } verdict_t;

static inline verdict_t judge(float least, float tolerance) {
    if (least >= 0.0f) {
        return AGREES;
    }
    return least >= -tolerance ? NEARLY : DISAGREES;
}

static inline verdict_t follow_free(const berth_constrained_t *w,
                                    const berth_constrained_stage_t *s, const state_t *x,
                                    const box_t *box, input_t *u) {
    *u = aim_free(w, s, x);
    const float turn = w->half_track_m * u->u2;
    return judge(minimum(room(box, 0, u->u1 + turn), room(box, 1, u->u1 - turn)),
                 TOLERANCE * w->rim_m);
}

/* One wheel at its limit: the other one follows its policy, and the limit must hold the first. */
static inline verdict_t follow_one(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                                   const state_t *x, const box_t *box, input_t *u) {
    const int wheel = RIGHT_OF(s->wheels) != FREE ? 0 : 1;
    const unsigned where = wheel == 0 ? RIGHT_OF(s->wheels) : LEFT_OF(s->wheels);
    const float limit = bound(box, wheel, where);
    const float f = aim_one(s, x);
    u->u1 = limit + f;
    u->u2 = wheel == 0 ? -w->per_half_track * f : w->per_half_track * f;
    const float slope = w->rho1 * u->u1 + (s->p[0] * (x->x1 + u->u1) + s->p[1] * x->x2 +
                                           s->p[2] * (x->x3 + u->u2) + s->linear[0]);
    const float push = where == HIGH ? -slope : slope;
    const float tolerance = TOLERANCE * w->rim_m;
    if (!(push >= -tolerance * (w->rho1 + s->p[0]))) {
        return DISAGREES;
    }
    return judge(room(box, 1 - wheel, limit + 2.0f * f), tolerance);
}

/* Both wheels at limits, which must hold both. */
static inline verdict_t follow_none(const berth_constrained_t *w,
                                    const berth_constrained_stage_t *s, const state_t *x,
                                    const box_t *box, input_t *u) {
    const unsigned right = RIGHT_OF(s->wheels);
    const unsigned left = LEFT_OF(s->wheels);
    *u = input_from_rims(w, bound(box, 0, right), bound(box, 1, left));
    const float x1 = x->x1 + u->u1;
    const float x3 = x->x3 + u->u2;
    const float g1 =
        w->rho1 * u->u1 + (s->p[0] * x1 + s->p[1] * x->x2 + s->p[2] * x3 + s->linear[0]);
    const float g2 =
        w->per_half_track *
        (w->rho2 * u->u2 + (s->p[2] * x1 + s->p[4] * x->x2 + s->p[5] * x3 + s->linear[2]));
    const float push_right = right == HIGH ? -(g1 + g2) : g1 + g2;
    const float push_left = left == HIGH ? g2 - g1 : g1 - g2;
    const float least = minimum(push_right, push_left);
    return least >= -TOLERANCE * w->rim_m * (w->rho1 + s->p[0]) ? AGREES : DISAGREES;
}

/* The input where the box disagrees, or nearly. Returns where the wheels stand. */
SMALL static unsigned correct(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                              const state_t *x, bool nearly, input_t *u) {
    const box_t box = stage_box(w, s);
    float z[2];
    unsigned wheels = s->wheels;
    if (nearly) {
        const float turn = w->half_track_m * u->u2;
        z[0] = clip_to(&box, 0, u->u1 + turn);
        z[1] = clip_to(&box, 1, u->u1 - turn);
    } else {
        const value_t v = saved_value(s, is_affine(w, s));
        wheels = box_minimum(w, &v, x, &box, z);
    }
    *u = input_from_rims(w, z[0], z[1]);
    return wheels;
}

/* The exact minimum of one stage. Returns where the wheels stand. */
static inline unsigned follow(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                              const state_t *x, input_t *u) {
    const box_t box = stage_box(w, s);
    verdict_t verdict;
    if (s->wheels == FREE) {
        verdict = follow_free(w, s, x, &box, u);
    } else if (RIGHT_OF(s->wheels) == FREE || LEFT_OF(s->wheels) == FREE) {
        verdict = follow_one(w, s, x, &box, u);
    } else {
        verdict = follow_none(w, s, x, &box, u);
    }
    return verdict == AGREES ? s->wheels : correct(w, s, x, verdict == NEARLY, u);
}

static inline void store(berth_constrained_stage_t *s, const state_t *x, const input_t *u) {
    s->x[0] = x->x1;
    s->x[1] = x->x2;
    s->x[2] = x->x3;
    s->before[0] = s->u[0];
    s->before[1] = s->u[1];
    s->u[0] = u->u1;
    s->u[1] = u->u2;
}

/* Stages from i on with nothing limited behind them, until one that meets a limit; returns it. */
static int forward_plain(berth_constrained_t *w, int i, state_t *state) {
    const float half = w->half_track_m;
    const float rim = w->rim_m;
    const int end = w->horizon;
    state_t e = *state;
    for (; i < end; i++) {
        berth_constrained_stage_t *s = &w->stages[i];
        const state_t x = drift(s, &e);
        state_t next = x;
        const input_t u = follow_plain(s, &next);
        if (!(fabsf(s->way - u.u1) + half * fabsf(s->turn - u.u2) <= rim)) {
            break;
        }
        store(s, &x, &u);
        s->found = FREE;
        e = next;
    }
    *state = e;
    return i;
}

/* Follows the policy in the box. Returns the last stage whose wheels stand otherwise than assumed;
 * -1: none, so that this is the optimum. */
static int sweep_forward(berth_constrained_t *w, const state_t *error) {
    const int end = w->horizon;
    state_t e = *error;
    int changed = -1;
    int i = 0;
    while (i < end) {
        if (i > w->last_limited && i > 0) {
            i = forward_plain(w, i, &e);
            if (i >= end) {
                break;
            }
        }
        berth_constrained_stage_t *s = &w->stages[i];
        const state_t x = drift(s, &e);
        input_t u;
        const unsigned wheels = follow(w, s, &x, &u);
        if (wheels != s->wheels) {
            changed = i;
        }
        s->found = (uint8_t)wheels;
        store(s, &x, &u);
        e = (state_t){x.x1 + u.u1, x.x2, x.x3 + u.u2};
        i++;
    }
    return changed;
}

/* Cost of the iterate, or of the one before it. */
SMALL static float cost_of(const berth_constrained_t *w, const state_t *error, bool before) {
    const berth_constrained_stage_t *end = &w->stages[w->horizon];
    state_t e = *error;
    float cost = 0.0f;
    for (const berth_constrained_stage_t *s = w->stages; s < end; s++) {
        const float u1 = before ? s->before[0] : s->u[0];
        const float u2 = before ? s->before[1] : s->u[1];
        e = drift(s, &e);
        e.x1 += u1;
        e.x3 += u2;
        cost += (w->rho1 * u1 * u1 + w->rho2 * u2 * u2) +
                (w->q[0] * e.x1 * e.x1 + w->q[1] * e.x2 * e.x2 + w->q[2] * e.x3 * e.x3);
    }
    return cost;
}

/* Travel of the rims that the policy asks for. */
static inline void aim(const berth_constrained_t *w, const berth_constrained_stage_t *s,
                       const state_t *x, const box_t *box, float z[2]) {
    const unsigned right = RIGHT_OF(s->wheels);
    const unsigned left = LEFT_OF(s->wheels);
    if (s->wheels == FREE) {
        const input_t u = aim_free(w, s, x);
        z[0] = u.u1 + w->half_track_m * u.u2;
        z[1] = u.u1 - w->half_track_m * u.u2;
        return;
    }
    const float f = right == FREE || left == FREE ? 2.0f * aim_one(s, x) : 0.0f;
    z[0] = right != FREE ? bound(box, 0, right) : bound(box, 1, left) + f;
    z[1] = left != FREE ? bound(box, 1, left) : z[0] + f;
}

/* The forward sweep with a part of the step, from the iterate before. Returns its cost. */
static float sweep_part(berth_constrained_t *w, const state_t *error, float part) {
    state_t e = *error;
    state_t e_before = *error;
    for (int i = 0; i < w->horizon; i++) {
        berth_constrained_stage_t *s = &w->stages[i];
        const box_t box = stage_box(w, s);
        const state_t x = drift(s, &e);
        const state_t x_before = drift(s, &e_before);
        const float turn = w->half_track_m * s->before[1];
        const float z_before[2] = {s->before[0] + turn, s->before[0] - turn};
        float z[2];
        float aimed[2];
        aim(w, s, &x, &box, z);
        aim(w, s, &x_before, &box, aimed);
        for (int j = 0; j < 2; j++) {
            z[j] = clip_to(&box, j, z[j] - (1.0f - part) * (aimed[j] - z_before[j]));
        }
        const input_t u = input_from_rims(w, z[0], z[1]);
        s->x[0] = x.x1;
        s->x[1] = x.x2;
        s->x[2] = x.x3;
        s->u[0] = u.u1;
        s->u[1] = u.u2;
        e = (state_t){x.x1 + u.u1, x.x2, x.x3 + u.u2};
        e_before = (state_t){x_before.x1 + s->before[0], x_before.x2, x_before.x3 + s->before[1]};
    }
    return cost_of(w, error, false);
}

/* Halves the step until the cost does not rise. False: it always does, and the iterate before is
 * back. */
static bool search_line(berth_constrained_t *w, const state_t *error, float limit, float *cost) {
    float part = 1.0f;
    for (int i = 0; i < HALVINGS; i++) {
        part *= 0.5f;
        *cost = sweep_part(w, error, part);
        if (*cost <= limit) {
            return true;
        }
    }
    *cost = sweep_part(w, error, 0.0f);
    return false;
}

/* ---- One step ---- */

/* Puts the iterate before in this one's place. */
static void revert(berth_constrained_t *w, const state_t *error) {
    state_t e = *error;
    for (int i = 0; i < w->horizon; i++) {
        berth_constrained_stage_t *s = &w->stages[i];
        const state_t x = drift(s, &e);
        const input_t u = {s->before[0], s->before[1]};
        store(s, &x, &u);
        e = (state_t){x.x1 + u.u1, x.x2, x.x3 + u.u2};
    }
}

enum { ALL = BERTH_CONSTRAINED_HORIZON_MAX };

/* One pass after the first: from the last stage that differs, or from the end where ALL do. Returns
 * like sweep_forward. */
static int pass_again(berth_constrained_t *w, const state_t *error, int changed, limits_t limits) {
    const int from = changed == ALL ? w->horizon - 1 : changed;
    sweep_again(w, from, changed == ALL, limits);
    w->passes++;
    return sweep_forward(w, error);
}

/* Passes until the optimum, or the last one allowed. The limits that a forward sweep found are good
 * guesses, and cheap; those that minimise give a direction in which the cost falls, so they follow
 * where a guess has raised it. The cost is not needed before a second pass has not ended it. */
static void iterate(berth_constrained_t *w, const state_t *error) {
    int changed = sweep_forward(w, error);
    limits_t limits = LIMITS_FOUND;
    float cost = -1.0f;
    while (changed >= 0) {
        if (w->passes >= w->passes_max) {
            w->stopped = true;
            return;
        }
        changed = pass_again(w, error, changed, limits);
        if (changed < 0) {
            return;
        }
        const float before = cost < 0.0f ? cost_of(w, error, true) : cost;
        const float limit = (1.0f + COST_TOLERANCE) * before;
        cost = cost_of(w, error, false);
        if (cost <= limit) {
            limits = LIMITS_FOUND;
        } else if (limits == LIMITS_FOUND) {
            revert(w, error);
            cost = before;
            changed = ALL;
            limits = LIMITS_MINIMISED;
        } else {
            changed = ALL;
            if (!search_line(w, error, limit, &cost)) {
                w->stopped = true;
                return;
            }
        }
    }
}

/* Takes the wheels that the reference itself asks too much of to be at their limits, with no others
 * known. */
static void guess_limits(berth_constrained_t *w) {
    for (int i = 0; i < w->horizon; i++) {
        berth_constrained_stage_t *s = &w->stages[i];
        const box_t box = stage_box(w, s);
        s->wheels = (uint8_t)(place(&box, 0, 0.0f) | place(&box, 1, 0.0f) << 2);
        if (s->wheels != FREE) {
            w->last_limited = (int16_t)i;
        }
    }
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
        } else {
            /* the last stage keeps what it met */
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
        w->centre0[wheel] = base;
        w->radius0[wheel] = w->rim_m;
        if (w->rim_change_m > 0.0f) {
            const float last = last_way + side * last_turn;
            const float low = clip(last - w->rim_change_m, -w->rim_m, w->rim_m);
            const float high = clip(last + w->rim_change_m, -w->rim_m, w->rim_m);
            w->centre0[wheel] = base - 0.5f * (low + high);
            w->radius0[wheel] = 0.5f * (high - low);
        }
    }
    w->way0 = way;
}

/* What the last forward sweep says of the first stage. */
static void expect(berth_constrained_t *w) {
    const berth_constrained_stage_t *s = &w->stages[0];
    w->expected[0] = s->x[0] + s->u[0];
    w->expected[1] = s->x[1];
    w->expected[2] = s->x[2] + s->u[1];
    w->limited_now = s->found != FREE;
}

static berth_twist_t limited_twist(berth_constrained_t *w, const berth_tracker_input_t *input) {
    input_t u = {w->stages[0].u[0], w->stages[0].u[1]};
    if (!(fabsf(u.u1) + fabsf(u.u2) <= CHECK_FLOAT_MAX)) {
        /* the numbers have left float32: the reference's own speeds, as far as the box allows */
        const box_t box = stage_box(w, &w->stages[0]);
        const float right = clip_to(&box, 0, 0.0f);
        const float left = clip_to(&box, 1, 0.0f);
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
        if (is_free(w, &v.p, &error)) {
            w->limited = false;
            return free_twist(w, input, &v);
        }
        guess_limits(w);
        if (w->last_limited >= 0) {
            sweep_again(w, w->last_limited, true, LIMITS_GIVEN);
        }
    }
    iterate(w, &error);
    expect(w);
    w->limited = true;
    return limited_twist(w, input);
}

void berth_constrained_reset(berth_constrained_t *workspace) {
    workspace->warm = false;
}

/* What the plan leaves of the rims' travel, as a bound on the cost to go: |u1| + |u2| b/2 is at
 * most the square root of that cost times (1/rho1 + (b/2)^2/rho2). */
static float reserve2(const berth_constrained_t *w, const berth_plan_t *plan) {
    float most = 0.0f;
    for (uint32_t k = 0; k < plan->count; k++) {
        const berth_sample_t *sample = &plan->samples[k];
        most = maximum(most, fabsf(sample->v_mps) + w->half_track_m * fabsf(sample->omega_radps));
    }
    const float reserve = RESERVE_PART * (w->rim_m - w->period_s * most);
    const float per_cost = 1.0f / w->rho1 + w->half_track_m * w->half_track_m / w->rho2;
    return reserve > 0.0f ? reserve * reserve / per_cost : 0.0f;
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
    w->rho_one = w->rho1 + w->per_half_track * w->per_half_track * w->rho2;
    w->rim_m = rim * period * (1.0f - RIM_MARGIN);
    w->horizon = plan->mpc.horizon;
    w->passes_max = BERTH_CONSTRAINED_PASSES_MAX;
    w->rim_change_m = rim_change_max_mps2 * period * period;
    w->reserve2 = reserve2(w, plan);
    w->warm = false;
    w->last_limited = -1;
    for (int i = 0; i < w->horizon; i++) {
        w->stages[i] = (berth_constrained_stage_t){.wheels = FREE};
    }
    return BERTH_OK;
}

berth_tracker_t berth_constrained_tracker(berth_constrained_t *workspace) {
    static const berth_tracker_api_t api = {berth_constrained_init, berth_constrained_reset,
                                            berth_constrained_step};
    return (berth_tracker_t){&api, workspace, 0.0f};
}
