/* Limits as properties of random and extreme commands, and the wheels' arithmetic. */
#include "support.h"

#include "unity.h"

#include <float.h>
#include <math.h>
#include <stdio.h>

#define PERIOD 0.05f
#define ALL_SPEED_BITS (BERTH_LIMITED_V | BERTH_LIMITED_OMEGA | BERTH_LIMITED_WHEEL)

/* v and omega are clamped: exact. The wheel and acceleration limits are compared after sums and
 * products of float32, each off by up to 2^-24: three units of 2^-23 cover them. */
#define ROUNDING (3.0 * (double)FLT_EPSILON)

static uint32_t runs;

void setUp(void) {
    runs = support_runs(200000);
}

void tearDown(void) {}

static float random_sign(double magnitude) {
    return (float)(support_uniform(-1.0, 1.0) < 0.0 ? -magnitude : magnitude);
}

/* From 0 through ordinary to wild values, of both signs. */
static float random_speed(void) {
    switch (support_index(8)) {
    case 0:
        return 0.0f;
    case 1:
        return random_sign(support_log_uniform(1.0e-6, 1.0e9));
    default:
        return random_sign(support_uniform(0.0, 8.0));
    }
}

static berth_twist_t random_twist(void) {
    const float v = random_speed();
    return (berth_twist_t){v, random_speed()};
}

/* A configuration without acceleration limits; with a wheel limit in half of the cases, from one
 * that always decides to one that never does. */
static berth_limits_config_t random_config(void) {
    berth_limits_config_t config = {
        .wheel_radius_m = (float)support_log_uniform(0.01, 1.0),
        .track_m = (float)support_log_uniform(0.05, 2.0),
        .v_max_mps = (float)support_log_uniform(0.05, 5.0),
        .omega_max_radps = (float)support_log_uniform(0.05, 10.0),
    };
    if (support_index(2) == 0) {
        const double rim = (double)config.v_max_mps +
                           0.5 * (double)config.track_m * (double)config.omega_max_radps;
        config.wheel_speed_max_radps =
            (float)(rim / (double)config.wheel_radius_m * support_uniform(0.1, 1.2));
    }
    berth_refusal_t refusal;
    TEST_ASSERT_EQUAL(BERTH_OK, berth_limits_check(&config, &refusal));
    return config;
}

static uint8_t apply_fresh(const berth_limits_config_t *config, bool keep_omega,
                           berth_twist_t *command) {
    berth_limits_t limits;
    berth_limits_reset(&limits);
    const uint8_t limited = berth_limits_apply(&limits, config, PERIOD, keep_omega, command);
    TEST_ASSERT_TRUE(support_same_bits(command->v_mps, limits.last.v_mps));
    TEST_ASSERT_TRUE(support_same_bits(command->omega_radps, limits.last.omega_radps));
    return limited;
}

static double rim_speed(const berth_limits_config_t *config, const berth_twist_t *twist) {
    return fabs((double)twist->v_mps) +
           fabs((double)twist->omega_radps) * 0.5 * (double)config->track_m;
}

static double rim_max(const berth_limits_config_t *config) {
    return (double)config->wheel_radius_m * (double)config->wheel_speed_max_radps;
}

static bool has_wheel_limit(const berth_limits_config_t *config) {
    return config->wheel_speed_max_radps > 0.0f;
}

static void check_within(const berth_limits_config_t *config, const berth_twist_t *twist) {
    TEST_ASSERT_TRUE(fabsf(twist->v_mps) <= config->v_max_mps);
    TEST_ASSERT_TRUE(fabsf(twist->omega_radps) <= config->omega_max_radps);
    if (has_wheel_limit(config)) {
        TEST_ASSERT_TRUE(rim_speed(config, twist) <= rim_max(config) * (1.0 + ROUNDING));
        const berth_wheels_t wheels = berth_wheels_from_twist(config, *twist);
        const double most = (double)config->wheel_speed_max_radps * (1.0 + 2.0 * ROUNDING);
        TEST_ASSERT_TRUE(fabs((double)wheels.left_radps) <= most);
        TEST_ASSERT_TRUE(fabs((double)wheels.right_radps) <= most);
    }
}

static void test_never_outside_the_speed_limits(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t asked = random_twist();
        for (int keep_omega = 0; keep_omega < 2; keep_omega++) {
            berth_twist_t command = asked;
            (void)apply_fresh(&config, keep_omega != 0, &command);
            check_within(&config, &command);
        }
    }
}

static void test_never_faster_and_never_reversed(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t asked = random_twist();
        for (int keep_omega = 0; keep_omega < 2; keep_omega++) {
            berth_twist_t command = asked;
            (void)apply_fresh(&config, keep_omega != 0, &command);
            TEST_ASSERT_TRUE(fabsf(command.v_mps) <= fabsf(asked.v_mps));
            TEST_ASSERT_TRUE(fabsf(command.omega_radps) <= fabsf(asked.omega_radps));
            TEST_ASSERT_TRUE(command.v_mps * asked.v_mps >= 0.0f);
            TEST_ASSERT_TRUE(command.omega_radps * asked.omega_radps >= 0.0f);
        }
    }
}

static void test_no_limit_acting_leaves_the_bits(void) {
    support_random_start();
    uint32_t untouched = 0;
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t asked = random_twist();
        for (int keep_omega = 0; keep_omega < 2; keep_omega++) {
            berth_twist_t command = asked;
            const uint8_t limited = apply_fresh(&config, keep_omega != 0, &command);
            const bool same = support_same_bits(asked.v_mps, command.v_mps) &&
                              support_same_bits(asked.omega_radps, command.omega_radps);
            TEST_ASSERT_EQUAL(limited == 0, same);
            untouched += same ? 1u : 0u;
        }
    }
    TEST_ASSERT_TRUE(untouched > runs / 10); /* both branches were met */
    TEST_ASSERT_TRUE(untouched < 2 * runs - runs / 10);
}

/* cross = v omega' - omega v' is 0 when the curvature is the same. */
static void test_tracking_keeps_the_curvature(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t asked = random_twist();
        berth_twist_t command = asked;
        (void)apply_fresh(&config, false, &command);
        const double first = (double)asked.v_mps * (double)command.omega_radps;
        const double second = (double)asked.omega_radps * (double)command.v_mps;
        TEST_ASSERT_TRUE(fabs(first - second) <= ROUNDING * fabs(first));
    }
}

/* The part of a speed that its limit allows. */
static double share(float speed, float limit) {
    return fabsf(speed) > limit ? (double)limit / fabs((double)speed) : 1.0;
}

/* Tracking: the largest scale that all limits allow, not a smaller one. */
static void test_tracking_gives_away_no_more_than_it_must(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t asked = random_twist();
        berth_twist_t command = asked;
        (void)apply_fresh(&config, false, &command);
        double scale = fmin(share(asked.v_mps, config.v_max_mps),
                            share(asked.omega_radps, config.omega_max_radps));
        if (has_wheel_limit(&config)) {
            const double rim = rim_speed(&config, &asked);
            scale = rim > rim_max(&config) ? fmin(scale, rim_max(&config) / rim) : scale;
        }
        const double v = scale * (double)asked.v_mps;
        const double omega = scale * (double)asked.omega_radps;
        TEST_ASSERT_TRUE(fabs((double)command.v_mps - v) <= ROUNDING * fabs(v));
        TEST_ASSERT_TRUE(fabs((double)command.omega_radps - omega) <= ROUNDING * fabs(omega));
    }
}

/* Avoiding: omega loses nothing but what the robot cannot turn even while it stands; then v takes
 * all that is left, and no more. */
static void test_avoiding_keeps_omega_and_v_gives_way(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t asked = random_twist();
        berth_twist_t command = asked;
        (void)apply_fresh(&config, true, &command);
        const double half_track = 0.5 * (double)config.track_m;
        double omega_most = (double)config.omega_max_radps;
        double v_most = (double)config.v_max_mps;
        double rounding = 0.0;
        if (has_wheel_limit(&config)) {
            omega_most = fmin(omega_most, rim_max(&config) / half_track);
            const double omega = fmin(fabs((double)asked.omega_radps), omega_most);
            v_most = fmin(v_most, rim_max(&config) - omega * half_track);
            rounding = ROUNDING * rim_max(&config); /* the difference may cancel */
        }
        const double v = fmin(fabs((double)asked.v_mps), v_most);
        const double omega = fmin(fabs((double)asked.omega_radps), omega_most);
        TEST_ASSERT_TRUE(fabs(fabs((double)command.omega_radps) - omega) <= ROUNDING * omega);
        TEST_ASSERT_TRUE(fabs(fabs((double)command.v_mps) - v) <= rounding);
    }
}

/* Which limits the command as asked for is outside of. */
static uint8_t exceeded(const berth_limits_config_t *config, const berth_twist_t *asked) {
    uint8_t bits = 0;
    if (fabsf(asked->v_mps) > config->v_max_mps) {
        bits |= BERTH_LIMITED_V;
    }
    if (fabsf(asked->omega_radps) > config->omega_max_radps) {
        bits |= BERTH_LIMITED_OMEGA;
    }
    if (has_wheel_limit(config) && rim_speed(config, asked) > rim_max(config) * (1.0 - ROUNDING)) {
        bits |= BERTH_LIMITED_WHEEL;
    }
    return bits;
}

/* Which limits the limited command stands at, within rounding. */
static uint8_t reached(const berth_limits_config_t *config, const berth_twist_t *command) {
    uint8_t bits = 0;
    if (fabs((double)command->v_mps) >= (double)config->v_max_mps * (1.0 - ROUNDING)) {
        bits |= BERTH_LIMITED_V;
    }
    if (fabs((double)command->omega_radps) >= (double)config->omega_max_radps * (1.0 - ROUNDING)) {
        bits |= BERTH_LIMITED_OMEGA;
    }
    if (has_wheel_limit(config) &&
        rim_speed(config, command) >= rim_max(config) * (1.0 - ROUNDING)) {
        bits |= BERTH_LIMITED_WHEEL;
    }
    return bits;
}

/* A flag is set only for a limit that the command exceeded, and for at least one that it was
 * brought down to; avoiding, v and omega are cut one by one, so exactly those exceeded are set. */
static void test_flags_name_the_limits_that_acted(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t asked = random_twist();
        for (int keep_omega = 0; keep_omega < 2; keep_omega++) {
            berth_twist_t command = asked;
            const uint8_t limited = apply_fresh(&config, keep_omega != 0, &command);
            const uint8_t over = exceeded(&config, &asked);
            TEST_ASSERT_EQUAL_HEX8(0, limited & ~over);
            if (limited != 0) {
                TEST_ASSERT_NOT_EQUAL(0, limited & reached(&config, &command));
            }
            if (keep_omega != 0) {
                const uint8_t boxes = BERTH_LIMITED_V | BERTH_LIMITED_OMEGA;
                TEST_ASSERT_EQUAL_HEX8(over & boxes, limited & boxes);
            }
        }
    }
}

/* One command for each limit that acts alone, and the values by hand. */
static void test_each_flag_by_hand(void) {
    const berth_limits_config_t config = {
        .wheel_radius_m = 0.5f,
        .track_m = 1.0f,
        .v_max_mps = 1.0f,
        .omega_max_radps = 2.0f,
        .wheel_speed_max_radps = 3.0f, /* 1.5 m/s at the rim */
    };
    static const struct {
        bool keep_omega;
        berth_twist_t asked, given;
        uint8_t limited;
    } cases[] = {
        {false, {1.0f, 1.0f}, {1.0f, 1.0f}, 0},
        {false, {2.0f, 0.5f}, {1.0f, 0.25f}, BERTH_LIMITED_V},
        {false, {-0.5f, 4.0f}, {-0.25f, 2.0f}, BERTH_LIMITED_OMEGA},
        {false, {0.75f, -2.0f}, {0.642857143f, -1.714285714f}, BERTH_LIMITED_WHEEL},
        {false, {2.0f, 2.0f}, {1.0f, 1.0f}, BERTH_LIMITED_V},
        {true, {2.0f, 0.5f}, {1.0f, 0.5f}, BERTH_LIMITED_V},
        {true, {-0.25f, 4.0f}, {-0.25f, 2.0f}, BERTH_LIMITED_OMEGA},
        {true, {1.0f, -2.0f}, {0.5f, -2.0f}, BERTH_LIMITED_WHEEL},
        {true, {3.0f, 9.0f}, {0.5f, 2.0f}, ALL_SPEED_BITS},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        berth_twist_t command = cases[i].asked;
        TEST_ASSERT_EQUAL_HEX8(cases[i].limited,
                               apply_fresh(&config, cases[i].keep_omega, &command));
        TEST_ASSERT_FLOAT_WITHIN(2.0e-7f, cases[i].given.v_mps, command.v_mps);
        TEST_ASSERT_FLOAT_WITHIN(4.0e-7f, cases[i].given.omega_radps, command.omega_radps);
    }
}

/* Wheels too slow for omega_max: avoiding, the robot stands and turns as fast as they can. */
static void test_avoiding_with_wheels_too_slow_to_turn(void) {
    const berth_limits_config_t config = {
        .wheel_radius_m = 0.5f,
        .track_m = 1.0f,
        .v_max_mps = 1.0f,
        .omega_max_radps = 2.0f,
        .wheel_speed_max_radps = 1.0f,
    };
    berth_twist_t command = {-0.7f, -1.5f};
    TEST_ASSERT_EQUAL_HEX8(BERTH_LIMITED_WHEEL, apply_fresh(&config, true, &command));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, command.v_mps);
    TEST_ASSERT_EQUAL_FLOAT(-1.0f, command.omega_radps);
}

/* Up to the largest floats: sums overflow to infinity inside and must not become NaN. */
static void test_extreme_values(void) {
    const float values[] = {0.0f,    -0.0f,    FLT_TRUE_MIN, -FLT_MIN, 1.0f,
                            1.0e20f, -1.0e30f, FLT_MAX,      -FLT_MAX};
    const size_t count = sizeof values / sizeof values[0];
    const float tracks[] = {0.01f, 10.0f};
    for (size_t i = 0; i < count * count * 4; i++) {
        const berth_limits_config_t config = {
            .wheel_radius_m = 0.05f,
            .track_m = tracks[i % 2],
            .v_max_mps = 0.8f,
            .omega_max_radps = 3.0f,
            .wheel_speed_max_radps = 20.0f,
        };
        berth_twist_t command = {values[i / 4 % count], values[i / 4 / count]};
        (void)apply_fresh(&config, i % 4 < 2, &command);
        TEST_ASSERT_TRUE(isfinite(command.v_mps) && isfinite(command.omega_radps));
        check_within(&config, &command);
    }
}

static berth_limits_config_t with_acceleration_limits(berth_limits_config_t config) {
    config.a_max_mps2 = support_index(3) == 0 ? 0.0f : (float)support_log_uniform(0.1, 100.0);
    config.alpha_max_radps2 = support_index(3) == 0 ? 0.0f : (float)support_log_uniform(0.1, 300.0);
    return config;
}

/* |change| <= limit T, but for the rounding of last + change to the precision of the larger, and
 * of what the wheels leave, which is a difference of speeds up to size. */
static void check_change(float before, float after, float limit, double size) {
    const double change = fabs((double)after - (double)before);
    const double most = (double)limit * (double)PERIOD;
    size += fabs((double)before) + fabs((double)after);
    TEST_ASSERT_TRUE(limit == 0.0f || change <= most * (1.0 + ROUNDING) + ROUNDING * size);
}

/* Ten steps in a row with every limit at once. */
static void test_acceleration_limits_hold_with_all_others(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs / 10; run++) {
        const berth_limits_config_t config = with_acceleration_limits(random_config());
        berth_limits_t limits;
        berth_limits_reset(&limits);
        for (int step = 0; step < 10; step++) {
            const berth_twist_t last = limits.last;
            const bool keep_omega = support_index(2) == 0;
            berth_twist_t command = random_twist();
            (void)berth_limits_apply(&limits, &config, PERIOD, keep_omega, &command);
            check_change(last.v_mps, command.v_mps, config.a_max_mps2, rim_max(&config));
            check_change(last.omega_radps, command.omega_radps, config.alpha_max_radps2,
                         2.0 * rim_max(&config) / (double)config.track_m);
            check_within(&config, &command);
        }
    }
}

/* What the other limits let pass is reached in steps, and once reached it stays to the bit. */
static void test_acceleration_limits_arrive(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs / 100; run++) {
        berth_limits_config_t config = random_config();
        const bool keep_omega = support_index(2) == 0;
        const berth_twist_t asked = random_twist();
        berth_twist_t target = asked;
        const uint8_t speed_bits = apply_fresh(&config, keep_omega, &target);
        config.a_max_mps2 = 10.0f;
        config.alpha_max_radps2 = 30.0f;
        berth_limits_t limits;
        berth_limits_reset(&limits);
        uint8_t limited = 0;
        for (int step = 0; step < 60; step++) {
            berth_twist_t command = asked;
            limited = berth_limits_apply(&limits, &config, PERIOD, keep_omega, &command);
        }
        TEST_ASSERT_EQUAL_HEX8(speed_bits, limited);
        TEST_ASSERT_TRUE(support_same_bits(target.v_mps, limits.last.v_mps));
        TEST_ASSERT_TRUE(support_same_bits(target.omega_radps, limits.last.omega_radps));
    }
}

/* An acceleration limit that does not act must not touch the command either, whatever came
 * before: last + (v - last) is not v in float32. */
static void test_idle_acceleration_limits_leave_the_bits(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        berth_limits_config_t config = random_config();
        config.a_max_mps2 = 1000.0f;
        config.alpha_max_radps2 = 1000.0f;
        berth_limits_t limits;
        berth_limits_reset(&limits);
        berth_twist_t first = random_twist();
        (void)berth_limits_apply(&limits, &config, PERIOD, true, &first);
        const berth_twist_t asked = {(float)support_uniform(-0.05, 0.05),
                                     (float)support_uniform(-0.05, 0.05)};
        berth_twist_t command = asked;
        if (berth_limits_apply(&limits, &config, PERIOD, true, &command) == 0) {
            TEST_ASSERT_TRUE(support_same_bits(asked.v_mps, command.v_mps));
            TEST_ASSERT_TRUE(support_same_bits(asked.omega_radps, command.omega_radps));
        }
    }
}

static void test_acceleration_flags_by_hand(void) {
    const berth_limits_config_t config = {
        .wheel_radius_m = 0.5f,
        .track_m = 1.0f,
        .v_max_mps = 1.0f,
        .omega_max_radps = 2.0f,
        .a_max_mps2 = 4.0f,
        .alpha_max_radps2 = 8.0f,
    };
    berth_limits_t limits;
    berth_limits_reset(&limits);
    berth_twist_t command = {0.5f, 0.25f};
    TEST_ASSERT_EQUAL_HEX8(BERTH_LIMITED_A,
                           berth_limits_apply(&limits, &config, 0.0625f, false, &command));
    TEST_ASSERT_EQUAL_FLOAT(0.25f, command.v_mps);
    TEST_ASSERT_EQUAL_FLOAT(0.25f, command.omega_radps);
    command = (berth_twist_t){0.5f, -1.0f};
    TEST_ASSERT_EQUAL_HEX8(BERTH_LIMITED_ALPHA,
                           berth_limits_apply(&limits, &config, 0.0625f, false, &command));
    TEST_ASSERT_EQUAL_FLOAT(0.5f, command.v_mps);
    TEST_ASSERT_EQUAL_FLOAT(-0.25f, command.omega_radps);
    command = (berth_twist_t){-9.0f, -9.0f};
    const uint8_t all = BERTH_LIMITED_V | BERTH_LIMITED_A | BERTH_LIMITED_ALPHA;
    TEST_ASSERT_EQUAL_HEX8(all, berth_limits_apply(&limits, &config, 0.0625f, false, &command));
    TEST_ASSERT_EQUAL_FLOAT(0.25f, command.v_mps);
    TEST_ASSERT_EQUAL_FLOAT(-0.75f, command.omega_radps);
}

static void test_reset_takes_the_robot_to_stand(void) {
    berth_limits_t limits = {.last = {5.0f, 6.0f}};
    berth_limits_reset(&limits);
    TEST_ASSERT_TRUE(support_same_bits(0.0f, limits.last.v_mps));
    TEST_ASSERT_TRUE(support_same_bits(0.0f, limits.last.omega_radps));
}

static void test_wheels_against_double(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const double r = (double)config.wheel_radius_m;
        const double b = (double)config.track_m;
        const berth_twist_t twist = random_twist();
        const double v = (double)twist.v_mps;
        const double turn = 0.5 * b * (double)twist.omega_radps;
        const double size = (fabs(v) + fabs(turn)) / r; /* the sum may cancel */
        const berth_wheels_t wheels = berth_wheels_from_twist(&config, twist);
        TEST_ASSERT_TRUE(fabs((double)wheels.left_radps - (v - turn) / r) <= ROUNDING * size);
        TEST_ASSERT_TRUE(fabs((double)wheels.right_radps - (v + turn) / r) <= ROUNDING * size);
    }
}

static void test_twist_and_wheels_are_inverse(void) {
    support_random_start();
    for (uint32_t run = 0; run < runs; run++) {
        const berth_limits_config_t config = random_config();
        const berth_twist_t twist = random_twist();
        const berth_wheels_t wheels = berth_wheels_from_twist(&config, twist);
        const berth_twist_t back = berth_twist_from_wheels(&config, wheels);
        const double rim = rim_speed(&config, &twist);
        const double tolerance = 2.0 * ROUNDING * rim;
        TEST_ASSERT_TRUE(fabs((double)back.v_mps - (double)twist.v_mps) <= tolerance);
        TEST_ASSERT_TRUE(fabs((double)back.omega_radps - (double)twist.omega_radps) <=
                         2.0 * tolerance / (double)config.track_m);
    }
}

static void test_wheels_by_hand(void) {
    const berth_limits_config_t config = {.wheel_radius_m = 0.25f, .track_m = 0.5f};
    const berth_wheels_t ahead = berth_wheels_from_twist(&config, (berth_twist_t){1.0f, 0.0f});
    TEST_ASSERT_EQUAL_FLOAT(4.0f, ahead.left_radps);
    TEST_ASSERT_EQUAL_FLOAT(4.0f, ahead.right_radps);
    const berth_wheels_t left = berth_wheels_from_twist(&config, (berth_twist_t){0.0f, 2.0f});
    TEST_ASSERT_EQUAL_FLOAT(-2.0f, left.left_radps);
    TEST_ASSERT_EQUAL_FLOAT(2.0f, left.right_radps);
    const berth_twist_t twist = berth_twist_from_wheels(&config, (berth_wheels_t){1.0f, 3.0f});
    TEST_ASSERT_EQUAL_FLOAT(0.5f, twist.v_mps);
    TEST_ASSERT_EQUAL_FLOAT(1.0f, twist.omega_radps);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_never_outside_the_speed_limits);
    RUN_TEST(test_never_faster_and_never_reversed);
    RUN_TEST(test_no_limit_acting_leaves_the_bits);
    RUN_TEST(test_tracking_keeps_the_curvature);
    RUN_TEST(test_tracking_gives_away_no_more_than_it_must);
    RUN_TEST(test_avoiding_keeps_omega_and_v_gives_way);
    RUN_TEST(test_flags_name_the_limits_that_acted);
    RUN_TEST(test_each_flag_by_hand);
    RUN_TEST(test_avoiding_with_wheels_too_slow_to_turn);
    RUN_TEST(test_extreme_values);
    RUN_TEST(test_acceleration_limits_hold_with_all_others);
    RUN_TEST(test_acceleration_limits_arrive);
    RUN_TEST(test_idle_acceleration_limits_leave_the_bits);
    RUN_TEST(test_acceleration_flags_by_hand);
    RUN_TEST(test_reset_takes_the_robot_to_stand);
    RUN_TEST(test_wheels_against_double);
    RUN_TEST(test_twist_and_wheels_are_inverse);
    RUN_TEST(test_wheels_by_hand);
    return UNITY_END();
}
