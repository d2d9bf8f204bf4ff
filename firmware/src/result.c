#include "berth/result.h"

static const char *const error_texts[] = {
    "ok",
    "a required pointer is missing",
    "configuration value out of range",
    "plan value out of range",
    "obstacle regions too narrow for the clearance condition",
    "too many obstacles",
    "pose not finite or too far out",
    "time went backwards or is out of range",
    "controller not ready or not started",
};

static const char *const field_texts[] = {
    "nothing",
    "plan sample count",
    "plan period (us)",
    "plan horizon (periods)",
    "plan discretization",
    "weight q",
    "weight r",
    "plan gain source",
    "sample x (m)",
    "sample y (m)",
    "sample theta (rad)",
    "sample v (m/s)",
    "sample omega (rad/s)",
    "gain",
    "wheel radius (m)",
    "track width (m)",
    "v_max (m/s)",
    "omega_max (rad/s)",
    "wheel speed max (rad/s)",
    "a_max (m/s2)",
    "alpha_max (rad/s2)",
    "skirt (m)",
    "v_creep (m/s)",
    "tau (s)",
    "a_brake (m/s2)",
    "sigma_pose (m)",
    "omega_max T (rad)",
    "obstacle x (m)",
    "obstacle y (m)",
    "obstacle hard radius (m)",
    "obstacle conservative radius (m)",
    "obstacle regulated radius (m)",
    "obstacle clearance C - R (m)",
    "drive node",
    "drive sign",
    "gear ratio",
    "pole pairs",
    "drive mode",
    "master node",
    "counts per turn",
    "velocity units per turn/s",
    "feedback timeout (us)",
    "heartbeat timeout (us)",
    "enable timeout (us)",
    "pose fix gain",
    "pose fix jump (m)",
    "pose fix jump (rad)",
    "pose fix timeout (us)",
    "period late limit (us)",
    "transmit timeout (us)",
    "arm timeout (us)",
    "stop timeout (us)",
    "standing speed (rad/s)",
    "following error (rad/s)",
    "following time (us)",
    "bus obstacle body (m)",
    "bus obstacle C - R (m)",
    "bus obstacle G - C (m)",
    "rim change max (m/s2)",
};

/* A text is looked up by its number: one missing would shift the rest. */
_Static_assert(sizeof error_texts / sizeof error_texts[0] == (size_t)-BERTH_ERROR_STATE + 1u,
               "one text for each error");
_Static_assert(sizeof field_texts / sizeof field_texts[0] == (size_t)BERTH_FIELD_COUNT,
               "one text for each field");

const char *berth_error_text(berth_error_t error) {
    if (error > BERTH_OK || error < BERTH_ERROR_STATE) {
        return "unknown error";
    }
    return error_texts[-(int)error];
}

const char *berth_field_text(berth_field_t field) {
    const unsigned number = (unsigned)field;
    return number < (unsigned)BERTH_FIELD_COUNT ? field_texts[number] : "unknown field";
}
