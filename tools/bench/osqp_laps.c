/* The problems of the constrained tracker's laps, solved by OSQP's generated code at the same
 * states.
 *
 * osqp_problem.h, written with the solver by tools/lib/osqp_problem.py, says where the numbers that
 * change from step to step are in it. OSQP starts each step from its last solution.
 *
 * Prints one line a step: "step INSTRUCTIONS ITERATIONS LIMITED", and one a case: "case NAME SHAPE
 * HORIZON SEED residual difference": the worst residual of the optimality conditions, and the
 * largest difference of the first command from Berth's, m/s at a rim.
 */
#include "laps.h"
#include "osqp.h"
#include "osqp_problem.h"
#include "workspace.h"

#include <math.h>
#include <stdio.h>

#define HALF_M (LAPS_TRACK_M / 2.0f)

static berth_constrained_t workspace;

/* Updates matrix and bounds, and solves. Returns false when OSQP refuses. */
static bool solve(const berth_tracker_input_t *input, float rim_mps) {
    static OSQPFloat turning[3 * N];
    static OSQPFloat low[ROWS];
    static OSQPFloat high[ROWS];
    const berth_plan_t *plan = input->plan;
    const float period_s = LAPS_PERIOD_US / 1.0e6f;
    const berth_tracking_error_t *e = input->error;
    for (uint32_t i = 0; i < N; i++) {
        const berth_sample_t *s = &plan->samples[(input->reference->index + i) % plan->count];
        const float turn = period_s * s->omega_radps;
        const float way = period_s * s->v_mps;
        const float v = i == 0 ? s->v_mps * cosf(e->e3_rad) : s->v_mps;
        const float right = v + HALF_M * s->omega_radps;
        const float left = v - HALF_M * s->omega_radps;
        if (i == 0) {
            low[0] = e->e1_m + turn * e->e2_m;
            low[1] = e->e2_m - turn * e->e1_m + way * e->e3_rad;
            low[2] = e->e3_rad;
        } else {
            turning[3 * i - 3] = -turn;
            turning[3 * i - 2] = turn;
            turning[3 * i - 1] = -way;
            low[3 * i] = low[3 * i + 1] = low[3 * i + 2] = 0.0f;
        }
        for (uint32_t j = 0; j < 3; j++) {
            high[3 * i + j] = low[3 * i + j];
        }
        low[3 * N + 2 * i] = right - rim_mps;
        high[3 * N + 2 * i] = right + rim_mps;
        low[3 * N + 2 * i + 1] = left - rim_mps;
        high[3 * N + 2 * i + 1] = left + rim_mps;
    }
    return osqp_update_data_mat(&solver, NULL, NULL, 0, turning, turning_index, 3 * (N - 1)) == 0 &&
           osqp_update_data_vec(&solver, NULL, low, high) == 0 && osqp_solve(&solver) == 0;
}

typedef struct {
    double residual, difference;
} outcome_t;

/* What OSQP found, against the conditions and against the tracker's command. */
static void compare(const berth_tracker_input_t *input, float rim_mps, berth_twist_t command,
                    outcome_t *outcome) {
    double u[2 * N];
    for (int i = 0; i < 2 * N; i++) {
        u[i] = (double)solver.solution->x[3 * N + i];
    }
    const double v = (double)input->sample->v_mps * cos((double)input->error->e3_rad) - u[0];
    const double omega = (double)input->sample->omega_radps - u[1];
    const double away = fabs(v - (double)command.v_mps) +
                        (double)HALF_M * fabs(omega - (double)command.omega_radps);
    outcome->residual = fmax(outcome->residual, laps_residual(input, rim_mps, u));
    outcome->difference = fmax(outcome->difference, away);
}

static int run(const laps_case_t *chosen, outcome_t *outcome) {
    const berth_plan_t *plan = laps_plan(chosen);
    const berth_limits_config_t limits = laps_limits();
    berth_refusal_t refusal;
    berth_limits_t memory;
    laps_robot_t robot = laps_start(chosen);
    berth_limits_reset(&memory);
    if (berth_constrained_init(&workspace, plan, &limits, 0.0f, &refusal) != BERTH_OK) {
        return 1;
    }
    const float rim = workspace.rim_m * workspace.frequency_hz;
    for (uint32_t k = 0; k < plan->count * (uint32_t)chosen->laps; k++) {
        laps_kick(&robot, chosen, (int)k);
        const berth_reference_t reference = {.index = k % plan->count, .total = k};
        const berth_sample_t sample = berth_plan_sample(plan, reference.index);
        const berth_tracking_error_t error = laps_error(&robot, &sample);
        const berth_tracker_input_t input = {plan, &reference, &sample, NULL, &error, memory.last};
        berth_twist_t command = berth_constrained_step(&workspace, &input);
        const uint32_t mark = laps_mark();
        if (!solve(&input, rim)) {
            return 1;
        }
        const uint32_t spent = laps_since(mark);
        printf("step %u %d %d\n", (unsigned)spent, (int)solver.info->iter, workspace.limited);
        compare(&input, rim, command, outcome);
        (void)berth_limits_apply(&memory, &limits, 0.05f, false, &command);
        laps_move(&robot, command);
    }
    return 0;
}

int main(void) {
    laps_open();
    for (int i = 0; i < LAPS_CASES; i++) {
        laps_case_t chosen = laps_cases[i];
        outcome_t outcome = {0.0, 0.0};
        chosen.horizon = N;
        if (run(&chosen, &outcome) != 0) {
            printf("failed\n");
            return 1;
        }
        printf("case %s %s %d %u %.9g %.9g\n", chosen.kind, laps_shape_name(chosen.shape), N,
               (unsigned)chosen.seed, outcome.residual, outcome.difference);
    }
    return 0;
}
