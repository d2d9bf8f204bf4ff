#include "gen_write.h"

#include "output_file.h"
#include "refusal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

void gen_write_csv(FILE *file, const berth_plan_t *plan) {
    fputs("k,x,y,theta,v,omega,k11,k12,k13,k21,k22,k23\n", file);
    for (uint32_t k = 0; k < plan->count; k++) {
        const berth_sample_t *s = &plan->samples[k];
        fprintf(file, "%u,%.9g,%.9g,%.9g,%.9g,%.9g", (unsigned)k, (double)s->x_m, (double)s->y_m,
                (double)s->theta_rad, (double)s->v_mps, (double)s->omega_radps);
        for (int i = 0; i < 6; i++) {
            fprintf(file, ",%.9g", (double)plan->gains[k].k[i / 3][i % 3]);
        }
        fputc('\n', file);
    }
}

/* --- names ------------------------------------------------------------------------------- */

static bool is_letter(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

static bool is_digit(char c) {
    return c >= '0' && c <= '9';
}

static bool is_keyword(const char *text) {
    static const char *const keywords[] = {
        "auto",     "break",  "case",     "char",   "const",    "continue", "default",  "do",
        "double",   "else",   "enum",     "extern", "float",    "for",      "goto",     "if",
        "inline",   "int",    "long",     "main",   "register", "restrict", "return",   "short",
        "signed",   "sizeof", "static",   "struct", "switch",   "typedef",  "union",    "unsigned",
        "void",     "while",  "volatile", "bool",   "true",     "false",    "NULL",     "asm",
        "template", "class",  "private",  "public", "this",     "new",      "delete",   "namespace",
        "operator", "throw",  "try",      "catch",  "using",    "virtual",  "friend",   "typename",
        "mutable",  "export", "explicit", "typeof", "nullptr",  "alignas",  "constexpr"};
    for (size_t i = 0; i < sizeof keywords / sizeof keywords[0]; i++) {
        if (strcmp(keywords[i], text) == 0) {
            return true;
        }
    }
    return false;
}

bool gen_symbol_good(const char *symbol) {
    const size_t length = strlen(symbol);
    if (length == 0 || length >= GEN_SYMBOL_MAX || !is_letter(symbol[0]) || is_keyword(symbol)) {
        return false;
    }
    for (size_t i = 0; i < length; i++) {
        if (!is_letter(symbol[i]) && !is_digit(symbol[i]) && symbol[i] != '_') {
            return false;
        }
    }
    return length < 2 || strcmp(symbol + length - 2, "_t") != 0;
}

static const char *base_name(const char *path) {
    const char *slash = strrchr(path, '/');
    return slash == NULL ? path : slash + 1;
}

/* Characters that may stand anywhere in C source; the others become '_'. */
static void plain_copy(const char *text, size_t length, const char *also, char *out, size_t size) {
    size_t n = 0;
    for (size_t i = 0; i < length && n + 1 < size; i++) {
        const char c = text[i];
        const bool plain = is_letter(c) || is_digit(c) || strchr(also, c) != NULL;
        out[n] = '_';
        if (plain) {
            out[n] = c;
        }
        n++;
    }
    out[n] = '\0';
}

void gen_symbol_default(const char *source, char out[GEN_SYMBOL_MAX]) {
    static const char prefix[] = "berth_plan_";
    const char *base = base_name(source);
    const char *dot = strrchr(base, '.');
    const size_t length = dot == NULL || dot == base ? strlen(base) : (size_t)(dot - base);
    strcpy(out, prefix);
    /* room for a letter more: a stem that ends in _t gives a reserved name */
    plain_copy(base, length, "", out + sizeof prefix - 1, GEN_SYMBOL_MAX - sizeof prefix);
    if (!gen_symbol_good(out)) {
        strcat(out, "_");
    }
}

/* --- C ----------------------------------------------------------------------------------- */

/* A constant that a compiler reads back to the same bits. */
static void write_float(FILE *file, float value) {
    char text[32];
    if (fpclassify(value) == FP_SUBNORMAL) {
        /* in decimal, compilers warn that it underflows */
        fprintf(file, "%af", (double)value);
        return;
    }
    (void)snprintf(text, sizeof text, "%.9g", (double)value);
    fprintf(file, "%s%s", text, strpbrk(text, ".e") == NULL ? ".0f" : "f");
}

static void write_floats(FILE *file, const float *values, size_t count) {
    fputc('{', file);
    for (size_t i = 0; i < count; i++) {
        fputs(i == 0 ? "" : ", ", file);
        write_float(file, values[i]);
    }
    fputc('}', file);
}

static void write_banner(FILE *file, const berth_plan_t *plan, gen_name_t name) {
    char source[GEN_SYMBOL_MAX];
    const char *base = base_name(name.source);
    plain_copy(base, strlen(base), "._-+", source, sizeof source);
    fprintf(file,
            "/* Plan from %s: %u samples, T = %.9g s, %s; N = %u, %s.\n"
            " * Written by berth-gen " BERTH_VERSION "; generate it again instead of editing. */\n",
            source, (unsigned)plan->count, (double)plan->period_us / 1e6,
            plan->closed ? "closed" : "open", (unsigned)plan->mpc.horizon,
            plan->mpc.discretization == BERTH_DISCRETIZATION_ZOH ? "zero-order hold" : "Euler");
}

static void write_header(FILE *file, const berth_plan_t *plan, gen_name_t name) {
    char guard[GEN_SYMBOL_MAX];
    strcpy(guard, name.symbol);
    for (char *at = guard; *at != '\0'; at++) {
        *at = (char)(*at >= 'a' && *at <= 'z' ? *at - 'a' + 'A' : *at);
    }
    write_banner(file, plan, name);
    fprintf(file,
            "#ifndef %s_H\n#define %s_H\n\n"
            "#include \"berth/reference.h\"\n\n"
            "#ifdef __cplusplus\nextern \"C\" {\n#endif\n\n"
            "extern const berth_plan_t %s;\n\n"
            "#ifdef __cplusplus\n}\n#endif\n\n"
            "#endif\n",
            guard, guard, name.symbol);
}

static void write_samples(FILE *file, const berth_plan_t *plan, const char *symbol) {
    fprintf(file,
            "\n/* x_m, y_m, theta_rad, v_mps, omega_radps */\n"
            "static const berth_sample_t %s_samples[%u] = {\n",
            symbol, (unsigned)plan->count);
    for (uint32_t k = 0; k < plan->count; k++) {
        const berth_sample_t *s = &plan->samples[k];
        const float row[] = {s->x_m, s->y_m, s->theta_rad, s->v_mps, s->omega_radps};
        fputs("    ", file);
        write_floats(file, row, 5);
        fputs(",\n", file);
    }
    fputs("};\n", file);
}

static void write_gains(FILE *file, const berth_plan_t *plan, const char *symbol) {
    fprintf(file,
            "\n/* u = -K e; rows: v, omega; columns: e1, e2, e3 */\n"
            "static const berth_gain_t %s_gains[%u] = {\n",
            symbol, (unsigned)plan->count);
    for (uint32_t k = 0; k < plan->count; k++) {
        fputs("    {{", file);
        write_floats(file, plan->gains[k].k[0], 3);
        fputs(", ", file);
        write_floats(file, plan->gains[k].k[1], 3);
        fputs("}},\n", file);
    }
    fputs("};\n", file);
}

static void write_plan(FILE *file, const berth_plan_t *plan, const char *symbol) {
    const bool zoh = plan->mpc.discretization == BERTH_DISCRETIZATION_ZOH;
    fprintf(file,
            "\nconst berth_plan_t %s = {\n"
            "    .samples = %s_samples,\n"
            "    .gains = %s_gains,\n"
            "    .count = %uu,\n"
            "    .period_us = %uu,\n"
            "    .mpc = {.q = ",
            symbol, symbol, symbol, (unsigned)plan->count, (unsigned)plan->period_us);
    write_floats(file, plan->mpc.q, 3);
    fputs(", .r = ", file);
    write_floats(file, plan->mpc.r, 2);
    fprintf(file,
            ", .horizon = %u,\n"
            "            .discretization = BERTH_DISCRETIZATION_%s},\n"
            "    .closed = %s,\n"
            "    .gain_source = BERTH_GAIN_TABLE,\n"
            "};\n",
            (unsigned)plan->mpc.horizon, zoh ? "ZOH" : "EULER", plan->closed ? "true" : "false");
}

static void write_source(FILE *file, const berth_plan_t *plan, gen_name_t name,
                         const char *header) {
    write_banner(file, plan, name);
    fprintf(file, "#include \"%s\"\n", header);
    write_samples(file, plan, name.symbol);
    write_gains(file, plan, name.symbol);
    write_plan(file, plan, name.symbol);
}

static bool write_both(const char *source_path, const char *header_path, const berth_plan_t *plan,
                       gen_name_t name, scenario_error_t *error) {
    output_file_t source;
    output_file_t header;
    if (!output_file_open(&source, source_path, error)) {
        return false;
    }
    if (!output_file_open(&header, header_path, error)) {
        output_file_discard(&source);
        return false;
    }
    write_source(source.file, plan, name, base_name(header_path));
    write_header(header.file, plan, name);
    if (output_file_commit(&source, error) && output_file_commit(&header, error)) {
        return true;
    }
    output_file_discard(&header);
    return false;
}

bool gen_write_c(const char *path, const berth_plan_t *plan, gen_name_t name,
                 scenario_error_t *error) {
    char *header = strdup(path);
    if (header == NULL) {
        return refuse(error, "out of memory");
    }
    header[strlen(header) - 1] = 'h';
    const bool good = write_both(path, header, plan, name, error);
    free(header);
    return good;
}
