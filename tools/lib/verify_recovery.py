"""How soon the robot is back on its path after obstacles, with drives that need time: before and after.

    tools/verify --short recovery      a hundred scenes of each kind
    tools/verify --write recovery      the scenes of the page; draws tools/figures/recovery.png

Without tools/verify, `.venv/bin/python tools/lib/verify_recovery.py --out FILE --readme' also writes the
table into README.md. Seeds are fixed: the figures are the same in each run. The scenes and the columns are
described in tools/bench/recovery.c: "before" does not reckon with the delay, "now" (paced) does.
"""

import argparse
import json
import math
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from cmake_build import build

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "gcc-release"
BENCH = BUILD / "tools" / "bench_recovery"
README = ROOT / "README.md"
BEGIN, END = "<!-- recovery: begin -->\n", "<!-- recovery: end -->\n"
COLUMNS = ("seed", "begin", "avoiding", "recovery", "regulated", "turning", "going", "blocked", "behind",
           "distance", "peak", "collided", "rms")
SCENES = [(shape, obstacles) for shape in ("circle", "eight") for obstacles in (1, 3)]
LAGS = ("0", "0.05", "0.1")
RULES = ("before", "paced")
NAMES = {"before": "before", "paced": "now"}
SEED, RUNS, RUNS_SHORT = 1, 2000, 60
COMMAND = "tools/verify --write recovery"
NEVER = 0.002  # of the encounters with lag may end without the robot back before the next


def quantile(values, part):
    """The smallest value that at least this part of them do not exceed."""
    return sorted(values)[max(0, math.ceil(part * len(values)) - 1)]


def mean(values):
    return sum(values) / len(values)


def measure(case):
    """What a case's encounters come to, and the text they came as."""
    shape, obstacles, lag, rule, runs = case
    text = subprocess.run([BENCH, shape, str(obstacles), lag, rule, str(SEED), str(runs)], check=True,
                          stdout=subprocess.PIPE, text=True).stdout
    rows = [dict(zip(COLUMNS, map(float, line.split(",")), strict=True)) for line in text.splitlines()]
    back = [row["recovery"] for row in rows if not math.isnan(row["recovery"])]
    endless = [math.inf] * (len(rows) - len(back))
    away = [row["avoiding"] + row["recovery"] for row in rows if not math.isnan(row["recovery"])]
    print(f"{shape} {obstacles} tau {lag} {rule}: {len(rows):,} encounters", flush=True)
    return {
        "encounters": len(rows),
        "never": len(endless),
        "median": quantile(back + endless, 0.5),
        "most95": quantile(back + endless, 0.95),
        "away": mean(away),
        "away95": quantile(away + endless, 0.95),
        "away_largest": max(away),
        "behind": mean([row["behind"] for row in rows]),
        "turning": mean([row["turning"] for row in rows]),
        "collided": len({row["seed"] for row in rows if row["collided"]}),
        "text": text,
    }


def measure_all(runs):
    cases = [(shape, obstacles, lag, rule, runs)
             for shape, obstacles in SCENES for lag in LAGS for rule in RULES]
    with ThreadPoolExecutor(2) as pool:
        return dict(zip([case[:4] for case in cases], pool.map(measure, cases), strict=True))


def pairs(figures, lags=LAGS[1:]):
    """(name of the scene, before, now) of each scene with these lags."""
    for shape, obstacles in SCENES:
        for lag in lags:
            yield ((shape, obstacles, lag), figures[shape, obstacles, lag, "before"],
                   figures[shape, obstacles, lag, "paced"])


def both(before, now, key, form):
    return f"{format(before[key], form)} / {format(now[key], form)}"


def table(figures):
    lines = [
        "| scenes, before / now | encounters | not back before the next | time to recover: median, s | 95 %, s "
        "| time away: mean, s | 95 %, s | longest, s | standing though behind, s | turning within C, s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (shape, obstacles, lag), before, now in pairs(figures):
        never = [f"{100.0 * one['never'] / one['encounters']:.2f} %" for one in (before, now)]
        lines.append(
            f"| {shape}, {obstacles} a lap, tau {lag} s | {both(before, now, 'encounters', ',')} "
            f"| {' / '.join(never)} | {both(before, now, 'median', '.2f')} | {both(before, now, 'most95', '.2f')} "
            f"| {both(before, now, 'away', '.2f')} "
            f"| {both(before, now, 'away95', '.2f')} | {both(before, now, 'away_largest', '.1f')} "
            f"| {both(before, now, 'behind', '.2f')} | {both(before, now, 'turning', '.2f')} |")
    return lines


def claim(name, text, figure, holds, short):
    entry = {"id": f"recovery-{name}", "claim": text, "figure": figure, "command": COMMAND, "holds": bool(holds),
             "exact": not short}
    return {**entry, "short": True} if short else entry


def total(figures, key, rule, lags=LAGS[1:]):
    return sum(one[key] for (_, _, lag, name), one in figures.items() if name == rule and lag in lags)


def share_claim(figures, short):
    count = {rule: (total(figures, "never", rule), total(figures, "encounters", rule)) for rule in RULES}
    share = {rule: never / encounters for rule, (never, encounters) in count.items()}
    figure = ", ".join(f"{NAMES[rule]} {never} of {encounters:,} ({100.0 * share[rule]:.2f} %)"
                       for rule, (never, encounters) in count.items())
    return claim("share", "with lag, avoidance that reckons with it brings the robot back before the next obstacle "
                 "in all but 0.2 % of the encounters, and more often than before", figure,
                 share["paced"] <= NEVER and share["paced"] < share["before"], short)


def spread(values, form):
    return f"{format(min(values), form)} to {format(max(values), form)}"


def time_claim(figures, short):
    rows = list(pairs(figures))
    before = [one["most95"] for _, one, _ in rows]
    now = [one["most95"] for _, _, one in rows]
    ahead = sum(b < a for a, b in zip(before, now, strict=True))
    figure = f"before {spread(before, '.2f')} s, now {spread(now, '.2f')} s; shorter in {ahead} of {len(rows)}"
    return claim("time", "with lag, the time to recover that 95 % of the encounters do not exceed is shorter than "
                 "before in each kind of scene", figure, ahead == len(rows), short)


def standing_claim(figures, short):
    rows = list(pairs(figures))
    figure = "; ".join(
        f"{what} before {spread([one[key] for _, one, _ in rows], '.2f')} s, now "
        f"{spread([one[key] for _, _, one in rows], '.2f')} s"
        for key, what in (("behind", "standing though behind"), ("turning", "turning within C")))
    less = all(now[key] < before[key] for _, before, now in rows for key in ("behind", "turning"))
    return claim("standing", "with lag, the robot stands less, though behind, and turns less within the "
                 "conservative radius than before, mean of an encounter", figure, less, short)


def clear_claim(figures, runs, short):
    collided = sum(one["collided"] for one in figures.values())
    return claim("clear", "no collision in any of these scenes", f"{collided} of {runs * len(figures):,} runs",
                 collided == 0, short)


def same_claim(figures, short):
    equal = [before["text"] == now["text"] for _, before, now in pairs(figures, LAGS[:1])]
    return claim("same", "for drives without lag nothing has changed, to the last digit",
                 f"{sum(equal)} of {len(equal)} kinds of scenes alike", all(equal), short)


def write_readme(lines):
    text = README.read_text()
    before, _, rest = text.partition(BEGIN)
    _, found, after = rest.partition(END)
    if not found:
        raise SystemExit("README.md has no place for the table")
    README.write_text(before + BEGIN + "".join(f"{line}\n" for line in lines) + END + after)


def readme_claim(lines):
    text = README.read_text()
    there = sum(f"{line}\n" in text for line in lines)
    return claim("readme", "README.md shows these figures", f"{there} of {len(lines)} lines",
                 there == len(lines), False)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--minutes", type=float, help="not looked at: it takes some two minutes of two cores")
    parser.add_argument("--readme", action="store_true")
    options = parser.parse_args()
    runs = RUNS_SHORT if options.short else RUNS
    build("gcc-release", "bench_recovery")
    figures = measure_all(runs)
    lines = table(figures)
    if options.readme:
        write_readme(lines)
    if not options.short:
        subprocess.run([sys.executable, "-B", ROOT / "tools" / "plot" / "recovery.py", BENCH,
                        ROOT / "tools" / "figures" / "recovery.png"], check=True)
    claims = [maker(figures, options.short) for maker in (share_claim, time_claim, standing_claim, same_claim)]
    claims.append(clear_claim(figures, runs, options.short))
    if not options.short:
        claims.append(readme_claim(lines))
    options.out.write_text(json.dumps({"claims": claims, "notes": lines}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
