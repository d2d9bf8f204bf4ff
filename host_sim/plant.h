/* The simulated robot, in double precision.
 *
 * Ideal: a command (v, omega) is executed exactly, along an exact arc. With dynamics: each wheel
 * follows its command with a first-order lag and bounded rim acceleration, the body's yaw
 * acceleration is bounded too, and the motion is integrated along exact arcs of PLANT_SUBSTEPS
 * parts of the period.
 *
 * Scales. The board turns a command into wheel speeds with the nominal wheel radius r and track b;
 * the wheels turn as told, but their true radius is radius_scale r and the true track is
 * track_scale b. So the robot moves with
 *
 *     v_true = radius_scale v,    omega_true = (radius_scale / track_scale) omega,
 *
 * and the dynamics act on the true rim speeds radius_scale (v -+ omega b / 2).
 *
 * Slip. The way of each wheel over the ground is 1 + s times that of its rim, s anywhere from -slip
 * to slip, drawn for each wheel anew every PLANT_SLIP_HOLD_S. The encoders see the rims.
 *
 * Only + - * / and sqrt are used, no libm function that rounds differently elsewhere: the same
 * commands give the same motion on every platform. Commands with y, theta and omega mirrored give
 * the mirrored motion bit for bit (but for a heading of exactly -pi, which stays -pi, and slip).
 *
 * A plant_t is one robot: no state is shared between two of them.
 */
#ifndef HOST_SIM_PLANT_H
#define HOST_SIM_PLANT_H

#include "berth/types.h"
#include "rng.h"
#include "scenario.h"

#define PLANT_SUBSTEPS 10
#define PLANT_SLIP_HOLD_S 0.1

typedef struct {
    double x_m, y_m, theta_rad;  /* true pose; theta in [-pi, pi); read only: plant_set_pose */
    double v_mps, omega_radps;   /* true velocity at the end of the last step */
    double rim_mps, rim_radps;   /* the same without slip: what the wheels turn with */
    double cosine, sine;         /* of the heading */
    double left_mps, right_mps;  /* true rim speeds, for the dynamics */
    double path_m, turned_rad;   /* forward travel and yaw of the rims since the start */
    double slips[2];             /* left, right: s, until it is drawn anew */
    double slip_left_s;          /* time until then */
    double decay, decay_dt_s;    /* exp(-dt / tau) and the dt that it is for */
    double track_m;              /* nominal */
    double v_scale, omega_scale; /* true per commanded velocity */
    scenario_plant_t model;
    bool ideal;         /* no lag and no limits */
    unsigned rotations; /* of (cosine, sine) since they were computed from theta */
    rng_t rng;
} plant_t;

/* A disc to stay clear of. */
typedef struct {
    double x_m, y_m, radius_m;
} plant_disc_t;

/* The robot stands at the scenario's start; seed starts the noise stream. */
void plant_init(plant_t *plant, const scenario_t *scenario, uint64_t seed);

/* Puts the robot elsewhere; its speed stays. */
void plant_set_pose(plant_t *plant, double x_m, double y_m, double theta_rad);

/* The pose as the robot measures it: the true one plus noise, in float32. */
berth_pose_t plant_measure(plant_t *plant);

/* The same of a pose that it once had. */
berth_pose_t plant_measure_at(plant_t *plant, double x_m, double y_m, double theta_rad);

/* How far the two wheels have turned since the start, rad, positive forward: the rims' travel over
 * the true wheel radius. Exact, as the arcs are. wheel_radius_m: the nominal one. And how fast they
 * turn, rad/s. */
void plant_wheels(const plant_t *plant, double wheel_radius_m, double *left_rad, double *right_rad);
void plant_wheel_speeds(const plant_t *plant, double wheel_radius_m, double *left_radps,
                        double *right_radps);

/* Executes the command for period_s > 0. Returns the least clearance of the period over all discs
 * and all instants (exact along each arc): min (distance - radius); INFINITY without discs. */
double plant_step(plant_t *plant, double v_cmd_mps, double omega_cmd_radps, double period_s,
                  const plant_disc_t *discs, size_t disc_count);

/* A motion from a pose with constant velocity for a time >= 0. */
typedef struct {
    double x_m, y_m, theta_rad;
    double v_mps, omega_radps;
    double time_s;
} plant_arc_t;

/* Least distance from a point to an arc. Exact, for straight lines, turns on the spot and full
 * circles too. */
double plant_arc_distance(const plant_arc_t *arc, double x_m, double y_m);

/* Sine and cosine within 3 units in the last place up to |angle| = 1e5 (sine odd, cosine even, to
 * the bit), and the angle wrapped to [-pi, pi). */
void plant_sincos(double angle_rad, double *sine, double *cosine);
double plant_wrap(double angle_rad);

/* exp(-x) for x >= 0, within 2e-16 relative; 0 where that is not a normal number. */
double plant_exp_minus(double x);

#endif
