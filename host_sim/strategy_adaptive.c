/* Adaptive tracking with a potential function, after Fukao, Nakagawa & Adachi ("Adaptive tracking
 * control of a nonholonomic mobile robot", IEEE Trans. Robotics and Automation 2000) with the
 * avoidance functions of Stipanovic et al. (2007) and Mastellone et al. (2008).
 *
 * Field. The position p is to follow f = pdot_r - kp e - ka sum grad V_i, e = p - p_r, with
 * V_i = (min(0, (d_i^2 - G_i^2) / (d_i^2 - R_i^2)))^2. The heading is steered to the direction of
 * f, theta_f, and with eta = theta_f - theta, h = (cos theta, sin theta) and n to the left of h,
 *
 *     v_d = f . h = |f| cos eta,    omega_d = theta_f' + kh eta.
 *
 * Wheels. The robot turns a command (v, omega) into (a v, g omega), where a = radius_scale and
 * g = radius_scale / track_scale are not known. With estimates p1 of 1 / a and p2 of 1 / g the
 * command is (p1 v_d, p2 omega_d), and with the errors q1 = 1 / a - p1, q2 = 1 / g - p2 the robot
 * does (v_d (1 - a q1), omega_d (1 - g q2)).
 *
 * Errors, without obstacles (f' depends on the robot's true speed, so theta_f' does too):
 *
 *     e'   = -kp e - |f| sin(eta) n - a q1 v_d h
 *     eta' = -kh eta + g q2 omega_d - kp a q1 v_d sin(eta) / |f|
 *
 * Lyapunov function. So that a large error at the start does not throw the estimates far off, both
 * errors count quadratically near 0 and linearly far away:
 *
 *     W  = de^2 (se - 1) + mu dh^2 (sh - 1) + a q1^2 / (2 gamma1) + g q2^2 / (2 gamma2),
 *     se = sqrt(1 + |e|^2 / de^2),    sh = sqrt(1 + 2 (1 - cos eta) / dh^2)
 *     W' = -kp |e|^2 / se - |f| sin(eta) (e . n) / se - mu kh g p2 eta sin(eta) / sh
 *          - a q1 [v_d (e . h) / se + mu kp cos(eta) sin(eta)^2 / sh + p1' / gamma1]
 *          + g q2 [mu theta_f' sin(eta) / sh - p2' / gamma2]
 *
 * (kh eta (1 - g q2) = kh g p2 eta was taken together, so that noise in eta is not squared into
 * p2.) Adaptive law: the one that makes both brackets vanish,
 *
 *     p1' = -gamma1 (v_d (e . h) / se + mu kp cos(eta) sin(eta)^2 / sh)
 *     p2' = gamma2 mu theta_f' sin(eta) / sh.
 *
 * What remains is at most a quadratic form in |e| and |sin eta| (eta sin eta >= sin(eta)^2). It is
 * negative definite while |f|^2 < 4 kp kh g p2 mu se / sh: for g p2 = 1 and the numbers below up to
 * 2.4 m/s near eta = 0 and up to 0.9 m/s wherever |eta| <= pi / 2. So e and eta go to 0, and the
 * estimates to the truth as long as the reference moves (p1) and turns (p2). A projection keeps
 * them in [0.5, 2], which only lowers W while the truth is in there.
 *
 * The proof asks for commands that are obeyed and for the field without obstacles. So the estimates
 * rest while a limit acts and while an obstacle's potential does. */
#include "strategy_adaptive.h"

#include "plant.h"
#include "strategy_common.h"
#include "strategy_list.h"

#include "berth/angle.h"

#include <math.h>
#include <stdlib.h>

#define KP_PER_S 1.5
#define KH_PER_S 4.0
#define KA 0.002
#define MU_M2 0.25

/* About the reference: q1'' + kp q1' + gamma1 a v^2 q1 = 0, critically damped at 0.3 m/s with 6,
 * and q2'' + kh q2' + gamma2 mu g omega_r^2 q2 = 0, whose slow root is 0.1 1/s at 0.3 rad/s and
 * which stays well sampled at the fastest turns. */
#define GAMMA1_PER_M2 6.0
#define GAMMA2 16.0
#define ESTIMATE_MIN 0.5
#define ESTIMATE_MAX 2.0
#define DE_M 0.05
#define DH_RAD 0.2

/* Where the field all but vanishes (a reference that stands and has been reached), its direction is
 * noise and the heading is left alone. */
#define STILL_MPS 0.005

/* d^2 - R^2 is taken no smaller than this part of R^2: at the hard radius the field is huge and
 * points away, and within it too, but it is finite. */
#define SINGULARITY 1.0e-3

typedef struct {
    double x, y;
} vector_t;

typedef struct {
    strategy_drive_t drive;
    const scenario_t *scenario;
    double inverse_a; /* p1 */
    double inverse_g; /* p2 */
} adaptive_t;

static double dot(vector_t a, vector_t b) {
    return a.x * b.x + a.y * b.y;
}

static double cross(vector_t a, vector_t b) {
    return a.x * b.y - a.y * b.x;
}

/* Angle from a to b. */
static double angle_between(vector_t a, vector_t b) {
    return (double)berth_atan2((float)cross(a, b), (float)dot(a, b));
}

/* Gradient of an obstacle's potential. With s = d^2, N = s - G^2 and D = s - R^2 it is
 * dV/ds 2 (p - o), dV/ds = 2 (N / D) (G^2 - R^2) / D^2. False: the robot is out of its reach. */
static bool potential_gradient(const scenario_obstacle_t *obstacle, vector_t p,
                               vector_t *gradient) {
    const vector_t away = {p.x - obstacle->x_m, p.y - obstacle->y_m};
    const double square = dot(away, away);
    const double hard = obstacle->hard_m * obstacle->hard_m;
    const double regulated = obstacle->regulated_m * obstacle->regulated_m;
    if (square >= regulated) {
        return false;
    }
    const double depth = fmax(square - hard, SINGULARITY * hard);
    const double slope = 2.0 * (square - regulated) / depth * (regulated - hard) / (depth * depth);
    *gradient = (vector_t){2.0 * slope * away.x, 2.0 * slope * away.y};
    return true;
}

/* The field at a position and a step, held below v_max. Returns whether an obstacle acts. */
static bool field(const adaptive_t *self, long number, vector_t p, vector_t *f) {
    const berth_sample_t sample = strategy_drive_sample(&self->drive, number);
    double sine;
    double cosine;
    plant_sincos((double)sample.theta_rad, &sine, &cosine);
    f->x = (double)sample.v_mps * cosine - KP_PER_S * (p.x - (double)sample.x_m);
    f->y = (double)sample.v_mps * sine - KP_PER_S * (p.y - (double)sample.y_m);
    bool acts = false;
    for (size_t i = 0; i < self->scenario->obstacle_count; ++i) {
        vector_t gradient;
        if (potential_gradient(&self->scenario->obstacles[i], p, &gradient)) {
            f->x -= KA * gradient.x;
            f->y -= KA * gradient.y;
            acts = true;
        }
    }
    const double norm = sqrt(dot(*f, *f));
    const double v_max = (double)self->drive.limits_config.v_max_mps;
    if (norm > v_max) {
        f->x *= v_max / norm;
        f->y *= v_max / norm;
    }
    return acts;
}

static double clamp(double value, double low, double high) {
    return value < low ? low : (value > high ? high : value);
}

/* What the law asks of the robot, and what the adaptation needs to know of it. */
typedef struct {
    double v_mps, omega_radps;
    double rate_radps; /* theta_f' */
    double eta_rad;
    double error_along_m;   /* e . h */
    double error_square_m2; /* |e|^2 */
    bool avoids;
    bool moves;
} demand_t;

/* theta_f', the mean over the period to come, along the arc asked for; since that arc depends on
 * it, it is found in two rounds. */
static double turn_rate(const adaptive_t *self, long number, const berth_pose_t *pose,
                        const vector_t *f, const demand_t *demand) {
    const double period_s = (double)self->drive.period_s;
    const double omega_max = (double)self->drive.limits_config.omega_max_radps;
    const double chord = demand->v_mps * period_s;
    double omega = 0.0;
    double rate = 0.0;
    for (int round = 0; round < 2; ++round) {
        const double middle = (double)pose->theta_rad + 0.5 * period_s * omega;
        vector_t h;
        plant_sincos(middle, &h.y, &h.x);
        const vector_t p = {(double)pose->x_m + chord * h.x, (double)pose->y_m + chord * h.y};
        vector_t next;
        (void)field(self, number + 1, p, &next);
        rate = clamp(angle_between(*f, next) / period_s, -omega_max, omega_max);
        omega = clamp(rate + KH_PER_S * demand->eta_rad, -omega_max, omega_max);
    }
    return rate;
}

static demand_t law(const adaptive_t *self, long number, const berth_pose_t *pose) {
    const berth_sample_t sample = strategy_drive_sample(&self->drive, number);
    const vector_t p = {(double)pose->x_m, (double)pose->y_m};
    const vector_t e = {p.x - (double)sample.x_m, p.y - (double)sample.y_m};
    vector_t h;
    plant_sincos((double)pose->theta_rad, &h.y, &h.x);
    vector_t f;
    demand_t demand = {.avoids = field(self, number, p, &f)};
    demand.error_along_m = dot(e, h);
    demand.error_square_m2 = dot(e, e);
    demand.v_mps = dot(f, h);
    demand.moves = dot(f, f) >= STILL_MPS * STILL_MPS;
    if (demand.moves) {
        demand.eta_rad = angle_between(h, f);
        demand.rate_radps = turn_rate(self, number, pose, &f, &demand);
        demand.omega_radps = demand.rate_radps + KH_PER_S * demand.eta_rad;
    }
    return demand;
}

static void adapt(adaptive_t *self, const demand_t *demand) {
    const double period_s = (double)self->drive.period_s;
    double sine;
    double cosine;
    plant_sincos(demand->eta_rad, &sine, &cosine);
    const double se = sqrt(1.0 + demand->error_square_m2 / (DE_M * DE_M));
    const double sh = sqrt(1.0 + 2.0 * (1.0 - cosine) / (DH_RAD * DH_RAD));
    const double rate_a = -GAMMA1_PER_M2 * (demand->v_mps * demand->error_along_m / se +
                                            MU_M2 * KP_PER_S * cosine * sine * sine / sh);
    const double rate_g = GAMMA2 * MU_M2 * demand->rate_radps * sine / sh;
    self->inverse_a = clamp(self->inverse_a + period_s * rate_a, ESTIMATE_MIN, ESTIMATE_MAX);
    self->inverse_g = clamp(self->inverse_g + period_s * rate_g, ESTIMATE_MIN, ESTIMATE_MAX);
}

static void step(void *context, long number, const berth_pose_t *pose, strategy_output_t *out) {
    adaptive_t *self = context;
    const demand_t demand = law(self, number, pose);
    const berth_twist_t command = {(float)(self->inverse_a * demand.v_mps),
                                   (float)(self->inverse_g * demand.omega_radps)};
    const berth_mode_t mode = demand.avoids ? BERTH_MODE_REGULATED : BERTH_MODE_TRACK;
    /* The heading comes first: v is already the part of f along it. */
    const uint8_t limited = strategy_drive_output(&self->drive, command, true, mode, out);
    if (demand.moves && !demand.avoids && limited == 0) {
        adapt(self, &demand);
    }
}

static void *create(const strategy_scene_t *scene, scenario_error_t *error) {
    adaptive_t *self = calloc(1, sizeof *self);
    if (self == NULL) {
        strategy_memory_text(error);
        return NULL;
    }
    if (!strategy_drive_init(&self->drive, scene, error)) {
        free(self);
        return NULL;
    }
    self->scenario = scene->scenario;
    self->inverse_a = 1.0;
    self->inverse_g = 1.0;
    return self;
}

strategy_adaptive_estimates_t strategy_adaptive_estimates(const void *self) {
    const adaptive_t *adaptive = self;
    return (strategy_adaptive_estimates_t){1.0 / adaptive->inverse_a,
                                           adaptive->inverse_g / adaptive->inverse_a};
}

const strategy_t strategy_adaptive = {
    .name = "adaptive",
    .summary = "velocity field with a potential, wheel scales estimated on line",
    .create = create,
    .step = step,
    .destroy = free,
};
