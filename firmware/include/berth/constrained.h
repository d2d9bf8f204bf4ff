/* berth/constrained.h - the tracking problem with the wheels' limits in its optimum.
 *
 * The gain of tracker.h knows no limits; a command clipped afterwards is not the best one that the
 * wheels can do. This tracker minimises the same cost over the same horizon,
 *
 *     sum_{i=1..N} e_i' Q e_i + sum_{i=0..N-1} u_i' R u_i,   e_{i+1} = A_i e_i + B u_i,
 *
 * under |v_i + omega_i b/2| <= w and |v_i - omega_i b/2| <= w in every stage i: a box for the pair
 * z_i = (u1 + u2 b/2, u1 - u2 b/2). The rim speed w is the wheels' (wheel radius times wheel speed
 * limit), or what v_max and omega_max together ask of a rim where that is less. v_max and omega_max
 * themselves are not in the optimum; limits.h applies them afterwards.
 *
 * Use: hand a workspace to the controller,
 *
 *     static berth_constrained_t workspace;
 *     config.tracker = berth_constrained_tracker(&workspace);
 *
 * and all else is as with the gain. A program that does not do so does not link this module.
 *
 * Method: Riccati passes under control limits, after Tassa, Mansard & Todorov, "Control-limited
 * differential dynamic programming" (ICRA 2014). A pass has two sweeps. Backwards, the cost to go
 * of each stage is made under the assumption of which wheels stand at which limit, and inputs that
 * do not are affine in the state. Forwards, the exact minimum of each stage's two-variable
 * quadratic in its box is followed from the measured error. When each stage's wheels are at the
 * limits that were assumed, the pass has found the optimum, for these are the conditions of
 * optimality of a convex problem. Otherwise the next pass redoes the backward sweep from the last
 * stage that differs; the stages behind it are as they were. It takes the wheels to be where the
 * forward sweep found them; where that raises the cost, the iterate is taken back and the next pass
 * minimises each stage in its box at the iterate's states, with the step halved until the cost does
 * not rise. So every iterate is feasible and costs no more than the one before it.
 *
 * Where no limit acts, one backward sweep shows it, and the command is the gain's, to the bit: the
 * cost to go bounds the effort of all inputs together, and where that bound leaves the rims room
 * above the plan's own speeds not even a roll-out is needed.
 *
 * Not every problem is done in 8 passes. Of 10,500 random ones from a cold start, with N = 1 to 40
 * and limits of all kinds, one in 200 is not (four in five of these have N = 40, the others 20),
 * and the first input of half of them is off by more than 1e-4 m/s; of the steps of laps with
 * kicks, all were.
 *
 * After a step whose wheels met limits, the next one begins with the same limits one stage earlier
 * (a warm start), unless the pose or the plan has jumped. The optimum is unique: the warm start
 * changes the number of passes, and the result by rounding at most.
 */
#ifndef BERTH_CONSTRAINED_H
#define BERTH_CONSTRAINED_H

#include "berth/limits.h"
#include "berth/reference.h"
#include "berth/result.h"
#include "berth/types.h"

/* MISRA T1 in this file. */

#ifdef __cplusplus
extern "C" {
#endif

/* Longest horizon that a workspace has room for. */
#ifndef BERTH_CONSTRAINED_HORIZON_MAX
#define BERTH_CONSTRAINED_HORIZON_MAX 40
#endif

/* Most passes of a step. One that needs more gets the last iterate, and says so. */
#define BERTH_CONSTRAINED_PASSES_MAX 8

/* What a pass knows of one stage. Private; 108 bytes. In the inputs T is a factor. */
typedef struct {
    float p[6];      /* cost to go after the stage: p11 p12 p13 p22 p23 p33 */
    float linear[3]; /* its linear part */
    float row1[4];   /* policy: u1 or the free wheel's share, affine in A e */
    float row2[4];   /* policy: u2 */
    float x[3];      /* A e of the iterate */
    float u[2];      /* the iterate */
    float before[2]; /* the iterate before it */
    float turn;      /* omega_r T */
    float way;       /* v_r T */
    uint8_t wheels;  /* limits that the wheels are taken to be at */
    uint8_t found;   /* and those where the forward sweep found them */
} berth_constrained_stage_t;

/* Workspace: 108 bytes a stage and at most 128 more, 4,420 in all with the default capacity. Its
 * contents are private but for the last four members. */
typedef struct {
    berth_constrained_stage_t stages[BERTH_CONSTRAINED_HORIZON_MAX];
    float rho1, rho2, rho_one; /* r / T^2, and what they are for one wheel alone */
    float period_s, frequency_hz;
    float q[3];
    float half_track_m, per_half_track;
    float rim_m;        /* w T */
    float rim_change_m; /* what a rim's speed may change in a period, times T; 0: no such limit */
    float reserve2;     /* cost to go that cannot bring a wheel to its limit; 0: unknown */
    float way0;         /* v_r cos(e3) T of the first stage */
    float centre0[2], radius0[2]; /* box of the first stage */
    float expected[3];            /* next error, if the command is obeyed */
    uint32_t total;               /* of the reference, in the last step */
    uint16_t horizon;
    int16_t last_limited; /* last stage with a wheel at a limit; -1 none */
    bool warm;            /* the last step's limits may be taken over */
    uint8_t passes_max;   /* BERTH_CONSTRAINED_PASSES_MAX; tests stop earlier */
    /* Of the last step: */
    uint8_t passes;   /* backward sweeps */
    bool stopped;     /* the last pass was not the optimum yet */
    bool limited;     /* a wheel is at its limit in some stage */
    bool limited_now; /* and in the first one */
} berth_constrained_t;

/* What the tracker is given in each step. */
typedef struct {
    const berth_plan_t *plan;
    const berth_reference_t *reference;
    const berth_sample_t *sample; /* the current one */
    const berth_gain_t *gain;     /* its gain, or NULL where the plan has no table */
    const berth_tracking_error_t *error;
    berth_twist_t last; /* command of the period before */
} berth_tracker_input_t;

/* A tracker that replaces the gain, as the controller sees it: all zero is the gain itself. */
typedef struct {
    /* Checks plan and limits, and prepares the workspace for them. Returns BERTH_OK, or
     * BERTH_ERROR_CONFIG or BERTH_ERROR_PLAN with *refusal filled. */
    berth_error_t (*init)(berth_constrained_t *workspace, const berth_plan_t *plan,
                          const berth_limits_config_t *limits, float rim_change_max_mps2,
                          berth_refusal_t *refusal);
    /* Forgets the last step. */
    void (*reset)(berth_constrained_t *workspace);
    berth_twist_t (*step)(berth_constrained_t *workspace, const berth_tracker_input_t *input);
} berth_tracker_api_t;

typedef struct {
    const berth_tracker_api_t *api; /* NULL: the gain */
    berth_constrained_t *workspace; /* must outlive the controller's use */
    /* Largest change of a rim's speed per second, 0 (none) or 0.001 to 10000 m/s2: a box around
     * the last command in the first stage of the horizon, and there alone. */
    float rim_change_max_mps2;
} berth_tracker_t;

/* The constrained tracker with its workspace, and no limit on the rims' change. */
berth_tracker_t berth_constrained_tracker(berth_constrained_t *workspace);

/* The same functions for use without a controller. The limits must have passed berth_limits_check
 * and the plan berth_plan_check. Refused: a horizon above BERTH_CONSTRAINED_HORIZON_MAX, and the
 * zero-order hold (BERTH_ERROR_PLAN with the field; the method is specialised to the Euler form).
 * Cost: constant. */
BERTH_MUST_USE berth_error_t berth_constrained_init(berth_constrained_t *workspace,
                                                    const berth_plan_t *plan,
                                                    const berth_limits_config_t *limits,
                                                    float rim_change_max_mps2,
                                                    berth_refusal_t *refusal);

/* Forgets the last step; the next one starts cold. */
void berth_constrained_reset(berth_constrained_t *workspace);

/* The command of one period. Every finite input gives a finite command within the rims' limits
 * whenever a limit acts, and the gain's own command when none does; where the numbers leave
 * float32 on the way, the gain's command brought into the box, with `stopped` set.
 * Cost: about 130 instructions a stage while no limit acts, at most 8 passes of some 300 a stage.
 */
/*@ requires checked: 1 <= input->plan->count <= BERTH_PLAN_COUNT_MAX; */
berth_twist_t berth_constrained_step(berth_constrained_t *workspace,
                                     const berth_tracker_input_t *input);

#ifdef __cplusplus
}
#endif

#endif
