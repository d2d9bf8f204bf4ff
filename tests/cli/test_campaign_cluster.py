"""tools/campaign: many workers, one result; interruptions, lost workers and damaged journals do it no
harm."""

import json
import os
import pty
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time

import psutil
import pyarrow.parquet
import pytest

from simulator import ROOT, sim

sys.path.insert(0, str(ROOT / "tools" / "lib"))

import campaign_table  # noqa: E402
from campaign_journal import Journal, JournalError  # noqa: E402

DRIVER = [sys.executable, "-B", str(ROOT / "tools" / "lib" / "campaign.py")]
SIM = os.environ["BERTH_SIM"]
TIMEOUT = 240
DRAWN = ("--plant", "drawn", "--set", "robot.v_max_mps=0.6")
# Long enough to be interrupted, short enough to be done again.
LONG = ("dynamics", "--runs", "3000", "--shard", "50", "--workers", "2")


def campaign(*arguments, **environment):
    return subprocess.run([*DRIVER, *map(str, arguments)], capture_output=True, text=True, timeout=TIMEOUT,
                          env={**os.environ, **environment}, check=False)


def start(*arguments, **environment):
    return subprocess.Popen([*DRIVER, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            text=True, env={**os.environ, **environment})


def good(result, status=0):
    assert result.returncode == status, result.stderr
    return result


def program(path, script):
    """A berth-sim of our own; $real is the real one."""
    path.write_text(f"#!/bin/bash\nset -eu\nreal={shlex.quote(SIM)}\n{script}\n")
    path.chmod(0o755)
    return str(path)


def logged(tmp_path):
    """A berth-sim that notes the seeds it is asked for, and what it has noted."""
    log = tmp_path / "calls"
    script = program(tmp_path / "sim", f'echo "$*" >>{shlex.quote(str(log))}\nexec "$real" "$@"')

    def seeds():
        words = [line.split() for line in log.read_text().splitlines()]
        calls = [(int(line[line.index("--seed") + 1]), int(line[line.index("--runs") + 1])) for line in words]
        log.write_text("")
        return sorted(seed for seed, runs in calls if runs > 2)  # without the probes
    return script, seeds


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """What one berth-sim makes of LONG's runs."""
    path = tmp_path_factory.mktemp("reference") / "rows.csv"
    assert sim("campaign", "--runs", 3000, *DRAWN, "--rows", path).returncode == 0
    return path.read_bytes()


def wait_for_shards(journal, count, process):
    deadline = time.monotonic() + TIMEOUT
    while len(list(journal.glob("*.rows"))) < count:
        assert time.monotonic() < deadline and process.poll() is None, process.communicate()
        time.sleep(0.02)


# --- the same result ------------------------------------------------------------------------

def test_csv_is_what_one_process_writes(tmp_path):
    out = tmp_path / "new" / "out.csv"
    result = good(campaign("ideal", "--runs", 205, "--seed", 30, "--shard", 20, "--workers", 2, "-o", out))
    alone = tmp_path / "alone.csv"
    assert sim("campaign", "--runs", 205, "--seed", 30, "--rows", alone).returncode == 0
    assert out.read_bytes() == alone.read_bytes()
    assert sorted(path.name for path in out.parent.iterdir()) == ["out.csv"]
    assert "205 of 205 runs" in result.stderr
    totals = json.loads(sim("campaign", "--runs", 205, "--seed", 30, "--json").stdout)
    assert f"{1000 * totals['worst_clearance_m']:.1f} mm" in result.stdout


def test_parquet_has_the_same_rows_and_says_whose_they_are(tmp_path):
    out = tmp_path / "out.parquet"
    result = good(campaign("bus", "--runs", 10, "--shard", 3, "--workers", 2, "-o", out, "--json"))
    table = pyarrow.parquet.read_table(out)
    alone = tmp_path / "alone.csv"
    told = json.loads(table.schema.metadata[b"berth"])
    sim("campaign", "--runs", 10, *told["arguments"], "--rows", alone)
    assert table.replace_schema_metadata(None).equals(campaign_table.read_rows(alone.read_bytes()))
    assert table["seed"].to_pylist() == list(range(1, 11))
    summary = json.loads(result.stdout)
    assert (summary["runs"], summary["collided"], summary["wrong"]) == (10, 0, {})
    assert sum(row["runs"] for row in summary["faults"].values()) == 10
    assert summary["stopped"] == sum(table["reason"].is_valid().to_pylist())
    assert summary["arguments"] == told["arguments"] and told["runs"] == 10


def test_summary_is_of_the_rows(tmp_path):
    out = tmp_path / "out.csv"
    summary = json.loads(good(campaign("violation", "--runs", 1500, "--workers", 2, "-o", out, "--json")).stdout)
    table = campaign_table.read_rows(out.read_bytes()).to_pylist()
    collided = [row for row in table if row["collisions"]]
    assert summary["collided"] == len(collided) > 10
    assert summary["collided_with_condition"] == 0 < summary["runs_with_condition"]
    assert summary["worst_clearance_m"] == min(row["min_clearance_m"] for row in table)
    assert summary["recovered"] == sum(row["recovered"] for row in table)
    assert summary["steps"] == sum(row["steps"] for row in table)
    curve = summary["curve"]
    for part in curve:
        inside = [row for row in table if part["from"] <= row["violation"] < part["to"]]
        assert part["runs"] == len(inside)
        assert part["collided"] == sum(bool(row["collisions"]) for row in inside)
        assert part["low"] <= part["rate"] <= part["high"]
    assert sum(part["runs"] for part in curve) > 0.95 * len(table)


# --- interruptions ---------------------------------------------------------------------------

def test_killed_and_resumed_is_as_if_never_interrupted(tmp_path, reference):
    script, seeds = logged(tmp_path)
    out, journal = tmp_path / "out.csv", tmp_path / "out.csv.journal"
    killed = start(*LONG, "-o", out, BERTH_SIM=script)
    wait_for_shards(journal, 5, killed)
    killed.kill()
    killed.communicate(timeout=TIMEOUT)
    done = {int(path.stem) for path in journal.glob("*.rows")}
    assert 5 <= len(done) < 60 and not out.exists()
    seeds()

    again = campaign(*LONG, "-o", out)
    assert again.returncode == 2 and "--resume" in again.stderr
    other = campaign(*LONG, "--seed", 2, "-o", out, "--resume")
    assert other.returncode == 2 and "seed is 2, was 1" in other.stderr
    other = campaign(*LONG, "--set", "robot.v_max_mps=0.5", "-o", out, "--resume")
    assert other.returncode == 2 and "arguments is" in other.stderr

    good(campaign(*LONG, "-o", out, "--resume", BERTH_SIM=script))
    assert out.read_bytes() == reference
    assert seeds() == sorted(set(range(1, 3001, 50)) - done)
    assert not journal.exists()


def test_an_interrupt_says_how_to_go_on(tmp_path, reference):
    out = tmp_path / "out.csv"
    interrupted = start(*LONG, "-o", out)
    wait_for_shards(tmp_path / "out.csv.journal", 2, interrupted)
    interrupted.send_signal(signal.SIGINT)
    _, err = interrupted.communicate(timeout=TIMEOUT)
    assert interrupted.returncode == 130
    assert "--resume" in err and "Traceback" not in err
    good(campaign(*LONG, "-o", out, "--resume"))
    assert out.read_bytes() == reference


def whole_journal(tmp_path, shards=4):
    """A journal in which all is done but the results."""
    rows = tmp_path / "rows.csv"
    folder = tmp_path / "out.csv.journal"
    script = program(tmp_path / "sim", 'exec "$real" "$@"')
    # the last shard's program fails: the others stay in the journal
    failing = program(tmp_path / "failing", f'[[ "$*" != *"--seed {20 * (shards - 1) + 1} "* ]] || exit 5\n'
                                            'exec "$real" "$@"')
    result = campaign("ideal", "--runs", 20 * shards, "--shard", 20, "--workers", 1, "-o", tmp_path / "out.csv",
                      BERTH_SIM=failing)
    assert result.returncode == 3 and "status 5" in result.stderr and "--resume" in result.stderr
    assert sim("campaign", "--runs", 20 * shards, "--rows", rows).returncode == 0
    assert len(list(folder.glob("*.rows"))) == shards - 1
    return folder, rows.read_bytes(), script


def test_damaged_shards_are_done_again(tmp_path):
    script, seeds = logged(tmp_path)
    folder, rows, _ = whole_journal(tmp_path, 5)
    script, seeds = logged(tmp_path)
    paths = sorted(folder.glob("*.rows"))
    data = bytearray(paths[0].read_bytes())
    data[len(data) // 2] ^= 1
    paths[0].write_bytes(data)
    paths[1].write_bytes(paths[1].read_bytes()[:-3])
    paths[2].write_bytes(b"")
    (folder / "notes.rows").write_text("somebody's")
    result = good(campaign("ideal", "--runs", 100, "--shard", 20, "--workers", 1, "-o", tmp_path / "out.csv",
                           "--resume", BERTH_SIM=script))
    assert (tmp_path / "out.csv").read_bytes() == rows
    assert "damaged" in result.stderr and paths[1].name in result.stderr
    assert seeds() == [1, 21, 41, 81]


@pytest.mark.parametrize("spoil, problem", [
    (lambda folder: (folder / "campaign.json").write_text("{"), "campaign.json is damaged"),
    (lambda folder: (folder / "campaign.json").write_text("[]"), "campaign.json is damaged"),
    (lambda folder: (folder / "campaign.json").unlink(), "campaign.json is missing"),
], ids=["broken", "other", "missing"])
def test_a_journal_that_nobody_knows_is_refused(tmp_path, spoil, problem):
    parameters = {"kind": "ideal", "runs": 1}
    with Journal(tmp_path / "x.journal", parameters, False) as journal:
        journal.store(1, b"x")
    spoil(tmp_path / "x.journal")
    with pytest.raises(JournalError, match=problem):
        Journal(tmp_path / "x.journal", parameters, True)


def test_one_campaign_at_a_time_writes_a_file(tmp_path):
    with Journal(tmp_path / "x.journal", {"runs": 1}, False):
        with pytest.raises(JournalError, match="in use"):
            Journal(tmp_path / "x.journal", {"runs": 1}, True)


def test_a_journal_of_another_simulator_is_refused(tmp_path):
    whole_journal(tmp_path, 3)
    script = program(tmp_path / "changed", 'exec "$real" "$@" --set avoidance.skirt_m=0.03')
    result = campaign("ideal", "--runs", 60, "--shard", 20, "--workers", 1, "-o", tmp_path / "out.csv", "--resume",
                      BERTH_SIM=script)
    assert result.returncode == 2 and "probe is" in result.stderr


# --- workers elsewhere -----------------------------------------------------------------------

@pytest.fixture
def cluster(tmp_path):
    """A scheduler on the loopback interface, and a way to give it workers."""
    started = []

    def launch(module, *arguments, **environment):
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", *arguments], cwd=tmp_path,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, **environment})
        started.append(process)
        return process

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    launch("dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")

    def worker(**environment):
        return launch("dask_worker", address, "--host", "127.0.0.1", "--no-dashboard", "--no-nanny", "--nthreads",
                      "1", "--local-directory", str(tmp_path / "scratch"), **environment)

    yield address, worker
    for process in started:
        process.kill()
    for process in started:
        process.wait(timeout=TIMEOUT)


def test_a_scheduler_by_address_and_a_lost_worker(tmp_path, cluster, reference):
    address, worker = cluster
    out = tmp_path / "out.csv"
    first, _ = worker(), worker()
    running = start("dynamics", "--runs", 3000, "--shard", 50, "--scheduler", address, "-o", out)
    wait_for_shards(tmp_path / "out.csv.journal", 4, running)
    first.kill()
    _, err = running.communicate(timeout=TIMEOUT)
    assert running.returncode == 0, err
    assert out.read_bytes() == reference


def test_a_worker_without_the_simulator_is_told(tmp_path, cluster):
    address, worker = cluster
    worker(BERTH_SIM="", PATH="")
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    shutil.copy(SIM, hidden / "berth-sim")
    running = start("ideal", "--runs", 20, "--scheduler", address, "-o", tmp_path / "out.csv",
                    BERTH_SIM=program(tmp_path / "driver", f'exec {hidden}/berth-sim "$@"'))
    # what the driver has is not there when the worker looks
    deadline = time.monotonic() + TIMEOUT
    while not (tmp_path / "out.csv.journal").exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    (tmp_path / "driver").unlink()
    _, err = running.communicate(timeout=TIMEOUT)
    assert running.returncode == 2
    assert "has no berth-sim" in err


def test_a_worker_with_another_simulator_is_told(tmp_path, cluster):
    address, worker = cluster
    worker(BERTH_SIM=program(tmp_path / "other", 'exec "$real" "$@" --set avoidance.skirt_m=0.03'))
    result = campaign("ideal", "--runs", 20, "--scheduler", address, "-o", tmp_path / "out.csv")
    assert result.returncode == 2 and "the same tree" in result.stderr


def test_no_scheduler_is_told(tmp_path):
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{nobody.getsockname()[1]}"
        script = ("import sys; sys.path.insert(0, sys.argv.pop(1)); import campaign_cluster, campaign; "
                  "campaign_cluster.PATIENCE_S = 1; sys.exit(campaign.main())")
        result = subprocess.run([sys.executable, "-B", "-c", script, str(ROOT / "tools" / "lib"), "ideal", "--runs",
                                 "4", "--scheduler", address, "-o", str(tmp_path / "out.csv")],
                                capture_output=True, text=True, timeout=TIMEOUT, check=False)
    assert result.returncode == 3
    assert address in result.stderr and "Traceback" not in result.stderr


def test_a_simulator_that_dies_is_tried_again(tmp_path):
    out = tmp_path / "out.csv"
    # each shard's first call; the folder of the rows is another one each time
    mark = shlex.quote(str(tmp_path / "died-"))
    flaky = program(tmp_path / "flaky", 'told="$*"\ntold=${told%%--jobs*}\n'
                    f'mark={mark}${{told//[^0-9]/-}}\n'
                    '[[ "$told" == *"--runs 2 " ]] || [ -e "$mark" ] || { touch "$mark"; kill -SEGV $$; }\n'
                    'exec "$real" "$@"')
    good(campaign("ideal", "--runs", 60, "--shard", 20, "--workers", 2, "-o", out, BERTH_SIM=flaky))
    assert len(list(tmp_path.glob("died-*"))) == 3
    assert len(out.read_text().splitlines()) == 61


def test_local_workers_listen_on_the_loopback_interface_alone(tmp_path):
    running = start(*LONG, "-o", tmp_path / "out.csv")
    wait_for_shards(tmp_path / "out.csv.journal", 1, running)
    family = [psutil.Process(running.pid), *psutil.Process(running.pid).children(recursive=True)]
    listening = []
    for process in family:
        try:
            listening += [c.laddr.ip for c in process.net_connections() if c.status == psutil.CONN_LISTEN]
        except psutil.NoSuchProcess:
            pass  # a berth-sim that is done
    running.send_signal(signal.SIGINT)
    running.communicate(timeout=TIMEOUT)
    assert len(listening) >= 3 and set(listening) == {"127.0.0.1"}


# --- what is printed -------------------------------------------------------------------------

def test_bad_runs_are_printed_as_commands_that_repeat_them(tmp_path):
    result = good(campaign("ideal", "--runs", 40, "--workers", 1, "--strategy", "none", "-o", tmp_path / "out.csv"), 1)
    commands = [line.partition("#")[0].split() for line in result.stdout.splitlines()
                if line.startswith("  berth-sim campaign")]
    assert len(commands) == 20 and "# collided" in result.stdout and "more, in" in result.stdout
    alone = sim(*commands[0][1:])
    assert alone.returncode == 1 and "collisions           1" in alone.stdout


def test_progress_on_a_terminal(tmp_path):
    ours, theirs = pty.openpty()
    result = subprocess.run([*DRIVER, "ideal", "--runs", "60", "--shard", "20", "--workers", "1", "-o",
                             str(tmp_path / "out.csv")], stdout=subprocess.DEVNULL, stderr=theirs, timeout=TIMEOUT,
                            check=False)
    os.close(theirs)
    shown = os.read(ours, 100000).decode()
    os.close(ours)
    assert result.returncode == 0
    assert shown.count("\r[") == 3
    assert "20 of 60 runs, " in shown and "60 of 60 runs" in shown and "a second, " in shown
    assert "#" * 40 in shown


def test_the_figure_of_the_margin(tmp_path):
    """The same bytes each time; every bin has its mark (that it looks well is for people to see)."""
    script = [sys.executable, "-B", str(ROOT / "tools" / "plot" / "violation.py")]
    paths = []
    for kind in ("violation", "ideal", "dynamics", "late"):
        paths.append(str(tmp_path / f"{kind}.parquet"))
        good(campaign(kind, "--runs", 1500, "--workers", 2, "-o", paths[-1]))
    for name in ("one.png", "two.png"):
        good(subprocess.run([*script, *paths, str(tmp_path / name)], capture_output=True, text=True,
                            timeout=TIMEOUT, check=False))
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    assert (tmp_path / "one.png").stat().st_size > 10000
    for wrong in ([], paths, [*paths, "x.pdf"], [*paths[:3], str(tmp_path / "none.parquet"), "x.png"],
                  [str(tmp_path / "one.png"), *paths[1:], "x.png"]):
        result = subprocess.run([*script, *wrong], capture_output=True, text=True, timeout=60, cwd=tmp_path,
                                check=False)
        assert result.returncode == 2 and "Traceback" not in result.stderr and result.stderr


def test_wilson_interval():
    """Against the intervals' defining equation: |rate - p| = z sqrt(p (1 - p) / n) at both ends."""
    for hits, count in ((1, 10), (5, 10), (9, 10), (3, 5000), (2500, 5000)):
        for end in campaign_table.wilson(hits, count):
            off = abs(hits / count - end)
            assert off == pytest.approx(1.959964 * (end * (1 - end) / count) ** 0.5, rel=1e-6)
    assert campaign_table.wilson(0, 100)[0] == 0.0
    assert campaign_table.wilson(0, 100)[1] == pytest.approx(0.0370, abs=1e-4)
    assert campaign_table.wilson(100, 100)[1] == 1.0


@pytest.mark.parametrize("arguments, fragments", [
    ([], ["kind"]),
    (["other"], ["'other'", "ideal", "violation"]),
    (["ideal", "more"], ["more"]),
    (["ideal", "--runs", "0"], ["--runs", "'0'", "1 to 1000000000"]),
    (["ideal", "--runs", "1e6"], ["--runs", "'1e6'"]),
    (["ideal", "--seed", "-1"], ["--seed"]),
    (["ideal", "--seed", "9223372036854775807", "--runs", "2"], ["--seed", "9223372036854775807"]),
    (["ideal", "--shard", "x"], ["--shard", "'x'"]),
    (["ideal", "--workers", "0"], ["--workers", "1 to 1024"]),
    (["ideal", "--workers", "1", "--scheduler", "tcp://127.0.0.1:1"], ["--scheduler", "--workers"]),
    (["ideal", "-o", "out.txt"], ["out.txt", ".parquet or .csv"]),
    (["ideal", "-o", "/"], ["-o"]),
    (["ideal", "--bogus"], ["--bogus"]),
    (["ideal", "--set", "robot.wings=2"], ["robot.wings"]),
    (["ideal", "--strategy", "luck"], ["'luck'"]),
    (["dynamics", "--set", "plant.tau_s=1"], ["plant.tau_s", "drawn for each run"]),
    (["ideal", "--drive", "odrive"], ["--drive", "--bus loop"]),
    (["ideal", "-o", "/proc/nowhere/out.csv"], ["/proc/nowhere"]),
], ids=str)
def test_bad_usage(tmp_path, arguments, fragments):
    result = subprocess.run([*DRIVER, *arguments], capture_output=True, text=True, timeout=60, cwd=tmp_path,
                            check=False)
    assert (result.returncode, result.stdout) == (2, "")
    assert "Traceback" not in result.stderr
    for fragment in fragments:
        assert fragment in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_no_simulator(tmp_path):
    result = campaign("ideal", "-o", tmp_path / "out.csv", BERTH_SIM="", PATH=str(tmp_path))
    assert result.returncode == 2 and "no berth-sim" in result.stderr


def test_help_names_every_option():
    text = subprocess.run([str(ROOT / "tools" / "campaign"), "--help"], capture_output=True, text=True, timeout=60,
                          check=True).stdout
    for word in ("ideal", "dynamics", "bus", "violation", "--runs", "--seed", "-o", "--resume", "--workers",
                 "--scheduler", "--shard", "--json", "--set", "--strategy", "--overlap", "--drive", "130"):
        assert word in text
