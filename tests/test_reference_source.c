/* Built-in shapes, and CSV references: what is read, and what is refused. */
#include "reference_source.h"
#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define PI 3.14159265358979323846
#define ROWS_MAX 20000

static char path[64];
static reference_samples_t samples;
static scenario_error_t error;

/* Rows of a CSV file in the making. */
typedef struct {
    double t, x, y, theta, v, omega;
} row_t;

static row_t rows[ROWS_MAX];
static size_t row_count;

void setUp(void) {
    strcpy(path, "/tmp/berth_reference_XXXXXX");
    const int fd = mkstemp(path);
    TEST_ASSERT_TRUE(fd >= 0);
    (void)close(fd);
    samples = (reference_samples_t){NULL, 0, 0.0};
    error.text[0] = '\0';
}

void tearDown(void) {
    reference_samples_free(&samples);
    (void)unlink(path);
}

/* --- helpers ----------------------------------------------------------------------------- */

static void write_file(const char *text) {
    FILE *file = fopen(path, "w");
    TEST_ASSERT_NOT_NULL(file);
    fputs(text, file);
    TEST_ASSERT_EQUAL(0, fclose(file));
}

static void write_rows(int digits) {
    FILE *file = fopen(path, "w");
    TEST_ASSERT_NOT_NULL(file);
    fputs("t,x,y,theta,v,omega\n", file);
    for (size_t k = 0; k < row_count; k++) {
        const double cells[] = {rows[k].t,     rows[k].x, rows[k].y,
                                rows[k].theta, rows[k].v, rows[k].omega};
        for (int i = 0; i < 6; i++) {
            char cell[64];
            (void)snprintf(cell, sizeof cell, "%.*f", i == 0 ? 9 : digits, cells[i]);
            fprintf(file, "%s%s", i == 0 ? "" : ",", cell);
        }
        fputc('\n', file);
    }
    TEST_ASSERT_EQUAL(0, fclose(file));
}

static bool read_back(double period_s, bool closed) {
    reference_samples_free(&samples);
    return reference_from_csv(path, period_s, closed, &samples, &error);
}

static void take_shape(shape_t shape, double period_s, double duration_s) {
    reference_samples_t from;
    TEST_ASSERT_TRUE(reference_from_shape(shape, period_s, duration_s, &from, &error));
    TEST_ASSERT_TRUE(from.count <= ROWS_MAX);
    row_count = from.count;
    for (size_t k = 0; k < row_count; k++) {
        const berth_sample_t *s = &from.samples[k];
        rows[k] = (row_t){(double)k * period_s, (double)s->x_m,   (double)s->y_m,
                          (double)s->theta_rad, (double)s->v_mps, (double)s->omega_radps};
    }
    reference_samples_free(&from);
}

/* A unicycle driven with v(t) and omega(t) in fine steps, sampled every period. */
static void drive(double (*v)(double), double (*omega)(double), double period_s, size_t count) {
    const int fine = 1000;
    double x = 0.0;
    double y = 0.0;
    double theta = 0.5;
    row_count = count;
    for (size_t k = 0; k < count; k++) {
        const double t = (double)k * period_s;
        rows[k] = (row_t){t, x, y, theta, v(t), omega(t)};
        for (int i = 0; i < fine; i++) {
            const double dt = period_s / fine;
            const double middle = t + ((double)i + 0.5) * dt;
            theta += 0.5 * dt * omega(middle);
            x += dt * v(middle) * cos(theta);
            y += dt * v(middle) * sin(theta);
            theta += 0.5 * dt * omega(middle);
        }
    }
}

static double steady_v(double t) {
    (void)t;
    return 0.4;
}

static double ramp_v(double t) {
    return t < 1.0 ? 0.8 * t : 0.8;
}

static double wavy_v(double t) {
    return 0.5 + 0.3 * sin(1.5 * t);
}

static double straight(double t) {
    (void)t;
    return 0.0;
}

/* Jumps between two samples, as on a path of lines and arcs. */
static double corners(double t) {
    return fmod(t, 2.03) < 1.0 ? 0.0 : 1.1;
}

static double wavy_omega(double t) {
    return 1.2 * cos(2.0 * t);
}

static void assert_says(const char *part) {
    if (strstr(error.text, part) == NULL) {
        char message[700];
        (void)snprintf(message, sizeof message, "'%s' lacks '%s'", error.text, part);
        TEST_FAIL_MESSAGE(message);
    }
}

static void assert_accepted(double period_s, bool closed) {
    const bool good = read_back(period_s, closed);
    TEST_ASSERT_TRUE_MESSAGE(good, error.text);
}

static void assert_refused(double period_s, bool closed, const char *line, const char *column) {
    char begin[128];
    TEST_ASSERT_FALSE(read_back(period_s, closed));
    TEST_ASSERT_NULL(samples.samples);
    (void)snprintf(begin, sizeof begin, "%s:%s: column ", path, line);
    assert_says(begin);
    assert_says(column);
    assert_says("(allowed");
}

/* --- shapes ------------------------------------------------------------------------------ */

static void test_circle_is_the_circle(void) {
    TEST_ASSERT_TRUE(reference_from_shape(SHAPE_CIRCLE, 0.05, 30.0, &samples, &error));
    TEST_ASSERT_EQUAL_UINT(600, samples.count);
    for (size_t k = 0; k < samples.count; k++) {
        const double t = 0.05 * (double)k;
        const berth_sample_t *s = &samples.samples[k];
        TEST_ASSERT_EQUAL_FLOAT((float)cos(0.3 * t), s->x_m);
        TEST_ASSERT_EQUAL_FLOAT((float)sin(0.3 * t), s->y_m);
        TEST_ASSERT_TRUE(s->v_mps == 0.3f);
        TEST_ASSERT_TRUE(s->omega_radps == 0.3f);
        const double off = remainder((double)s->theta_rad - (0.3 * t + PI / 2), 2.0 * PI);
        TEST_ASSERT_TRUE(fabs(off) < 3e-7);
        TEST_ASSERT_TRUE(fabs((double)s->theta_rad) <= PI + 1e-6);
    }
}

/* v and omega against differences of the poses, which the closed forms know nothing of. */
static void test_eight_moves_as_it_says(void) {
    const double h = 0.001;
    TEST_ASSERT_TRUE(reference_from_shape(SHAPE_EIGHT, 0.05, 45.0, &samples, &error));
    TEST_ASSERT_EQUAL_UINT(900, samples.count);
    for (size_t k = 0; k < samples.count; k++) {
        const double t = 0.05 * (double)k;
        const berth_sample_t *s = &samples.samples[k];
        const double dx = 1.8 * (sin(0.15 * (t + h)) - sin(0.15 * (t - h)));
        const double dy = 1.2 * (sin(0.30 * (t + h)) - sin(0.30 * (t - h)));
        const double before = atan2(1.2 * (sin(0.30 * t) - sin(0.30 * (t - h))),
                                    1.8 * (sin(0.15 * t) - sin(0.15 * (t - h))));
        const double after = atan2(1.2 * (sin(0.30 * (t + h)) - sin(0.30 * t)),
                                   1.8 * (sin(0.15 * (t + h)) - sin(0.15 * t)));
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(1.8 * sin(0.15 * t)), s->x_m);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(1.2 * sin(0.30 * t)), s->y_m);
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)(hypot(dx, dy) / (2.0 * h)), s->v_mps);
        TEST_ASSERT_FLOAT_WITHIN(1e-4f, (float)(remainder(after - before, 2.0 * PI) / h),
                                 s->omega_radps);
        TEST_ASSERT_TRUE(fabs(remainder((double)s->theta_rad - atan2(dy, dx), 2.0 * PI)) < 1e-5);
    }
}

static void test_shapes_round_the_number_of_samples(void) {
    TEST_ASSERT_TRUE(reference_from_shape(SHAPE_CIRCLE, 0.1, 0.96, &samples, &error));
    TEST_ASSERT_EQUAL_UINT(10, samples.count);
    reference_samples_free(&samples);
    TEST_ASSERT_TRUE(reference_from_shape(SHAPE_CIRCLE, 0.1, 0.94, &samples, &error));
    TEST_ASSERT_EQUAL_UINT(9, samples.count);
}

static void test_shapes_refuse_impossible_counts(void) {
    TEST_ASSERT_FALSE(reference_from_shape(SHAPE_CIRCLE, 0.1, 0.04, &samples, &error));
    assert_says("duration_s");
    assert_says("(allowed: 1 to 1000000 samples)");
    TEST_ASSERT_FALSE(reference_from_shape(SHAPE_EIGHT, 0.001, 2000.0, &samples, &error));
    TEST_ASSERT_FALSE(reference_from_shape(SHAPE_EIGHT, 0.05, (double)NAN, &samples, &error));
    TEST_ASSERT_NULL(samples.samples);
}

static void test_laps(void) {
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 20.943951f, (float)reference_lap_s(SHAPE_CIRCLE));
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 41.887902f, (float)reference_lap_s(SHAPE_EIGHT));
}

/* --- CSV that is good -------------------------------------------------------------------- */

static void test_csv_gives_back_the_bits_of_a_shape(void) {
    reference_samples_t shape;
    take_shape(SHAPE_EIGHT, 0.05, 45.0);
    TEST_ASSERT_TRUE(reference_from_shape(SHAPE_EIGHT, 0.05, 45.0, &shape, &error));
    write_rows(17);
    assert_accepted(0.05, false);
    TEST_ASSERT_EQUAL_UINT(shape.count, samples.count);
    TEST_ASSERT_EQUAL_MEMORY(shape.samples, samples.samples, shape.count * sizeof *shape.samples);
    reference_samples_free(&shape);
}

static void test_shapes_are_consistent_at_every_period(void) {
    const double periods[] = {0.001, 0.01, 0.05, 0.2, 0.5};
    for (size_t i = 0; i < sizeof periods / sizeof periods[0]; i++) {
        const double duration = periods[i] < 0.01 ? 15.0 : 60.0;
        take_shape(SHAPE_CIRCLE, periods[i], duration);
        write_rows(9);
        assert_accepted(periods[i], false);
        take_shape(SHAPE_EIGHT, periods[i], duration);
        write_rows(9);
        assert_accepted(periods[i], false);
    }
}

static void test_shapes_close_at_every_period(void) {
    const double periods[] = {0.01, 0.05, 0.07, 0.2, 0.5};
    for (size_t i = 0; i < sizeof periods / sizeof periods[0]; i++) {
        take_shape(SHAPE_CIRCLE, periods[i], reference_lap_s(SHAPE_CIRCLE));
        write_rows(9);
        assert_accepted(periods[i], true);
        take_shape(SHAPE_EIGHT, periods[i], reference_lap_s(SHAPE_EIGHT));
        write_rows(9);
        assert_accepted(periods[i], true);
    }
}

static void test_references_of_every_making_are_accepted(void) {
    double (*const speeds[])(double) = {steady_v, ramp_v, wavy_v};
    double (*const rates[])(double) = {straight, corners, wavy_omega};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            drive(speeds[i], rates[j], 0.05, 200);
            write_rows(5);
            assert_accepted(0.05, false);
            drive(speeds[i], rates[j], 0.2, 50);
            write_rows(5);
            assert_accepted(0.2, false);
        }
    }
}

/* v and omega as what is held until the next row. */
static void test_held_values_are_accepted(void) {
    drive(wavy_v, wavy_omega, 0.1, 100);
    for (size_t k = 0; k + 1 < row_count; k++) {
        const double turn = rows[k + 1].theta - rows[k].theta;
        const double way = hypot(rows[k + 1].x - rows[k].x, rows[k + 1].y - rows[k].y);
        rows[k].omega = turn / 0.1;
        rows[k].v = way / 0.1;
    }
    row_count--;
    write_rows(6);
    assert_accepted(0.1, false);
}

static void test_the_first_and_last_rows_may_stand(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 5.0);
    rows[0].v = rows[0].omega = 0.0;
    rows[row_count - 1].v = rows[row_count - 1].omega = 0.0;
    write_rows(9);
    assert_accepted(0.05, false);
    rows[50].v = rows[50].omega = 0.0;
    write_rows(9);
    TEST_ASSERT_FALSE(read_back(0.05, false));
    assert_says(":52: column 5 (v)");
}

static void test_the_period_may_be_the_files_own(void) {
    take_shape(SHAPE_CIRCLE, 0.04, 2.0);
    write_rows(9);
    assert_accepted(0.0, false);
    TEST_ASSERT_TRUE(samples.period_s == 0.04);
    TEST_ASSERT_EQUAL_UINT(50, samples.count);
}

static void test_headings_may_count_turns(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 60.0);
    for (size_t k = 0; k < row_count; k++) {
        rows[k].theta = 0.3 * rows[k].t + PI / 2;
    }
    write_rows(9);
    assert_accepted(0.05, false);
    for (size_t k = 0; k < samples.count; k++) {
        TEST_ASSERT_TRUE(fabs((double)samples.samples[k].theta_rad) <= PI + 1e-6);
        const double off = remainder((double)samples.samples[k].theta_rad - rows[k].theta, 2 * PI);
        TEST_ASSERT_TRUE(fabs(off) < 3e-7);
    }
}

static void test_line_ends_and_a_last_blank_line(void) {
    write_file("t,x,y,theta,v,omega\r\n0,0,0,0,0.1,0\r\n0.1,0.01,0,0,0.1,0\r\n");
    assert_accepted(0.1, false);
    write_file("t,x,y,theta,v,omega\n0,0,0,0,0.1,0\n0.1,0.01,0,0,0.1,0");
    assert_accepted(0.1, false);
    write_file("t,x,y,theta,v,omega\n0,0,0,0,0.1,0\n0.1,0.01,0,0,0.1,0\n\n");
    assert_accepted(0.1, false);
    TEST_ASSERT_EQUAL_UINT(2, samples.count);
}

static void test_one_row_with_a_period(void) {
    write_file("t,x,y,theta,v,omega\n0,1,2,3,0.5,0.25\n");
    assert_accepted(0.1, false);
    TEST_ASSERT_EQUAL_UINT(1, samples.count);
    TEST_ASSERT_TRUE(samples.samples[0].theta_rad == 3.0f);
    TEST_ASSERT_FALSE(read_back(0.0, false));
    assert_says("(allowed: at least 2 rows)");
}

/* --- CSV that is inconsistent ------------------------------------------------------------ */

typedef void (*damage_t)(size_t k);

static void more_v(size_t k) {
    rows[k].v *= 1.1;
}

static void less_v(size_t k) {
    rows[k].v *= 0.9;
}

static void more_omega(size_t k) {
    rows[k].omega *= 1.1;
}

static void less_omega(size_t k) {
    rows[k].omega *= 0.9;
}

static void damage_all(damage_t damage) {
    for (size_t k = 0; k < row_count; k++) {
        damage(k);
    }
}

/* 10 % off in every row, or in one row anywhere, the ends included. */
static void test_ten_percent_are_caught(void) {
    const damage_t damages[] = {more_v, less_v, more_omega, less_omega};
    const size_t places[] = {0, 1, 57, 98, 99};
    for (size_t i = 0; i < 4; i++) {
        const char *column = i < 2 ? "column 5 (v)" : "column 6 (omega)";
        take_shape(SHAPE_CIRCLE, 0.05, 5.0);
        damage_all(damages[i]);
        write_rows(9);
        assert_refused(0.05, false, "2", column);
        for (size_t j = 0; j < sizeof places / sizeof places[0]; j++) {
            char line[24];
            take_shape(SHAPE_CIRCLE, 0.05, 5.0);
            damages[i](places[j]);
            write_rows(9);
            (void)snprintf(line, sizeof line, "%zu", places[j] + 2);
            assert_refused(0.05, false, line, column);
        }
    }
}

static void test_ten_percent_are_caught_on_the_eight(void) {
    const damage_t damages[] = {more_v, less_v, more_omega, less_omega};
    for (size_t i = 0; i < 4; i++) {
        take_shape(SHAPE_EIGHT, 0.2, 45.0);
        damage_all(damages[i]);
        write_rows(9);
        TEST_ASSERT_FALSE(read_back(0.2, false));
        assert_says(i < 2 ? "(v)" : "(omega)");
    }
}

static void test_a_wrong_pose_is_caught(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 5.0);
    rows[40].y += 0.003; /* along the motion there, a fifth of a step */
    rows[40].x -= 0.002;
    write_rows(9);
    TEST_ASSERT_FALSE(read_back(0.05, false));
    assert_says(":42: column");
}

static void test_a_leap_is_caught(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 5.0);
    for (size_t k = 50; k < row_count; k++) {
        rows[k].x += 0.5;
    }
    write_rows(9);
    TEST_ASSERT_FALSE(read_back(0.05, false));
    assert_says(":52: column");
}

static void test_a_heading_across_the_path_is_caught(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 5.0);
    for (size_t k = 0; k < row_count; k++) {
        rows[k].theta += 0.1;
    }
    write_rows(9);
    assert_refused(0.05, false, "3", "column 4 (theta)");
}

static void test_reverse_is_forward_with_the_wrong_sign(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 5.0);
    for (size_t k = 0; k < row_count; k++) {
        rows[k].theta = remainder(rows[k].theta + PI, 2.0 * PI);
    }
    write_rows(9);
    assert_refused(0.05, false, "2", "column 5 (v)");
    for (size_t k = 0; k < row_count; k++) {
        rows[k].v = -rows[k].v;
    }
    write_rows(9);
    assert_accepted(0.05, false);
}

static void test_what_does_not_close_is_caught(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 15.0);
    write_rows(9);
    assert_accepted(0.05, false);
    assert_refused(0.05, true, "301", "column 2 (x)");
}

/* --- times ------------------------------------------------------------------------------- */

static void test_gaps_and_wrong_periods_are_caught(void) {
    take_shape(SHAPE_CIRCLE, 0.05, 5.0);
    write_rows(9);
    assert_refused(0.1, false, "3", "column 1 (t)");
    assert_says("0.1 within 1e-06");
    rows[30].t += 2e-6;
    write_rows(9);
    assert_refused(0.05, false, "32", "column 1 (t)");
    rows[30].t -= 1.5e-6;
    write_rows(9);
    assert_accepted(0.05, false);
    memmove(&rows[30], &rows[31], (row_count - 31) * sizeof rows[0]);
    row_count--;
    write_rows(9);
    assert_refused(0.05, false, "32", "column 1 (t)");
    rows[0].t = 0.001;
    write_rows(9);
    assert_refused(0.05, false, "2", "column 1 (t)");
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_circle_is_the_circle);
    RUN_TEST(test_eight_moves_as_it_says);
    RUN_TEST(test_shapes_round_the_number_of_samples);
    RUN_TEST(test_shapes_refuse_impossible_counts);
    RUN_TEST(test_laps);
    RUN_TEST(test_csv_gives_back_the_bits_of_a_shape);
    RUN_TEST(test_shapes_are_consistent_at_every_period);
    RUN_TEST(test_shapes_close_at_every_period);
    RUN_TEST(test_references_of_every_making_are_accepted);
    RUN_TEST(test_held_values_are_accepted);
    RUN_TEST(test_the_first_and_last_rows_may_stand);
    RUN_TEST(test_the_period_may_be_the_files_own);
    RUN_TEST(test_headings_may_count_turns);
    RUN_TEST(test_line_ends_and_a_last_blank_line);
    RUN_TEST(test_one_row_with_a_period);
    RUN_TEST(test_ten_percent_are_caught);
    RUN_TEST(test_ten_percent_are_caught_on_the_eight);
    RUN_TEST(test_a_wrong_pose_is_caught);
    RUN_TEST(test_a_leap_is_caught);
    RUN_TEST(test_a_heading_across_the_path_is_caught);
    RUN_TEST(test_reverse_is_forward_with_the_wrong_sign);
    RUN_TEST(test_what_does_not_close_is_caught);
    RUN_TEST(test_gaps_and_wrong_periods_are_caught);
    return UNITY_END();
}
