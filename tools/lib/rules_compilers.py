"""clang-tidy, gcc's analyser and wide warnings over the product's C, for tools/lib/verify_rules.py.

Every file is looked at with the options with which it is built: databases(ROOT) configures a build
with clang, one with gcc, and one for a Cortex-M4F (the HAL of Arm's boards). The boards of firmware/boards
are examples and are left out.
"""

import json
import re
import shlex
import subprocess
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

BUILD = "build/verify"
JOBS = 2

GCC_WIDE = """-Wcast-qual -Wcast-align=strict -Wundef -Wlogical-op -Wduplicated-cond -Wduplicated-branches
-Wnull-dereference -Wformat=2 -Wmissing-declarations -Wredundant-decls -Wnested-externs
-Wold-style-definition -Wunused-macros -Wpointer-arith -Wwrite-strings -Wjump-misses-init -Winit-self
-Wswitch-default -Wunused-const-variable=2 -Walloca -Wtrampolines -Wdate-time -Wimplicit-fallthrough=5
-Warith-conversion""".split()
# All of clang's but: padding; C++; C before 2011; a default beside all enumerators, which MISRA C
# wants; conversions of results and comparisons with 0.0f, which are meant; macros of the C library.
CLANG_WIDE = """-Weverything -Wno-padded -Wno-unsafe-buffer-usage -Wno-declaration-after-statement
-Wno-pre-c11-compat -Wno-switch-enum -Wno-covered-switch-default -Wno-bad-function-cast -Wno-float-equal
-Wno-disabled-macro-expansion""".split()

# (file, warning): why it is none. Each must still be given, or the entry is refused.
FALSE_ALARMS = {
    ("hal/linux/socketcan.c", "-Wlogical-op"): "EAGAIN and EWOULDBLOCK may be two numbers",
    ("hal/linux/stream.c", "-Wlogical-op"): "EAGAIN and EWOULDBLOCK may be two numbers",
    ("host_sim/bus/bus_report.c", "-Wformat-nonliteral"): "all callers are in the file",
    ("host_sim/summary.c", "-Wformat-nonliteral"): "the formats are in a table of the file",
    ("host_sim/cli_common.c", "-Wcast-qual"): "the C library takes text that is not constant",
}

WARNING = re.compile(r"^(\S+?):(\d+):(?:\d+:)? (?:warning|error): .*\[([\w.,=+-]+)\]$", re.MULTILINE)
NOLINT = re.compile(r"NOLINT\w*(\([\w.,-]+\): .{5})?")


def configure(root, name, options):
    folder = root / BUILD / f"rules-{name}"
    command = ["cmake", "-S", root, "-B", folder, "-G", "Ninja", "-DBERTH_BUILD_TESTS=OFF",
               "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", "-DCMAKE_BUILD_TYPE=Release", *options]
    subprocess.run([str(word) for word in command], cwd=root, check=True, capture_output=True)
    entries = {}
    for entry in json.loads((folder / "compile_commands.json").read_text()):
        path = Path(entry["file"])
        if path.is_relative_to(root) and not path.is_relative_to(root / "build"):
            entries.setdefault(str(path.relative_to(root)), entry)
    return entries


def databases(root):
    """Compile commands by file: of clang, of gcc, and of clang for a Cortex-M4F, for hal/mps2."""
    clang = configure(root, "clang", ["-DCMAKE_C_COMPILER=clang-19"])
    gcc = configure(root, "gcc", ["-DCMAKE_C_COMPILER=gcc"])
    toolchain = root / "tools/cmake/toolchains/cortex-m4f-clang.cmake"
    arm = configure(root, "arm", [f"-DCMAKE_TOOLCHAIN_FILE={toolchain}", "-DBERTH_BOARDS=mps2-an386",
                                  "-DBERTH_INSTALL=OFF"])
    return clang, gcc, {file: entry for file, entry in arm.items() if file.startswith("hal/mps2/")}


def options_of(entry):
    """The compiler's words without output, its own optimization and what makes warnings errors."""
    words = shlex.split(entry["command"])
    output = words.index("-o")
    words = words[:output] + words[output + 2:]
    return [word for word in words if word not in ("-Werror", "-c", "-O3", "-O2")]


def compile_all(entries, extra):
    def one(entry):
        done = subprocess.run([*options_of(entry), *extra], cwd=entry["directory"], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{entry['file']}: {done.stderr}")
        return done.stderr
    with ThreadPoolExecutor(JOBS) as pool:
        return list(pool.map(one, entries.values()))


def warnings(root, texts):
    """(file, line, warning) once each."""
    found = set()
    for text in texts:
        for file, line, name in WARNING.findall(text):
            path = Path(file)
            shown = str(path.relative_to(root)) if path.is_relative_to(root) else file
            found.add((shown, int(line), name.split(",")[0]))
    return found


def without_false_alarms(found, kind):
    """What is left, and the listed false alarms (of this kind) that were not given."""
    listed = {key for key in FALSE_ALARMS if key[1].startswith("-Wanalyzer") == (kind == "analyzer")}
    given = Counter((file, name) for file, _, name in found if (file, name) in listed)
    return sorted(item for item in found if item[::2] not in listed), sorted(listed - set(given)), given


def gcc_analyzer(root, entries):
    return warnings(root, compile_all(entries, ["-O2", "-fanalyzer", "-c", "-o", "/dev/null"]))


def gcc_wide(root, entries):
    return warnings(root, compile_all(entries, ["-O2", "-c", "-o", "/dev/null", *GCC_WIDE]))


def clang_wide(root, entries):
    return warnings(root, compile_all(entries, ["-fsyntax-only", *CLANG_WIDE]))


def run_tidy(root, path, folder, config=None):
    command = [root / ".venv/bin/clang-tidy", "-p", folder, "--quiet",
               f"--config-file={config or root / '.clang-tidy'}", path]
    done = subprocess.run([str(word) for word in command], cwd=root, capture_output=True, text=True)
    if done.returncode != 0 and not WARNING.search(done.stdout):
        raise RuntimeError(f"clang-tidy {path}: {done.stderr}")
    return done.stdout


def tidy(root, entries, name):
    folder = root / BUILD / f"rules-{name}"
    with ThreadPoolExecutor(JOBS) as pool:
        texts = pool.map(lambda file: run_tidy(root, root / file, folder), entries)
        return warnings(root, texts)


def tidy_checks(root):
    done = subprocess.run([root / ".venv/bin/clang-tidy", f"--config-file={root / '.clang-tidy'}", "--list-checks"],
                          cwd=root, capture_output=True, text=True, check=True)
    return sum(1 for line in done.stdout.splitlines() if line.startswith("    "))


def suppressions(root, files):
    """(how many NOLINT there are, those without a check's name or a reason)."""
    count, bare = 0, []
    for file in files:
        for number, line in enumerate((root / file).read_text().splitlines(), 1):
            match = NOLINT.search(line)
            if match:
                count += 1
                if match[1] is None:
                    bare.append(f"{file}:{number}")
    return count, bare


PLANTED = """#include <stdlib.h>
#define UNUSED 1
int planted(int *pointer, int number);
int planted(int *pointer, int number) {
    int *heap = malloc(sizeof(heap));
    free(heap);
    *heap = 100 / (number == 3 ? 0 : number);
    if (pointer == NULL) return *pointer;
    const int *constant = pointer;
    int *writable = (int *)constant;
    return *writable;
}
"""


def planted(root):
    """(found, planted): mistakes that each tool has to see."""
    wanted = {
        "gcc": {"-Wanalyzer-use-after-free", "-Wanalyzer-null-dereference", "-Wcast-qual", "-Wunused-macros"},
        "clang": {"-Wcast-qual", "-Wunused-macros"},
        "tidy": {"clang-analyzer-unix.MallocSizeof", "clang-analyzer-unix.Malloc", "clang-analyzer-core.DivideZero",
                 "readability-non-const-parameter", "readability-braces-around-statements"},
    }
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "planted.c"
        path.write_text(PLANTED)
        seen = {}
        for name, compiler in (("gcc", "gcc"), ("clang", "clang-19")):
            entry = {"command": f"{compiler} -std=c11 -o x {path}", "directory": scratch, "file": str(path)}
            (Path(scratch) / "compile_commands.json").write_text(json.dumps([entry]))
            if name == "gcc":
                seen[name] = gcc_analyzer(root, {"": entry}) | gcc_wide(root, {"": entry})
            else:
                seen[name] = clang_wide(root, {"": entry})
                seen["tidy"] = warnings(root, [run_tidy(root, path, scratch)])
    found = sum(len(names & {name for _, _, name in seen[tool]}) for tool, names in wanted.items())
    return found, sum(len(names) for names in wanted.values())
