/* berth-gen's CSV references: any bytes as a file. What must hold: a refusal names the file, what
 * is accepted passes as a plan, and written out again it is accepted with the same samples. The
 * readers of numbers are tried with the same bytes.
 */
#include "fuzz.h"
#include "input.h"
#include "memory_file.h"
#include "number.h"
#include "reference_source.h"

static reference_samples_t load(const char *text, size_t size, double period_s, bool closed,
                                bool *good) {
    const memory_file_t file = memory_file_open();
    reference_samples_t samples;
    scenario_error_t error = {""};
    memory_file_add(&file, text, size);
    *good = reference_from_csv(file.path, period_s, closed, &samples, &error);
    FUZZ_CHECK(*good || strstr(error.text, file.path) == error.text, "a refusal names the file");
    FUZZ_CHECK(*good || (samples.samples == NULL && samples.count == 0), "nothing is left over");
    memory_file_close(&file);
    return samples;
}

static void check_samples(const reference_samples_t *samples) {
    berth_refusal_t refusal;
    const uint32_t period_us = (uint32_t)(samples->period_s * 1.0e6 + 0.5);
    const berth_plan_t plan = {
        .samples = samples->samples,
        .count = (uint32_t)samples->count,
        .period_us = period_us,
        .mpc = {.q = {1.0f, 1.0f, 1.0f}, .r = {1.0f, 1.0f}, .horizon = 1},
        .gain_source = BERTH_GAIN_ONLINE,
    };
    FUZZ_CHECK(berth_plan_check(&plan, &refusal) == BERTH_OK, "accepted samples make a plan");
}

/* The samples as text, %.9g, which reads back to the same float32. */
static char *print(const reference_samples_t *samples, size_t *size) {
    char *text = NULL;
    FILE *file = open_memstream(&text, size);
    FUZZ_CHECK(file != NULL, "there is memory");
    (void)fprintf(file, "t,x,y,theta,v,omega\n");
    for (size_t k = 0; k < samples->count; k++) {
        const berth_sample_t *sample = &samples->samples[k];
        (void)fprintf(file, "%.9g,%.9g,%.9g,%.9g,%.9g,%.9g\n", (double)k * samples->period_s,
                      (double)sample->x_m, (double)sample->y_m, (double)sample->theta_rad,
                      (double)sample->v_mps, (double)sample->omega_radps);
    }
    FUZZ_CHECK(fclose(file) == 0, "there is memory");
    return text;
}

/* Rounded to float32, values at the very edge of what is consistent may be refused; those that are
 * accepted are the same. */
static void check_again(const reference_samples_t *samples, double period_s, bool closed) {
    size_t size = 0;
    bool good = false;
    char *text = print(samples, &size);
    reference_samples_t again = load(text, size, period_s, closed, &good);
    free(text);
    if (good) {
        FUZZ_CHECK(again.count == samples->count &&
                       memcmp(again.samples, samples->samples,
                              samples->count * sizeof *samples->samples) == 0,
                   "what is written reads back");
    }
    reference_samples_free(&again);
}

static void check_numbers(const char *text) {
    double value = -1.0;
    double values[3] = {-1.0, -1.0, -1.0};
    uint64_t number = 7;
    char shown[NUMBER_TEXT_MAX];
    if (number_parse(text, &value)) {
        double again;
        FUZZ_CHECK(isfinite(value), "a number is finite");
        number_text(value, shown, sizeof shown);
        FUZZ_CHECK(number_parse(shown, &again) && memcmp(&again, &value, sizeof again) == 0,
                   "a number survives");
    } else {
        FUZZ_CHECK(value == -1.0, "what is refused changes nothing");
    }
    FUZZ_CHECK(number_parse_count(text, 1000, &number) ? number <= 1000 : number == 7,
               "a count is in range");
    if (number_parse_list(text, values, 3)) {
        FUZZ_CHECK(isfinite(values[0]) && isfinite(values[1]) && isfinite(values[2]),
                   "a list is of numbers");
    } else {
        FUZZ_CHECK(values[0] == -1.0, "a refused list changes nothing");
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < 1) {
        return 0;
    }
    const char *bytes = (const char *)data + 1;
    if (data[0] == '#') {
        char *text = strndup(bytes, size - 1);
        FUZZ_CHECK(text != NULL, "there is memory");
        check_numbers(text);
        free(text);
        return 0;
    }
    const bool closed = (data[0] & 1u) != 0;
    const double period_s = (data[0] & 2u) != 0 ? 0.05 : 0.0;
    bool good = false;
    reference_samples_t samples = load(bytes, size - 1, period_s, closed, &good);
    if (good) {
        check_samples(&samples);
        check_again(&samples, period_s, closed);
    }
    reference_samples_free(&samples);
    return 0;
}
