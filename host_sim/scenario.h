/* A scenario: everything that one simulated run needs, in double precision and SI units.
 *
 * Read from YAML or built in by name. The ranges are in one table in scenario.c; a value outside
 * its range never gets into a scenario_t.
 */
#ifndef HOST_SIM_SCENARIO_H
#define HOST_SIM_SCENARIO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#define SCENARIO_OBSTACLES_MAX 16
#define SCENARIO_TEXT_MAX 256

typedef enum { SHAPE_CIRCLE, SHAPE_EIGHT, SHAPE_FILE } shape_t;

typedef struct {
    double x_m, y_m;
    double hard_m, conservative_m, regulated_m;
} scenario_obstacle_t;

/* What the drives and sensors really do. All zero: commands are executed exactly. */
typedef struct {
    double tau_s;            /* first-order lag of each wheel */
    double a_max_mps2;       /* acceleration of each wheel's rim; 0: unlimited */
    double alpha_max_radps2; /* yaw acceleration; 0: unlimited */
    double pose_noise_m;     /* standard deviation of measured x and y */
    double heading_noise_rad;
    double slip;         /* each wheel's way over the ground is up to this part of the rim's more or
                            less: see plant.h */
    double pose_delay_s; /* the measured pose is so old */
    double watchdog_s;   /* time after which a drive without commands stops by itself, which the
                            firmware counts as delay; 0: it need not */
    double untold;       /* part of the delays, the braking distance and the noise that the firmware
                            is not told of: see strategy_told. 0: it knows the plant as it is */
    double radius_scale; /* true wheel radius / nominal; not in scenario files, 1 there */
    double track_scale;  /* true track width / nominal; not in scenario files, 1 there */
} scenario_plant_t;

typedef struct {
    char name[SCENARIO_TEXT_MAX];
    double period_s;
    double duration_s;
    struct {
        shape_t shape;
        char file[SCENARIO_TEXT_MAX]; /* as resolved: relative to the scenario file's folder */
        bool closed;
    } reference;
    struct {
        double wheel_radius_m, track_m, v_max_mps, omega_max_radps;
        double wheel_speed_max_radps; /* 0: no further limit */
    } robot;
    struct {
        double x_m, y_m, theta_rad;
    } start;
    struct {
        int horizon;
        double q[3], r[2];
        bool zoh;
        bool constrained; /* the wheels' limits in the optimum */
    } mpc;
    struct {
        char strategy[32];
        double skirt_m, v_creep_mps;
        bool paced; /* keeps the pace of drives with lag: see berth/avoid.h */
    } avoidance;
    scenario_obstacle_t obstacles[SCENARIO_OBSTACLES_MAX];
    size_t obstacle_count;
    scenario_plant_t plant;
} scenario_t;

/* One line of what is wrong: "FILE:LINE: KEY: what it is (allowed: range)". */
typedef struct {
    char text[512];
} scenario_error_t;

/* The two built-in experiments, `circle` and `eight`; false when the name is neither. */
bool scenario_builtin(const char *name, scenario_t *scenario);

/* Reads a YAML scenario file. On false nothing is kept and *error says why. */
bool scenario_load(const char *path, scenario_t *scenario, scenario_error_t *error);

/* What a program is told: a built-in scenario by its name or one from a YAML file, changed by
 * sets[] (as scenario_set takes them, in their order), and checked. */
bool scenario_open(const char *name, const char *const *sets, size_t set_count,
                   scenario_t *scenario, scenario_error_t *error);

/* The same from a text with an end; name stands for it in messages. */
bool scenario_load_text(const char *name, const char *text, scenario_t *scenario,
                        scenario_error_t *error);

/* Sets one value by its dotted key ("robot.v_max_mps=0.6", "obstacles.0.hard_m=0.2",
 * "mpc.q=[10,40,1]"), with the same checks as a file. */
bool scenario_set(scenario_t *scenario, const char *assignment, scenario_error_t *error);

/* Checks that need more than one value (C > R, G >= C + skirt, a strategy that exists, ...). */
bool scenario_check(const scenario_t *scenario, scenario_error_t *error);

/* Writes the scenario as YAML that scenario_load reads back to the same values. */
bool scenario_write(const scenario_t *scenario, const char *path, scenario_error_t *error);

/* The same text to an open file; what cannot be written shows in ferror. False with nothing written
 * when the reference's file has no absolute path. */
bool scenario_print(const scenario_t *scenario, FILE *file, scenario_error_t *error);

#endif
