"""What a worker of tools/campaign does: runs berth-sim for a range of seeds and hands back its rows.

    run_shard({"arguments": [...], "seed": S, "runs": N, "program": PATH, "probe": {"seed", "runs"}})

A worker may be on another machine, without this tree: this module is sent to it as it is, and needs
nothing but the standard library and berth-sim, named by BERTH_SIM or in PATH or where the driver has
it.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
import zlib
from pathlib import Path

_probes = {}


class ShardError(Exception):
    """berth-sim broke; the shard may be tried again."""


class Refused(Exception):
    """berth-sim refused its arguments; no use in trying again."""


def find_program(hint=None):
    """Path of berth-sim on this machine, or None."""
    for candidate in (os.environ.get("BERTH_SIM"), hint):
        if candidate and os.access(candidate, os.X_OK):
            return candidate
    return shutil.which("berth-sim")


def run_rows(program, arguments, seed, runs):
    """The rows of a campaign as berth-sim writes them, in bytes."""
    with tempfile.TemporaryDirectory(prefix="berth-campaign-") as folder:
        path = Path(folder) / "rows.csv"
        command = [program, "campaign", *arguments, "--seed", str(seed), "--runs", str(runs),
                   "--jobs", "1", "--json", "--rows", str(path)]
        result = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                stderr=subprocess.PIPE, text=True, errors="replace", check=False)
        if result.returncode == 2:
            raise Refused(result.stderr.strip())
        if result.returncode not in (0, 1) or not path.exists():
            raise ShardError(f"{' '.join(command)}: status {result.returncode}: {result.stderr.strip()}")
        return path.read_bytes()


def probe(program, arguments, seed, runs):
    """A digest of what this berth-sim makes of a few runs: the same for every good build of a tree."""
    key = (program, tuple(arguments), seed, runs)
    if key not in _probes:
        _probes[key] = hashlib.sha256(run_rows(program, arguments, seed, runs)).hexdigest()
    return _probes[key]


def run_shard(task):
    """Returns {"seed", "runs", "rows": compressed CSV, "probe", "host"}, or {"refused": why}. Raises
    RuntimeError, which every machine knows, when berth-sim breaks."""
    program = find_program(task["program"])
    host = os.uname().nodename
    if program is None:
        return {"refused": f"a worker on {host} has no berth-sim: put it into PATH, or name it by BERTH_SIM"}
    try:
        digest = probe(program, task["arguments"], **task["probe"])
        rows = run_rows(program, task["arguments"], task["seed"], task["runs"])
    except Refused as error:
        return {"refused": str(error)}
    except (ShardError, OSError) as error:
        raise RuntimeError(f"{host}: {error}") from None
    return {"seed": task["seed"], "runs": task["runs"], "rows": zlib.compress(rows, 6), "probe": digest,
            "host": host}
