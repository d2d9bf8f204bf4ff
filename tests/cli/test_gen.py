"""berth-gen: its two outputs, its options, and what it refuses."""

import csv
import io
import math
import os
import pathlib
import shutil
import struct
import subprocess

import pytest

GEN = os.environ["BERTH_GEN"]
SOURCE = pathlib.Path(os.environ.get("BERTH_SOURCE_DIR",
                                     pathlib.Path(__file__).resolve().parents[2]))
INCLUDE = SOURCE / "firmware" / "include"
COLUMNS = ["k", "x", "y", "theta", "v", "omega", "k11", "k12", "k13", "k21", "k22", "k23"]


def gen(*arguments, **options):
    return subprocess.run([GEN, *map(str, arguments)], capture_output=True, text=True, timeout=60,
                          **options)


def table(*arguments):
    result = gen(*arguments)
    assert result.returncode == 0, result
    assert result.stderr == ""
    rows = list(csv.reader(io.StringIO(result.stdout)))
    assert rows[0] == COLUMNS
    return rows[1:]


def numbers(*arguments):
    return [[float(cell) for cell in row] for row in table(*arguments)]


# --- csv --------------------------------------------------------------------------------------

def test_circle():
    rows = numbers("circle")
    assert len(rows) == 600
    for k, row in enumerate(rows):
        t = 0.05 * k
        assert row[0] == k
        assert row[1] == pytest.approx(math.cos(0.3 * t), abs=1e-7)
        assert row[2] == pytest.approx(math.sin(0.3 * t), abs=1e-7)
        assert row[4] == pytest.approx(0.3, rel=1e-7)
        assert row[5] == pytest.approx(0.3, rel=1e-7)


def test_eight():
    rows = numbers("eight")
    assert len(rows) == 900
    assert rows[100][1] == pytest.approx(1.8 * math.sin(0.75), abs=1e-6)
    assert rows[100][2] == pytest.approx(1.2 * math.sin(1.5), abs=1e-6)


def test_numbers_keep_the_bits_of_float32():
    for row in table("eight"):
        for cell in row[1:]:
            single = struct.unpack("f", struct.pack("f", float(cell)))[0]
            assert "%.9g" % single == cell


def euler(sample, period):
    v, omega = sample
    return [[1, period * omega, 0], [-period * omega, 1, period * v], [0, 0, 1]]


def gain(samples, period, q, r):
    """K_0 by the recursion in double, for samples [(v, omega), ...] of one horizon."""
    product = lambda a, b: [[sum(x * y for x, y in zip(row, column)) for column in zip(*b)]
                            for row in a]
    transposed = lambda a: [list(row) for row in zip(*a)]
    b = [[period, 0], [0, 0], [0, period]]
    p = [[q[i] if i == j else 0 for j in range(3)] for i in range(3)]
    k = None
    for i, sample in reversed(list(enumerate(samples))):
        a = euler(sample, period)
        bp = product(transposed(b), p)
        s = product(bp, b)
        s[0][0] += r[0]
        s[1][1] += r[1]
        det = s[0][0] * s[1][1] - s[0][1] * s[1][0]
        inverse = [[s[1][1] / det, -s[0][1] / det], [-s[1][0] / det, s[0][0] / det]]
        k = product(inverse, product(bp, a))
        bk = product(b, k)
        closed = [[a[m][n] - bk[m][n] for n in range(3)] for m in range(3)]
        p = product(product(transposed(a), p), closed)
        if i > 0:
            for m in range(3):
                p[m][m] += q[m]
    return k[0] + k[1]


def check_gain(row, expected):
    largest = max(map(abs, expected))
    for found, value in zip(row[6:], expected):
        assert found == pytest.approx(value, abs=1e-4 * largest)


def test_gains_are_those_of_the_design():
    rows = numbers("eight")
    samples = [(row[4], row[5]) for row in rows]
    for k in (0, 1, 250, 700):
        check_gain(rows[k], gain(samples[k:k + 20], 0.05, (10, 40, 1), (0.5, 0.1)))


def test_options_reach_the_gains():
    rows = numbers("--horizon", 7, "--q", "1,2,3", "--r", "0.25,2", "--period", 0.1,
                   "--duration", 5, "eight")
    assert len(rows) == 50
    samples = [(row[4], row[5]) for row in rows]
    check_gain(rows[3], gain(samples[3:10], 0.1, (1, 2, 3), (0.25, 2)))


def test_the_horizon_of_an_open_reference_sees_the_robot_stand():
    rows = numbers("--open", "eight")
    samples = [(row[4], row[5]) for row in rows[-5:]] + [(0, 0)] * 15
    check_gain(rows[-5], gain(samples, 0.05, (10, 40, 1), (0.5, 0.1)))


def test_the_horizon_of_a_closed_reference_sees_the_beginning():
    rows = numbers("--closed", "eight")
    assert len(rows) == round(2 * math.pi / 0.15 / 0.05)
    samples = [(row[4], row[5]) for row in rows[-5:] + rows[:15]]
    check_gain(rows[-5], gain(samples, 0.05, (10, 40, 1), (0.5, 0.1)))


def test_zero_order_hold_differs_a_little():
    hold = numbers("--discretization", "zoh", "eight")[0]
    euler_row = numbers("--discretization", "euler", "eight")[0]
    assert hold[:6] == euler_row[:6]
    assert hold[6:] != euler_row[6:]
    assert hold[6] == pytest.approx(euler_row[6], rel=0.1)


def test_the_last_of_open_and_closed_counts():
    assert len(table("--open", "--closed", "circle")) == 419
    assert len(table("--closed", "--open", "circle")) == 600


def test_whole_laps():
    assert len(table("--closed", "--duration", 41.9, "circle")) == 838
    assert len(table("--closed", "--duration", 20.93, "circle")) == 419
    result = gen("--closed", "--duration", 21, "circle")
    assert result.returncode == 2
    assert "--duration" in result.stderr and "(allowed: 20.943951 within half" in result.stderr


def test_output_to_a_file(tmp_path):
    out = tmp_path / "circle.csv"
    result = gen("-o", out, "circle")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    assert out.read_text() == gen("circle").stdout == gen("-o", "-", "circle").stdout
    assert os.listdir(tmp_path) == ["circle.csv"]


def test_a_full_disk_is_reported():
    with open("/dev/full", "w") as full:
        result = subprocess.run([GEN, "circle"], stdout=full, stderr=subprocess.PIPE, text=True,
                                timeout=60)
    assert result.returncode == 1
    assert "cannot write" in result.stderr


def test_a_missing_folder_is_reported(tmp_path):
    result = gen("-o", tmp_path / "none" / "plan.csv", "circle")
    assert result.returncode == 1
    assert "plan.csv" in result.stderr
    assert os.listdir(tmp_path) == []


# --- references from files --------------------------------------------------------------------

def write_line(path, rows):
    path.write_text("t,x,y,theta,v,omega\n" +
                    "".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


def stop_and_go(path):
    """Stands for 10 samples, drives for 10, stands for 5, drives one, and stands."""
    speeds = [0.0] * 10 + [0.2] * 10 + [0.0] * 5 + [0.2] + [0.0]
    rows, x = [], 0.0
    for k, v in enumerate(speeds):
        rows.append((round(0.1 * k, 3), round(x, 9), 0, 0, v, 0))
        x += 0.1 * v
    return write_line(path, rows)


def test_a_file_has_its_own_period(tmp_path):
    path = write_line(tmp_path / "line.csv", [(0.04 * k, 0.02 * k, 0, 0, 0.5, 0) for k in range(9)])
    rows = numbers(path)
    assert len(rows) == 9
    check_gain(rows[0], gain([(0.5, 0)] * 9 + [(0, 0)] * 11, 0.04, (10, 40, 1), (0.5, 0.1)))
    assert table("--period", 0.04, path) == table(path)
    result = gen("--period", 0.05, path)
    assert result.returncode == 2
    assert "line.csv:3: column 1 (t)" in result.stderr and "(allowed: 0.05" in result.stderr


def test_uncontrollable_samples_are_named(tmp_path):
    result = gen(stop_and_go(tmp_path / "stop.csv"))
    assert result.returncode == 0
    assert result.stderr.startswith("berth-gen: warning: ")
    assert "sample 0-9, 20-24, 26 (" in result.stderr
    assert len(result.stdout.splitlines()) == 28


def test_a_bad_file_is_refused(tmp_path):
    path = write_line(tmp_path / "bad.csv", [(0, 0, 0, 0, 0.5, 0), (0.1, 0.05, "0.0.0", 0, 0.5, 0)])
    out = tmp_path / "out"
    out.mkdir()
    result = gen("-o", out / "gains.csv", path)
    assert result.returncode == 2
    assert "bad.csv:3: column 3 (y): '0.0.0'" in result.stderr
    assert "(allowed: -1000 to 1000)" in result.stderr
    assert os.listdir(out) == []


def test_a_missing_file_is_refused(tmp_path):
    result = gen(tmp_path / "absent.csv")
    assert result.returncode == 2
    assert "absent.csv" in result.stderr and "(allowed: a CSV file)" in result.stderr


# --- C ----------------------------------------------------------------------------------------

WARNINGS = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion",
            "-Wfloat-conversion", "-Wshadow", "-Werror", "-c"]
COMPILERS = [name for name in dict.fromkeys(
    [os.environ.get("BERTH_CC", "cc"), "gcc", "clang-19"]) if shutil.which(name)]


def compile_plan(compiler, source):
    result = subprocess.run([compiler, *WARNINGS, f"-I{INCLUDE}", str(source), "-o",
                             str(source.with_suffix(".o"))], capture_output=True, text=True,
                            timeout=120)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""


@pytest.mark.parametrize("compiler", COMPILERS)
def test_c_compiles_without_warnings(tmp_path, compiler):
    source = tmp_path / "plan.c"
    result = gen("--format", "c", "-o", source, "--closed", "eight")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    assert sorted(os.listdir(tmp_path)) == ["plan.c", "plan.h"]
    compile_plan(compiler, source)
    header = (tmp_path / "plan.h").read_text()
    assert "extern const berth_plan_t berth_plan_eight;" in header
    assert "#ifndef BERTH_PLAN_EIGHT_H" in header


@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_smallest_floats_compile_too(tmp_path, compiler):
    rows = [(0, 1e-40, -1e-45, 0, 0, 1e-39), (0.1, -0.0, 1e-38, 0, 0, 0)]
    path = write_line(tmp_path / "tiny.csv", rows)
    source = tmp_path / "tiny.c"
    result = gen("--format", "c", "-o", source, path)
    assert result.returncode == 0, result
    compile_plan(compiler, source)
    assert "-0.0f" in source.read_text()


def test_a_header_compiles_as_cpp(tmp_path):
    if not shutil.which("g++"):
        pytest.skip("no C++ compiler")
    assert gen("--format", "c", "-o", tmp_path / "plan.c", "circle").returncode == 0
    use = tmp_path / "use.cpp"
    use.write_text('#include "plan.h"\n#include "plan.h"\n'
                   "unsigned count() { return berth_plan_circle.count; }\n")
    subprocess.run(["g++", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{INCLUDE}", "-c",
                    str(use), "-o", str(tmp_path / "use.o")], check=True, timeout=120)


def test_names(tmp_path):
    def symbol(*arguments):
        result = gen("--format", "c", "-o", tmp_path / "p.c", *arguments)
        assert result.returncode == 0, result
        compile_plan(COMPILERS[0], tmp_path / "p.c")
        return (tmp_path / "p.h").read_text().split("berth_plan_t ")[1].split(";")[0]

    rows = [(0, 0, 0, 0, 0.5, 0), (0.1, 0.05, 0, 0, 0.5, 0)]
    assert symbol("circle") == "berth_plan_circle"
    assert symbol("--name", "my_plan2", "circle") == "my_plan2"
    for name, expected in {"aisle 7.csv": "berth_plan_aisle_7", "a.b.csv": "berth_plan_a_b",
                           "plan": "berth_plan_plan", "x_t.csv": "berth_plan_x_t_",
                           "*.csv": "berth_plan__", "\u00e4.csv": "berth_plan___"}.items():
        assert symbol(write_line(tmp_path / name, rows)) == expected
    long = tmp_path / ("n" * 100 + ".csv")
    assert len(symbol(write_line(long, rows))) <= 63


def test_nothing_is_left_when_the_header_cannot_be_written(tmp_path):
    (tmp_path / "plan.h").mkdir()
    result = gen("--format", "c", "-o", tmp_path / "plan.c", "circle")
    assert result.returncode == 1
    assert "plan.h" in result.stderr
    assert os.listdir(tmp_path) == ["plan.h"]


def test_output_is_the_same_every_time(tmp_path):
    texts = set()
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        assert gen("--format", "c", "-o", tmp_path / folder / "plan.c", "eight").returncode == 0
        texts.add((tmp_path / folder / "plan.c").read_text())
    assert len(texts) == 1


# --- the command line -------------------------------------------------------------------------

BAD = {
    "nothing": ([], "(allowed: one of circle, eight, FILE.csv)"),
    "two": (["circle", "eight"], "(allowed: one of circle, eight, FILE.csv)"),
    "unknown-option": (["--speed", "1", "circle"], "--speed"),
    "no-value": (["circle", "--period"], "period"),
    "period-word": (["--period", "fast", "circle"], "--period: 'fast'", "(allowed: 0.001 to 1"),
    "period-range": (["--period", "2", "circle"], "--period: '2'", "(allowed: 0.001 to 1"),
    "period-fraction": (["--period", "0.0033333333", "circle"], "--period:", "microseconds"),
    "period-zero": (["--period", "0", "circle"], "--period:", "(allowed: 0.001 to 1"),
    "duration-negative": (["--duration", "-3", "circle"], "--duration:", "(allowed: 0.001 to"),
    "duration-short": (["--duration", "0.02", "circle"], "duration_s", "(allowed: 1 to 1000000"),
    "duration-long": (["--duration", "60000", "circle"], "duration_s", "(allowed: 1 to 1000000"),
    "duration-of-a-file": (["--duration", "1", "FILE"], "--duration:",
                           "(allowed: with circle and eight)"),
    "horizon-zero": (["--horizon", "0", "circle"], "--horizon: '0'", "1 to 200"),
    "horizon-fraction": (["--horizon", "1.5", "circle"], "--horizon: '1.5'", "1 to 200"),
    "q-two": (["--q", "1,2", "circle"], "--q:", "3 numbers, each 0 to 1000000"),
    "q-four": (["--q", "1,2,3,4", "circle"], "--q:", "3 numbers, each 0 to 1000000"),
    "q-negative": (["--q", "1,2,-3", "circle"], "--q:", "3 numbers, each 0 to 1000000"),
    "q-long": (["--q", "1" * 500, "circle"], "q:", "(allowed: "),
    "r-zero": (["--r", "0,1", "circle"], "--r:", "2 numbers, each 1e-06 to 1000000"),
    "discretization": (["--discretization", "tustin", "circle"], "--discretization:",
                       "euler or zoh"),
    "format": (["--format", "json", "circle"], "--format: 'json'", "csv or c"),
    "name-digit": (["--name", "1plan", "circle"], "--name: '1plan'", "a C identifier"),
    "name-dash": (["--name", "my-plan", "circle"], "--name:", "a C identifier"),
    "name-empty": (["--name", "", "circle"], "--name:", "a C identifier"),
    "name-keyword": (["--name", "switch", "circle"], "--name:", "a C identifier"),
    "name-reserved": (["--name", "_Plan", "circle"], "--name:", "a C identifier"),
    "name-type": (["--name", "berth_plan_t", "circle"], "--name:", "a C identifier"),
    "name-long": (["--name", "a" * 64, "circle"], "--name:", "a C identifier"),
    "c-without-file": (["--format", "c", "circle"], "-o: '-'", "FILE.c"),
    "c-other-file": (["--format", "c", "-o", "plan.cpp", "circle"], "-o: 'plan.cpp'", "FILE.c"),
    "c-hidden-file": (["--format", "c", "-o", ".c", "circle"], "-o: '.c'", "FILE.c"),
    "c-quoted-file": (["--format", "c", "-o", 'a".c', "circle"], "-o:", "FILE.c"),
    "output-empty": (["-o", "", "circle"], "-o: ''", "FILE, or -"),
}


@pytest.mark.parametrize("case", BAD.values(), ids=BAD.keys())
def test_bad_usage(tmp_path, case):
    arguments, *parts = case
    if "FILE" in arguments:
        path = stop_and_go(tmp_path / "stop.csv")
        arguments = [str(path) if argument == "FILE" else argument for argument in arguments]
    cwd = tmp_path / "cwd"
    cwd.mkdir()
    result = gen(*arguments, cwd=cwd)
    assert result.returncode == 2, result
    assert result.stdout == ""
    assert "berth-gen" in result.stderr
    for part in parts:
        assert part in result.stderr, result.stderr
    assert os.listdir(cwd) == []


def test_help_names_every_option():
    result = gen("--help")
    assert (result.returncode, result.stderr) == (0, "")
    for word in ("--period", "--duration", "--horizon", "--q", "--r", "--discretization",
                 "--closed", "--open", "--format", "--name", "-o FILE", "circle", "eight",
                 "FILE.csv", "t,x,y,theta,v,omega", "Exit status"):
        assert word in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 100


def test_version():
    result = gen("--version")
    assert result.returncode == 0
    assert result.stdout.startswith("berth-gen ") and len(result.stdout.split()) == 2
