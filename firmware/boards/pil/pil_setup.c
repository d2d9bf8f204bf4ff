#include "pil.h"

#include "pil_plan_circle.h"
#include "pil_plan_eight.h"

/* The robot of the built-in experiments, and what obstacles from the bus get. */
#define WHEEL_RADIUS_M 0.05f
#define TRACK_M 0.30f
#define V_MAX_MPS 0.8f
#define OMEGA_MAX_RADPS 3.0f
#define SKIRT_M 0.02f
#define V_CREEP_MPS 0.05f
#define BODY_M 0.05f
#define REGION_MARGIN_M 0.01f
#define REGION_REGULATED_M 0.2f

#define PATIENT_US 3000000
#define PATIENT_TRANSMIT_US 1000000

typedef struct {
    const berth_plan_t *plan;
    berth_obstacle_t obstacles[3];
} experiment_t;

static const experiment_t circle = {
    &pil_plan_circle,
    {
        {0.073f, 1.027f, 0.10f, 0.20f, 0.40f},
        {-0.947f, -0.250f, 0.10f, 0.20f, 0.40f},
        {0.492f, -0.928f, 0.10f, 0.20f, 0.40f},
    },
};

static const experiment_t eight = {
    &pil_plan_eight,
    {
        {1.706f, 0.821f, 0.10f, 0.18f, 0.38f},
        {1.025f, -1.077f, 0.12f, 0.20f, 0.40f},
        {-1.730f, -0.545f, 0.15f, 0.23f, 0.43f},
    },
};

static const experiment_t *experiment(const pil_options_t *options) {
    return options->eight ? &eight : &circle;
}

const berth_plan_t *pil_plan(const pil_options_t *options) {
    return experiment(options)->plan;
}

static void be_patient(berth_board_config_t *config) {
    for (int side = 0; side < 2; side++) {
        config->drives[side].feedback_timeout_us = PATIENT_US;
        config->drives[side].heartbeat_timeout_us = PATIENT_US;
    }
    config->supervisor.period_late_us = PATIENT_US;
    config->supervisor.transmit_timeout_us = PATIENT_TRANSMIT_US;
}

static bool make_config(const pil_options_t *options, uint32_t period_us,
                        berth_board_config_t *config) {
    *config = berth_board_config_default(WHEEL_RADIUS_M, TRACK_M, period_us);
    config->controller = (berth_config_t){
        .limits = {.wheel_radius_m = WHEEL_RADIUS_M,
                   .track_m = TRACK_M,
                   .v_max_mps = V_MAX_MPS,
                   .omega_max_radps = OMEGA_MAX_RADPS},
        .avoid = {.skirt_m = SKIRT_M, .v_creep_mps = V_CREEP_MPS, .paced = true},
    };
    for (uint8_t side = 0; side < 2; side++) {
        config->drives[side].protocol = &berth_drive_odrive;
        config->drives[side].node = (uint8_t)(1u + side);
    }
    if (options->patient) {
        be_patient(config);
    }
    berth_avoid_t avoid;
    berth_refusal_t refusal;
    const berth_error_t error = berth_avoid_init(&avoid, &config->controller.avoid,
                                                 &config->controller.limits, period_us, &refusal);
    config->regions = (berth_board_regions_t){
        .body_m = BODY_M,
        .conservative_m = avoid.clearance_min_m + REGION_MARGIN_M,
        .regulated_m = REGION_REGULATED_M,
    };
    return error == BERTH_OK;
}

bool pil_setup(berth_board_t *board, const pil_options_t *options, const berth_plan_t *plan,
               int64_t now_us) {
    berth_board_config_t config;
    berth_refusal_t refusal;
    if (!make_config(options, plan->period_us, &config) ||
        berth_board_init(board, plan, &config, now_us, &refusal) != BERTH_OK) {
        return false;
    }
    for (int i = 0; i < 3 && !options->announced; i++) {
        if (berth_board_add_obstacle(board, &experiment(options)->obstacles[i], &refusal) !=
            BERTH_OK) {
            return false;
        }
    }
    return true;
}
