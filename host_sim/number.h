/* Numbers as text: strict reading, exact writing, and the wording of ranges.
 *
 * Reading takes the whole string or nothing: an optional sign, decimal digits with at most one
 * point, an optional decimal exponent. No hexadecimal, no "nan" or "inf", no blanks, no unit, and
 * the value must be finite. The point is '.'; under a locale with another decimal sign, numbers
 * with a point are refused rather than misread (the programs here keep the C locale).
 */
#ifndef HOST_SIM_NUMBER_H
#define HOST_SIM_NUMBER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* How a text is called that number_parse refuses: "'2.7m' " NUMBER_REFUSED. */
#define NUMBER_REFUSED "is not a finite decimal number"

/* Room that number_text and number_range_text need. */
#define NUMBER_TEXT_MAX 32
#define NUMBER_RANGE_TEXT_MAX 80

bool number_parse(const char *text, double *value);

/* An integer from 0 to maximum in plain decimal digits: -1 and 1e3 are not taken for something
 * else. *value is only written to on success. */
bool number_parse_count(const char *text, uint64_t maximum, uint64_t *value);

/* Exactly count numbers with commas between them; blanks around each are skipped. values is only
 * written to on success. count <= NUMBER_LIST_MAX. */
#define NUMBER_LIST_MAX 8
bool number_parse_list(const char *text, double *values, size_t count);

/* The shortest of %.15g, %.16g and %.17g that reads back to the same bits. */
void number_text(double value, char *out, size_t size);

/* "MINIMUM to MAXIMUM"; "at least MINIMUM" when the maximum is infinite. */
void number_range_text(double minimum, double maximum, char *out, size_t size);

#endif
