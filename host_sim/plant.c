#include "plant.h"

#include <math.h>

#define PI 3.14159265358979323846
#define QUARTER_PI 0.78539816339744830962

/* The direction (cosine, sine) is rotated in each step, which is cheaper than a sine and cosine of
 * the heading. So often it is computed from the heading again, lest rounding errors add up. */
#define ROTATIONS_MAX 1024u

typedef struct {
    double x, y;
    double c, s; /* direction of the heading */
} frame_t;

/* A motion with constant velocity during the time t. */
typedef struct {
    double v, omega, t;
} arc_t;

/* sin(r) / r and cos(r) for |r| <= pi/4. The polynomials are those of fdlibm's k_sin.c and k_cos.c
 * (Sun Microsystems, 1993): errors below 2^-58. */
static inline void kernel(double r, double *sinc, double *cosine) {
    double z = r * r;
    double s = 8.33333333332248946124e-03 +
               z * (-1.98412698298579493134e-04 +
                    z * (2.75573137070700676789e-06 +
                         z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)));
    *sinc = 1.0 + z * (-1.66666666666666324348e-01 + z * s);
    double c = 4.16666666666666019037e-02 +
               z * (-1.38888888888741095749e-03 +
                    z * (2.48015872894767294178e-05 +
                         z * (-2.75573143513906633035e-07 +
                              z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))));
    double half = 0.5 * z;
    double w = 1.0 - half;
    *cosine = w + (((1.0 - w) - half) + z * z * c);
}

void plant_sincos(double angle_rad, double *sine, double *cosine) {
    /* pi / 2 in three parts of which the first two have 33 bits (fdlibm's e_rem_pio2.c). */
    static const double part1 = 1.57079632673412561417e+00;
    static const double part2 = 6.07710050630396597660e-11;
    static const double part3 = 2.02226624879595063154e-21;
    double turns = rint(angle_rad * (1.0 / (2.0 * QUARTER_PI)));
    double r = ((angle_rad - turns * part1) - turns * part2) - turns * part3;
    double sinc;
    double c;
    kernel(r, &sinc, &c);
    double s = r * sinc;
    double quadrant = turns - 4.0 * rint(0.25 * turns); /* -2 to 2, odd in the angle */
    bool swap = quadrant == 1.0 || quadrant == -1.0;
    *sine = swap ? c * quadrant : s;
    *cosine = swap ? -s * quadrant : c;
    if (quadrant == 2.0 || quadrant == -2.0) {
        *sine = -s;
        *cosine = -c;
    }
}

double plant_wrap(double angle_rad) {
    if (angle_rad >= -PI && angle_rad < PI) {
        return angle_rad;
    }
    double wrapped = angle_rad - 2.0 * PI * rint(angle_rad * (1.0 / (2.0 * PI)));
    if (wrapped >= PI) {
        wrapped -= 2.0 * PI;
    } else if (wrapped < -PI) {
        wrapped += 2.0 * PI;
    }
    return wrapped;
}

double plant_exp_minus(double x) {
    if (!(x < 708.0)) {
        return 0.0;
    }
    int halvings = (int)(x * 1.44269504088896340736 + 0.5);
    double r = (x - halvings * 0x1.62e42fee00000p-1) - halvings * 0x1.a39ef35793c76p-33;
    double sum = 1.0;
    for (int k = 17; k >= 1; --k) {
        sum = 1.0 - r * sum / k;
    }
    for (int k = 0; k < halvings; ++k) {
        sum *= 0.5;
    }
    return sum;
}

/* sin(h) / h, sin(h) and cos(h) of half the arc's turn. */
static inline void half_turn(double h, double *sinc, double *s, double *c) {
    if (h <= QUARTER_PI && h >= -QUARTER_PI) {
        kernel(h, sinc, c);
        *s = h * *sinc;
    } else {
        plant_sincos(h, s, c);
        *sinc = *s / h;
    }
}

/* The chord of an arc has the heading of its middle and the length v t sin(h) / h, h = omega t / 2:
 * no division by omega, so a straight line is no special case. */
static inline frame_t advance(const frame_t *start, const arc_t *arc) {
    double sinc;
    double sh;
    double ch;
    half_turn(0.5 * arc->omega * arc->t, &sinc, &sh, &ch);
    double mid_c = start->c * ch - start->s * sh;
    double mid_s = start->s * ch + start->c * sh;
    double chord = arc->v * arc->t * sinc;
    frame_t end;
    end.x = start->x + chord * mid_c;
    end.y = start->y + chord * mid_s;
    end.c = mid_c * ch - mid_s * sh;
    end.s = mid_s * ch + mid_c * sh;
    return end;
}

/* fmin without its rules for NaN, which cost a call. */
static double least_of(double a, double b) {
    return a < b ? a : b;
}

/* Distance from a point to the whole circle (or line) of the arc. (a, b) is the point ahead and to
 * the left of any frame on it, d2 its squared distance from there. This is | |o - centre| - radius
 * | expanded with its conjugate, so that a nearly straight arc loses no digits. */
static inline double circle_distance(const arc_t *arc, double a, double b, double d2) {
    double along = arc->omega * a;
    double across = arc->v - arc->omega * b;
    double norm = fabs(arc->v) + sqrt(along * along + across * across);
    return norm > 0.0 ? fabs(arc->omega * d2 - 2.0 * b * arc->v) / norm : sqrt(d2);
}

/* Least distance from (ox, oy) to an arc that turns by pi at most. The squared distance's
 * derivative is a sinusoid of the turn, so within half a turn it crosses zero at most once: the
 * nearest point is inside exactly if the point lies ahead at the start and behind at the end. */
static inline double half_circle_distance(const frame_t *start, const frame_t *end,
                                          const arc_t *arc, double ox, double oy) {
    double dx = ox - start->x;
    double dy = oy - start->y;
    double ex = ox - end->x;
    double ey = oy - end->y;
    double ahead = start->c * dx + start->s * dy;
    double ahead_end = end->c * ex + end->s * ey;
    double d2 = dx * dx + dy * dy;
    if (arc->v * ahead > 0.0 && arc->v * ahead_end < 0.0) {
        return circle_distance(arc, ahead, start->c * dy - start->s * dx, d2);
    }
    return sqrt(least_of(d2, ex * ex + ey * ey));
}

static double arc_distance(const frame_t *start, const frame_t *end, const arc_t *arc, double ox,
                           double oy) {
    double turn = fabs(arc->omega * arc->t);
    if (turn <= PI) {
        return half_circle_distance(start, end, arc, ox, oy);
    }
    if (turn >= 2.0 * PI) {
        double dx = ox - start->x;
        double dy = oy - start->y;
        return circle_distance(arc, start->c * dx + start->s * dy, start->c * dy - start->s * dx,
                               dx * dx + dy * dy);
    }
    arc_t half = {arc->v, arc->omega, 0.5 * arc->t};
    frame_t middle = advance(start, &half);
    return least_of(half_circle_distance(start, &middle, &half, ox, oy),
                    half_circle_distance(&middle, end, &half, ox, oy));
}

double plant_arc_distance(const plant_arc_t *arc, double x_m, double y_m) {
    frame_t start = {arc->x_m, arc->y_m, 0.0, 0.0};
    plant_sincos(arc->theta_rad, &start.s, &start.c);
    const arc_t motion = {arc->v_mps, arc->omega_radps, arc->time_s};
    const frame_t end = advance(&start, &motion);
    return arc_distance(&start, &end, &motion, x_m, y_m);
}

/* The discs to stay clear of, and the least clearance from any so far. */
typedef struct {
    const plant_disc_t *discs;
    size_t count;
    double least_m;
} watch_t;

static void watch_arc(watch_t *watch, const frame_t *start, const frame_t *end, const arc_t *arc) {
    const double travel = fabs(arc->v) * arc->t;
    for (size_t i = 0; i < watch->count; ++i) {
        const plant_disc_t *disc = &watch->discs[i];
        const double dx = disc->x_m - start->x;
        const double dy = disc->y_m - start->y;
        /* What is too far away at the start to come nearer than the least so far is passed over. */
        const double reach = watch->least_m + disc->radius_m + travel;
        if (reach < 0.0 || dx * dx + dy * dy > reach * reach) {
            continue;
        }
        const double clearance =
            arc_distance(start, end, arc, disc->x_m, disc->y_m) - disc->radius_m;
        watch->least_m = least_of(watch->least_m, clearance);
    }
}

/* What comes of the rims' motion on the ground. */
static arc_t on_ground(const plant_t *plant, const arc_t *rims) {
    if (plant->model.slip <= 0.0) {
        return *rims;
    }
    const double track_m = plant->track_m * plant->model.track_scale;
    const double turn_mps = 0.5 * track_m * rims->omega;
    const double left = (1.0 + plant->slips[0]) * (rims->v - turn_mps);
    const double right = (1.0 + plant->slips[1]) * (rims->v + turn_mps);
    return (arc_t){0.5 * (right + left), (right - left) / track_m, rims->t};
}

/* The slip of the next step. */
static void draw_slip(plant_t *plant, double period_s) {
    const double slip = plant->model.slip;
    if (slip <= 0.0) {
        return;
    }
    /* a microsecond: sums of periods round */
    if (plant->slip_left_s < 1.0e-6) {
        plant->slips[0] = rng_uniform(&plant->rng, -slip, slip);
        plant->slips[1] = rng_uniform(&plant->rng, -slip, slip);
        plant->slip_left_s = PLANT_SLIP_HOLD_S;
    }
    plant->slip_left_s -= period_s;
}

static void move(plant_t *plant, const arc_t *rims, watch_t *watch) {
    const arc_t ground = on_ground(plant, rims);
    const arc_t *arc = &ground;
    const frame_t start = {plant->x_m, plant->y_m, plant->cosine, plant->sine};
    const frame_t end = advance(&start, arc);
    watch_arc(watch, &start, &end, arc);
    plant->x_m = end.x;
    plant->y_m = end.y;
    const double turn = arc->omega * arc->t;
    plant->theta_rad = plant_wrap(plant->theta_rad + turn);
    plant->path_m += rims->v * rims->t;
    plant->turned_rad += rims->omega * rims->t;
    if (++plant->rotations >= ROTATIONS_MAX) {
        plant->rotations = 0;
        plant_sincos(plant->theta_rad, &plant->sine, &plant->cosine);
    } else {
        plant->cosine = end.c;
        plant->sine = end.s;
    }
}

void plant_set_pose(plant_t *plant, double x_m, double y_m, double theta_rad) {
    plant->x_m = x_m;
    plant->y_m = y_m;
    plant->theta_rad = plant_wrap(theta_rad);
    plant->rotations = 0;
    plant_sincos(plant->theta_rad, &plant->sine, &plant->cosine);
}

void plant_init(plant_t *plant, const scenario_t *scenario, uint64_t seed) {
    *plant = (plant_t){.model = scenario->plant, .track_m = scenario->robot.track_m};
    plant->v_scale = plant->model.radius_scale;
    plant->omega_scale = plant->model.radius_scale / plant->model.track_scale;
    plant->ideal = plant->model.tau_s <= 0.0 && plant->model.a_max_mps2 <= 0.0 &&
                   plant->model.alpha_max_radps2 <= 0.0;
    plant_set_pose(plant, scenario->start.x_m, scenario->start.y_m, scenario->start.theta_rad);
    rng_seed(&plant->rng, seed);
}

berth_pose_t plant_measure(plant_t *plant) {
    return plant_measure_at(plant, plant->x_m, plant->y_m, plant->theta_rad);
}

berth_pose_t plant_measure_at(plant_t *plant, double x_m, double y_m, double theta_rad) {
    double x = x_m;
    double y = y_m;
    double theta = theta_rad;
    if (plant->model.pose_noise_m > 0.0 || plant->model.heading_noise_rad > 0.0) {
        x += plant->model.pose_noise_m * rng_normal(&plant->rng);
        y += plant->model.pose_noise_m * rng_normal(&plant->rng);
        theta += plant->model.heading_noise_rad * rng_normal(&plant->rng);
    }
    return (berth_pose_t){(float)x, (float)y, (float)theta};
}

void plant_wheels(const plant_t *plant, double wheel_radius_m, double *left_rad,
                  double *right_rad) {
    const double radius_m = wheel_radius_m * plant->model.radius_scale;
    const double turn_m = 0.5 * plant->track_m * plant->model.track_scale * plant->turned_rad;
    *left_rad = (plant->path_m - turn_m) / radius_m;
    *right_rad = (plant->path_m + turn_m) / radius_m;
}

void plant_wheel_speeds(const plant_t *plant, double wheel_radius_m, double *left_radps,
                        double *right_radps) {
    const double radius_m = wheel_radius_m * plant->model.radius_scale;
    const double turn_mps = 0.5 * plant->track_m * plant->model.track_scale * plant->rim_radps;
    *left_radps = (plant->rim_mps - turn_mps) / radius_m;
    *right_radps = (plant->rim_mps + turn_mps) / radius_m;
}

static double clamp_abs(double value, double limit) {
    return value > limit ? limit : (value < -limit ? -limit : value);
}

/* Change of a rim speed towards its command in dt: the lag's exact step, within the acceleration
 * that the drive has. */
static double rim_change(const plant_t *plant, double rim, double target, double dt) {
    double change = (target - rim) * (1.0 - plant->decay);
    if (plant->model.a_max_mps2 > 0.0) {
        change = clamp_abs(change, plant->model.a_max_mps2 * dt);
    }
    return change;
}

/* One part of the period: new rim speeds, and an arc with the mean of old and new ones. */
static void substep(plant_t *plant, double left_cmd, double right_cmd, double dt, watch_t *watch) {
    double left = rim_change(plant, plant->left_mps, left_cmd, dt);
    double right = rim_change(plant, plant->right_mps, right_cmd, dt);
    const double track_m = plant->track_m * plant->model.track_scale;
    if (plant->model.alpha_max_radps2 > 0.0) {
        const double common = 0.5 * (right + left);
        const double most = 0.5 * plant->model.alpha_max_radps2 * track_m * dt;
        const double turn = clamp_abs(0.5 * (right - left), most);
        left = common - turn;
        right = common + turn;
    }
    const double left_mean = plant->left_mps + 0.5 * left;
    const double right_mean = plant->right_mps + 0.5 * right;
    plant->left_mps += left;
    plant->right_mps += right;
    const arc_t arc = {0.5 * (right_mean + left_mean), (right_mean - left_mean) / track_m, dt};
    move(plant, &arc, watch);
}

static void step_with_dynamics(plant_t *plant, double v_cmd_mps, double omega_cmd_radps,
                               double period_s, watch_t *watch) {
    const double dt = period_s / PLANT_SUBSTEPS;
    if (dt != plant->decay_dt_s) {
        plant->decay_dt_s = dt;
        plant->decay = plant->model.tau_s > 0.0 ? plant_exp_minus(dt / plant->model.tau_s) : 0.0;
    }
    const double turn_mps = 0.5 * plant->track_m * omega_cmd_radps;
    const double left_cmd = plant->v_scale * (v_cmd_mps - turn_mps);
    const double right_cmd = plant->v_scale * (v_cmd_mps + turn_mps);
    for (int i = 0; i < PLANT_SUBSTEPS; ++i) {
        substep(plant, left_cmd, right_cmd, dt, watch);
    }
    plant->rim_mps = 0.5 * (plant->right_mps + plant->left_mps);
    plant->rim_radps =
        (plant->right_mps - plant->left_mps) / (plant->track_m * plant->model.track_scale);
}

double plant_step(plant_t *plant, double v_cmd_mps, double omega_cmd_radps, double period_s,
                  const plant_disc_t *discs, size_t disc_count) {
    watch_t watch = {discs, disc_count, HUGE_VAL};
    draw_slip(plant, period_s);
    if (plant->ideal) {
        plant->rim_mps = plant->v_scale * v_cmd_mps;
        plant->rim_radps = plant->omega_scale * omega_cmd_radps;
        const arc_t rims = {plant->rim_mps, plant->rim_radps, period_s};
        move(plant, &rims, &watch);
    } else {
        step_with_dynamics(plant, v_cmd_mps, omega_cmd_radps, period_s, &watch);
    }
    const arc_t rims = {plant->rim_mps, plant->rim_radps, 0.0};
    const arc_t ground = on_ground(plant, &rims);
    plant->v_mps = ground.v;
    plant->omega_radps = ground.omega;
    return watch.least_m;
}
