"""Drives tools/campaign: shards of seeds, workers, the journal, the results, the summary. Its usage is
at the top of tools/campaign."""

import argparse
import json
import os
import shlex
import signal
import sys
import time
from pathlib import Path
from typing import NamedTuple

import campaign_shard
from campaign_journal import Journal, JournalError

ROOT = Path(__file__).resolve().parents[2]
USAGE, CLUSTER, INTERRUPTED = 2, 3, 130
SEED_MAX = 2**63 - 1
PROBE_RUNS = 2
BAD_SHOWN = 20
LINE_EVERY_S = 30.0  # of progress, where there is no terminal


class Kind(NamedTuple):
    runs: int  # unless told
    shard: int
    arguments: tuple
    bus: bool = False


KINDS = {
    "ideal": Kind(1000000, 4000, ()),
    "dynamics": Kind(200000, 1000, ("--plant", "drawn", "--set", "robot.v_max_mps=0.6")),
    "bus": Kind(3000, 25, ("--bus", "loop", "--faults", "--plant", "drawn", "--set", "robot.v_max_mps=0.5"),
                True),
    "violation": Kind(200000, 1000, ("--plant", "untold", "--set", "robot.v_max_mps=0.6")),
    "late": Kind(200000, 1000, ("--plant", "late", "--set", "robot.v_max_mps=0.6")),
}


def refuse(text, status=USAGE):
    print(f"tools/campaign: {text}", file=sys.stderr)
    raise SystemExit(status)


class Parser(argparse.ArgumentParser):
    def error(self, message):
        refuse(f"{message} (see tools/campaign --help)")


def counter(most, least=1):
    """A whole number in plain digits: -1 and 1e3 are not taken for something else."""
    def convert(text):
        if not (text.isascii() and text.isdigit() and least <= int(text) <= most):
            raise argparse.ArgumentTypeError(f"'{text}' (allowed: an integer from {least} to {most})")
        return int(text)
    return convert


def arguments():
    parser = Parser(prog="tools/campaign", add_help=False, allow_abbrev=False)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--runs", type=counter(10**9))
    parser.add_argument("--seed", type=counter(SEED_MAX, 0), default=1)
    parser.add_argument("--shard", type=counter(10**6))
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--json", action="store_true")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--workers", type=counter(1024))
    place.add_argument("--scheduler")
    for option in ("--set", "--strategy", "--overlap", "--drive"):
        parser.add_argument(option, action="append", default=[])
    options = parser.parse_args()
    kind = KINDS[options.kind]
    options.runs = options.runs or kind.runs
    options.shard = options.shard or kind.shard
    options.output = options.output or ROOT / "out" / "campaign" / f"{options.kind}.parquet"
    if options.output.suffix not in (".parquet", ".csv"):
        refuse(f"-o: '{options.output}' (allowed: a name that ends in .parquet or .csv)")
    if options.output.is_dir():
        refuse(f"-o: '{options.output}' is a folder")
    if options.seed > SEED_MAX - (options.runs - 1):
        refuse(f"--seed: {options.seed} and {options.runs} runs count beyond the largest seed, {SEED_MAX}")
    return options


def sim_arguments(options):
    """What berth-sim campaign is told, beside seed and runs."""
    told = list(KINDS[options.kind].arguments)
    for name in ("set", "strategy", "overlap", "drive"):
        for value in getattr(options, name):
            told += [f"--{name}", value]
    return told


def find_simulator():
    program = campaign_shard.find_program()
    if program is None:
        refuse("no berth-sim: name it by BERTH_SIM, or put it into PATH")
    return os.path.abspath(program)


def check_simulator(program, told, seed):
    """A few runs here show that the arguments are good, and what every worker must make of them."""
    try:
        return campaign_shard.probe(program, told, seed, PROBE_RUNS)
    except campaign_shard.Refused as error:
        refuse(str(error).removeprefix("berth-sim campaign: "))
    except (campaign_shard.ShardError, OSError) as error:
        refuse(f"berth-sim does not run: {error}")


def shards_of(options):
    """(seed, runs) of each shard, in order."""
    end = options.seed + options.runs
    return [(seed, min(options.shard, end - seed)) for seed in range(options.seed, end, options.shard)]


# --- progress -----------------------------------------------------------------------------------

def time_text(seconds):
    minutes, seconds = divmod(int(seconds + 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {seconds} s" if minutes else f"{seconds} s"


class Progress:
    """One line on a terminal, now and then a line elsewhere."""

    def __init__(self, total, done, quiet=False):
        self.total, self.begun_with, self.done = total, done, done
        self.start = self.shown = time.monotonic()
        self.terminal = sys.stderr.isatty()
        self.quiet = quiet

    def line(self):
        spent = time.monotonic() - self.start
        rate = (self.done - self.begun_with) / spent if spent > 0 else 0.0
        left = f", {time_text((self.total - self.done) / rate)} left" if rate > 0 else ""
        return f"{self.done:,} of {self.total:,} runs, {rate:,.0f} a second{left}"

    def advance(self, runs):
        self.done += runs
        now = time.monotonic()
        if self.quiet:
            return
        if self.terminal:
            filled = 40 * self.done // self.total
            print(f"\r[{'#' * filled}{' ' * (40 - filled)}] {self.line()}\x1b[K", end="", file=sys.stderr,
                  flush=True)
        elif now - self.shown >= LINE_EVERY_S or self.done == self.total:
            self.shown = now
            print(self.line(), file=sys.stderr, flush=True)

    def end(self):
        if self.terminal and not self.quiet:
            print(file=sys.stderr)


# --- the campaign -------------------------------------------------------------------------------

def check_shard(result, parameters):
    if "refused" in result:
        refuse(result["refused"])
    if result["probe"] != parameters["probe"]:
        refuse(f"berth-sim on {result['host']} makes something else of seed {parameters['seed']} than the one "
               "here: all must be built from the same tree")


def run_missing(options, journal, program):
    """Has the workers do what is not in the journal yet."""
    missing = [shard for shard in shards_of(options) if shard[0] not in journal.done]
    progress = Progress(options.runs, options.runs - sum(runs for _, runs in missing))
    if journal.damaged:
        print(f"tools/campaign: damaged in the journal, and done again: {', '.join(journal.damaged)}",
              file=sys.stderr)
    if not missing:
        return
    import campaign_cluster  # noqa: PLC0415 - takes a second, which bad usage need not wait for
    tasks = ({"arguments": journal.parameters["arguments"], "seed": seed, "runs": runs, "program": program,
              "probe": {"seed": options.seed, "runs": PROBE_RUNS}} for seed, runs in missing)
    try:
        with campaign_cluster.connect(options.scheduler, options.workers) as client:
            for result in campaign_cluster.run_tasks(client, tasks):
                check_shard(result, journal.parameters)
                journal.store(result["seed"], result["rows"])
                progress.advance(result["runs"])
    except campaign_cluster.ClusterError as error:
        refuse(f"{error}\n{kept(options, progress.done)}", CLUSTER)
    finally:
        progress.end()


def kept(options, done):
    return f"{done:,} of {options.runs:,} runs are in {options.output}.journal; --resume goes on"


def write_results(options, journal):
    """The file, written beside its place and renamed into it; returns the summary."""
    import campaign_table  # noqa: PLC0415 - likewise
    temporary = options.output.with_name(f"{options.output.name}.tmp")
    results = campaign_table.open_results(temporary, journal.parameters)
    summary = campaign_table.Summary(KINDS[options.kind].bus)
    seeds = 0
    for seed, runs in shards_of(options):
        table = results.add(journal.rows(seed))
        if table["seed"].to_pylist() != list(range(seed, seed + runs)):
            raise JournalError(f"{journal.folder}: the rows of seed {seed} are of other runs: remove the folder")
        summary.add(table)
        seeds += runs
    results.close()
    temporary.replace(options.output)
    return summary.result()


def print_bad(options, result, told):
    if result["bad_count"] == 0:
        return
    words = ["berth-sim", "campaign", *told, "--runs", "1", "--seed"]
    print(f"\nThat must not be ({result['bad_count']:,} runs); each is repeated by\n")
    for bad in result["bad"][:BAD_SHOWN]:
        print(f"  {shlex.join(words)} {bad['seed']}    # {bad['what']}")
    if result["bad_count"] > BAD_SHOWN:
        print(f"  and {result['bad_count'] - BAD_SHOWN:,} more, in {options.output}")


def report(options, result, told):
    result = {"kind": options.kind, "seed": options.seed, "arguments": told, **result}
    if options.json:
        print(json.dumps(result, indent=1))
    else:
        import campaign_table  # noqa: PLC0415 - likewise
        print(f"{options.kind}: berth-sim campaign {shlex.join(told)}".rstrip() + f", seeds from {options.seed}\n")
        campaign_table.print_summary(result)
        print_bad(options, result, told)
        print(f"\none row a run: {options.output}")
    return 1 if result["bad_count"] else 0


def main():
    options = arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    options.workers = options.workers or os.cpu_count() or 1
    program = find_simulator()
    told = sim_arguments(options)
    parameters = {"kind": options.kind, "arguments": told, "seed": options.seed, "runs": options.runs,
                  "shard": options.shard, "probe": check_simulator(program, told, options.seed)}
    try:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        with Journal(f"{options.output}.journal", parameters, options.resume) as journal:
            run_missing(options, journal, program)
            result = write_results(options, journal)
            journal.remove()
        return report(options, result, told)
    except JournalError as error:
        refuse(str(error))
    except OSError as error:
        refuse(f"{error.filename or options.output}: {error.strerror or error}")
    except KeyboardInterrupt:
        refuse(f"interrupted: what was done is in {options.output}.journal; --resume goes on", INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
