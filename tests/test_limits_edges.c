/* Limits at their edges, by hand: numbers that are sums of powers of two, so that what is compared
 * is exact. */
#include "support.h"

#include "unity.h"

#define PERIOD 0.25f

static berth_limits_config_t config;
static berth_limits_t limits;

/* A track of 4 m: omega counts twice at the rim. The wheels do 1 m/s. */
void setUp(void) {
    config = (berth_limits_config_t){
        .wheel_radius_m = 1.0f,
        .track_m = 4.0f,
        .v_max_mps = 1.0f,
        .omega_max_radps = 1.0f,
        .wheel_speed_max_radps = 1.0f,
        .a_max_mps2 = 1.0f,
        .alpha_max_radps2 = 1.0f,
    };
}

void tearDown(void) {}

/* From one command towards another in one period. */
static void expect_step(berth_twist_t last, berth_twist_t asked, berth_twist_t given,
                        uint8_t limited) {
    limits.last = last;
    berth_twist_t command = asked;
    TEST_ASSERT_EQUAL_HEX8(limited, berth_limits_apply(&limits, &config, PERIOD, false, &command));
    TEST_ASSERT_EQUAL_FLOAT(given.v_mps, command.v_mps);
    TEST_ASSERT_EQUAL_FLOAT(given.omega_radps, command.omega_radps);
}

/* Braking at 1 m/s^2 while the turn grows by 1 rad/s^2: the turn takes what braking leaves. */
static void test_the_turn_gives_way_to_braking(void) {
    const uint8_t all = BERTH_LIMITED_A | BERTH_LIMITED_ALPHA | BERTH_LIMITED_WHEEL;
    for (int side = -1; side <= 1; side += 2) {
        const float sign = (float)side;
        expect_step((berth_twist_t){1.0f, 0.0f}, (berth_twist_t){0.0f, sign * 0.5f},
                    (berth_twist_t){0.75f, sign * 0.125f}, all);
        expect_step((berth_twist_t){-1.0f, 0.0f}, (berth_twist_t){0.0f, sign * 0.5f},
                    (berth_twist_t){-0.75f, sign * 0.125f}, all);
    }
}

/* The turn ends slowly while v grows: v takes what the turn leaves. */
static void test_v_gives_way_to_a_turn_that_ends(void) {
    config.alpha_max_radps2 = 0.25f;
    const uint8_t all = BERTH_LIMITED_A | BERTH_LIMITED_ALPHA | BERTH_LIMITED_WHEEL;
    expect_step((berth_twist_t){0.0f, 0.5f}, (berth_twist_t){1.0f, 0.0f},
                (berth_twist_t){0.125f, 0.4375f}, all);
    expect_step((berth_twist_t){0.0f, -0.5f}, (berth_twist_t){-1.0f, 0.0f},
                (berth_twist_t){-0.125f, -0.4375f}, all);
}

/* 0.75 m/s and 0.125 rad/s are just what the wheels can do. */
static void test_just_the_wheels_speed_is_no_limit(void) {
    config.alpha_max_radps2 = 0.5f;
    expect_step((berth_twist_t){1.0f, 0.0f}, (berth_twist_t){0.0f, 0.5f},
                (berth_twist_t){0.75f, 0.125f}, BERTH_LIMITED_A | BERTH_LIMITED_ALPHA);
}

/* On a narrow track the same turn needs less of the wheels. */
static void test_within_the_wheels_speed_nothing_gives_way(void) {
    config.track_m = 0.5f;
    expect_step((berth_twist_t){0.25f, 0.0f}, (berth_twist_t){0.75f, 0.5f},
                (berth_twist_t){0.5f, 0.25f}, BERTH_LIMITED_A | BERTH_LIMITED_ALPHA);
}

/* At the wheels' limit nothing is left for v, and 0 of either sign stays as it is. */
static void test_zeros_keep_their_sign(void) {
    for (int side = 0; side < 2; side++) {
        const float zero = side == 0 ? 0.0f : -0.0f;
        berth_limits_reset(&limits);
        berth_twist_t command = {zero, 0.5f};
        config.alpha_max_radps2 = 0.0f;
        TEST_ASSERT_EQUAL_HEX8(0, berth_limits_apply(&limits, &config, PERIOD, true, &command));
        TEST_ASSERT_TRUE(support_same_bits(zero, command.v_mps));
        TEST_ASSERT_EQUAL_FLOAT(0.5f, command.omega_radps);
    }
}

static void test_ranges_of_the_configuration(void) {
    const struct {
        float *value;
        float least, most;
        berth_field_t field;
        bool zero;
    } ranges[] = {
        {&config.wheel_radius_m, 0.001f, 10.0f, BERTH_FIELD_WHEEL_RADIUS, false},
        {&config.track_m, 0.01f, 10.0f, BERTH_FIELD_TRACK, false},
        {&config.v_max_mps, 0.001f, 100.0f, BERTH_FIELD_V_MAX, false},
        {&config.omega_max_radps, 0.001f, 100.0f, BERTH_FIELD_OMEGA_MAX, false},
        {&config.wheel_speed_max_radps, 0.001f, 10000.0f, BERTH_FIELD_WHEEL_SPEED_MAX, true},
        {&config.a_max_mps2, 0.001f, 1000.0f, BERTH_FIELD_A_MAX, true},
        {&config.alpha_max_radps2, 0.001f, 1000.0f, BERTH_FIELD_ALPHA_MAX, true},
    };
    const berth_limits_config_t good = config;
    for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++) {
        const float values[] = {ranges[i].least, ranges[i].most, 0.0f, 0.5f * ranges[i].least,
                                1.001f * ranges[i].most};
        for (size_t k = 0; k < sizeof values / sizeof values[0]; k++) {
            berth_refusal_t refusal = {.index = 77};
            *ranges[i].value = values[k];
            if (k < 2 || (k == 2 && ranges[i].zero)) {
                TEST_ASSERT_EQUAL_INT(BERTH_OK, berth_limits_check(&config, &refusal));
                continue;
            }
            TEST_ASSERT_EQUAL_INT(BERTH_ERROR_CONFIG, berth_limits_check(&config, &refusal));
            TEST_ASSERT_EQUAL_INT(ranges[i].field, refusal.field);
            TEST_ASSERT_EQUAL_UINT32(0, refusal.index);
            TEST_ASSERT_EQUAL_FLOAT(values[k], refusal.value);
            TEST_ASSERT_EQUAL_FLOAT(ranges[i].least, refusal.minimum);
            TEST_ASSERT_EQUAL_FLOAT(ranges[i].most, refusal.maximum);
        }
        config = good;
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_turn_gives_way_to_braking);
    RUN_TEST(test_v_gives_way_to_a_turn_that_ends);
    RUN_TEST(test_just_the_wheels_speed_is_no_limit);
    RUN_TEST(test_within_the_wheels_speed_nothing_gives_way);
    RUN_TEST(test_zeros_keep_their_sign);
    RUN_TEST(test_ranges_of_the_configuration);
    return UNITY_END();
}
