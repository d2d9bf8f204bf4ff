"""The port guide, hal/porting.md: what it names exists, and its code compiles and does what it says."""

import re

import pytest

from tree import FIRMWARE, ROOT, run

PAGE = ROOT / "hal" / "porting.md"
TEXT = PAGE.read_text(encoding="utf-8")
FLAGS = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow",
         "-Wdouble-promotion", "-Wfloat-conversion", "-Werror", "-ffp-contract=off"]
NO_SYMBOLS = {"berth_hal", "berth_board_", "berth_cpu", "board_check"}
TOP = {"firmware", "hal", "host_sim", "tests", "tools"}
COMPILERS = ["gcc", "clang-19"]

# What a port has of its own.
PORT = """
#ifndef MY_PORT_H
#define MY_PORT_H
#include "berth_hal/can.h"
#include "berth_hal/clock.h"
#include <stdbool.h>
#include <stdint.h>
void my_can_interrupt(void);
bool my_can_fetch(berth_can_frame_t *frame);
bool my_can_is_on(void);
berth_can_outcome_t my_receive(void *context, berth_can_frame_t *frame);
uint32_t my_rx_lost(void);
int64_t my_now_us(void);
uint32_t my_mask_interrupts(void);
void my_restore_interrupts(uint32_t before);
uint32_t my_timer_us(void);
berth_clock_t my_clock(void);
berth_can_t my_can(const berth_can_filter_t *filters, uint32_t count);
void my_refuse(const char *error, const char *field);
void my_watchdog_start(void);
void my_watchdog_feed(void);
#endif
"""

# The ring and the clock, by a controller and a timer of the test's own.
PARTS = """
#include "my_port.h"
#include <stdio.h>
#include <stdlib.h>
static uint32_t waiting, fetched, timer, masked;
static bool on = true;
#define CHECK(x) do { if (!(x)) { printf("line %d: %s\\n", __LINE__, #x); exit(1); } } while (0)
bool my_can_fetch(berth_can_frame_t *frame) {
    *frame = (berth_can_frame_t){.id = fetched};
    fetched += waiting > 0;
    return waiting-- > 0 || (waiting = 0);
}
bool my_can_is_on(void) { return on; }
uint32_t my_mask_interrupts(void) { return masked++; }
void my_restore_interrupts(uint32_t before) { CHECK(before + 1 == masked); masked = before; }
uint32_t my_timer_us(void) { CHECK(masked > 0); return timer; }

static void take(uint32_t id, int64_t time_us) {
    berth_can_frame_t frame;
    CHECK(my_receive(NULL, &frame) == BERTH_CAN_DONE);
    CHECK(frame.id == id && frame.time_us == time_us);
}

int main(void) {
    berth_can_frame_t frame = {.id = 77};
    CHECK(my_receive(NULL, &frame) == BERTH_CAN_AGAIN && frame.id == 77);
    on = false;
    CHECK(my_receive(NULL, &frame) == BERTH_CAN_FAILED && frame.id == 77);
    for (uint32_t round = 0, id = 0; round < 1000; round++) {
        timer = round;
        waiting = 1 + round % 64;
        my_can_interrupt();
        for (uint32_t i = 0; i < 1 + round % 64; i++) {
            take(id++, round);
        }
        CHECK(my_receive(NULL, &frame) == BERTH_CAN_FAILED);
    }
    CHECK(my_rx_lost() == 0);
    const uint32_t first = fetched;
    waiting = 70;
    my_can_interrupt();
    CHECK(my_rx_lost() == 6);
    for (uint32_t i = 0; i < 64; i++) {
        take(first + i, 999);
    }
    CHECK(my_receive(NULL, &frame) == BERTH_CAN_FAILED);
    int64_t last = my_now_us();
    for (int i = 0; i < 10; i++) {
        timer += UINT32_C(0x90000000);
        const int64_t now = my_now_us();
        CHECK(now - last == INT64_C(0x90000000));
        last = now;
    }
    CHECK(masked == 0);
    puts("good");
    return 0;
}
"""

# The loop, on hal/blank's bus and a clock that is there at once.
LOOP = """
#include "blank.h"
#include "my_port.h"
#include <stdio.h>
#include <stdlib.h>
static int64_t time_us;
static int started, fed;
static int64_t now_us(void *context) { (void)context; return time_us; }
static void sleep_until_us(void *context, int64_t deadline_us) {
    (void)context;
    time_us = deadline_us > time_us ? deadline_us : time_us + 1;
    if (time_us > 10000000) {
        printf("%d feedings\\n", fed);
        exit(started == 1 ? 0 : 1);
    }
}
berth_clock_t my_clock(void) {
    static const berth_clock_api_t api = {now_us, sleep_until_us};
    return (berth_clock_t){&api, NULL};
}
berth_can_t my_can(const berth_can_filter_t *filters, uint32_t count) {
    uint32_t drives = 0;
    for (uint32_t i = 0; i < count; i++) {
        drives |= filters[i].extended ? 0u : 1u << (filters[i].id >> 5);
    }
    if (drives != 6u) {
        exit(3);
    }
    return blank_can();
}
void my_refuse(const char *error, const char *field) { printf("%s: %s\\n", error, field); }
void my_watchdog_start(void) { started++; }
void my_watchdog_feed(void) { fed++; }
"""


def blocks():
    return re.findall(r"^```c\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def build(compiler, folder, sources, *more):
    names = []
    for name, text in sources.items():
        (folder / name).write_text(text)
        names += [folder / name] if name.endswith(".c") else []
    program = folder / "program"
    run(compiler, *FLAGS, f"-I{folder}", f"-I{FIRMWARE}/include", f"-I{ROOT}/hal/include",
        f"-I{ROOT}/hal/blank", *names, *more, "-lm", "-o", program)
    return run(program)


def plan(folder):
    """A plan as berth-gen writes it, small, with gains computed on the board."""
    (folder / "drive_plan.h").write_text(
        '#include "berth/reference.h"\nextern const berth_plan_t drive_plan;\n')
    return """#include "drive_plan.h"
static const berth_sample_t samples[2] = {{0.0f, 0.0f, 0.0f, 0.2f, 0.0f}, {0.01f, 0.0f, 0.0f, 0.2f, 0.0f}};
const berth_plan_t drive_plan = {
    .samples = samples, .gains = NULL, .count = 2u, .period_us = 50000u,
    .mpc = {.q = {10.0f, 40.0f, 1.0f}, .r = {0.5f, 0.1f}, .horizon = 20,
            .discretization = BERTH_DISCRETIZATION_EULER},
    .gain_source = BERTH_GAIN_ONLINE};
"""


def test_the_page_has_three_pieces_of_code():
    assert [("my_can_interrupt" in block, "my_timer_us" in block, "int main" in block)
            for block in blocks()] == [(True, False, False), (False, True, False), (False, False, True)]


@pytest.mark.parametrize("compiler", COMPILERS)
def test_ring_and_clock_do_what_they_say(compiler, tmp_path):
    ring, clock, _ = blocks()
    sources = {"my_port.h": PORT, "ring.c": ring, "clock.c": clock, "parts.c": PARTS}
    assert build(compiler, tmp_path, sources) == "good\n"


@pytest.mark.parametrize("compiler", COMPILERS)
def test_loop_feeds_the_watchdog_each_control_step(compiler, tmp_path):
    sources = {"my_port.h": PORT, "main.c": blocks()[2], "loop.c": LOOP, "plan.c": plan(tmp_path)}
    told = build(compiler, tmp_path, sources, *sorted((FIRMWARE / "src").glob("*.c")),
                 ROOT / "hal" / "blank" / "blank.c")
    assert told == "201 feedings\n", "10 s of 50 ms, and the first one"


def test_links_lead_somewhere():
    links = re.findall(r"\]\((?!http)([^)#]+)\)", TEXT)
    assert len(links) >= 12
    assert [link for link in links if not (PAGE.parent / link).is_file()] == []


def test_named_files_exist():
    """Words in code type that begin with a folder of the tree; but not images, which are built."""
    words = {word for word in re.findall(r"`([\w./-]+)`", TEXT) if word.split("/")[0] in TOP}
    words |= set(re.findall(r"`(\w+\.(?:json|md))`", TEXT))
    assert len(words) >= 20
    assert [word for word in sorted(words) if not (ROOT / word).exists()] == []


def test_named_symbols_exist():
    """Functions, types, macros and fields of Berth that the page names."""
    sources = "".join(path.read_text() for folder in ("firmware", "hal", "tools/cmake")
                      for path in (ROOT / folder).rglob("*") if path.suffix in {".h", ".cmake"})
    names = set(re.findall(r"\b(?:berth|board|BERTH)_\w+", TEXT)) - NO_SYMBOLS
    names |= {"period_late_us", "following_radps", "latest_us", "missed", "foreign", "send_again"}
    assert len(names) > 30
    assert [name for name in sorted(names) if not re.search(rf"\b{name}\b", sources)] == []


def test_presets_and_targets_exist():
    presets = (ROOT / "CMakePresets.json").read_text()
    for preset in set(re.findall(r"--preset ([\w-]+)", TEXT)):
        assert f'"name": "{preset}"' in presets
    boards = (FIRMWARE / "boards" / "example" / "CMakeLists.txt").read_text()
    assert "example-${board}" in boards and "example-mps2-an386" in TEXT
