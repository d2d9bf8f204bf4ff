"""How the tests run berth-sim, and read what it leaves."""

import csv
import json
import os
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(os.environ.get("BERTH_SOURCE_DIR") or pathlib.Path(__file__).parents[2])

COLUMNS = ("t,x,y,theta,v,omega,mode,e1,e2,e3,x_r,y_r,theta_r,v_r,omega_r,"
           "v_cmd,omega_cmd,clearance").split(",")
MODES = ["track", "regulated", "conservative_turn", "conservative_go", "blocked"]
SUMMARY_KEYS = ["collisions", "min_clearance_m", "rms_position_error_m", "peak_position_error_m",
                "final_position_error_m", "avoidance_time_s", "mode_time_s", "recovery_time_s",
                "control_effort", "steps", "wall_s"]
STRATEGIES = ["none", "conservative", "combined", "normal", "adaptive", "kanayama",
              "kanayama_avoid"]


def sim(*arguments, **options):
    """Runs berth-sim, with figures drawn by the Python that runs the tests."""
    environment = dict(os.environ, BERTH_PLOT_PYTHON=sys.executable,
                       BERTH_PLOT_SCRIPT=str(ROOT / "tools" / "plot" / "plot.py"))
    environment.update(options.pop("env", {}))
    return subprocess.run([os.environ["BERTH_SIM"], *map(str, arguments)], env=environment,
                          capture_output="stdout" not in options, text=True, timeout=120,
                          check=False, **options)


def summary(*arguments, status=0):
    """The JSON summary of a run that must end with that status and say nothing else."""
    result = sim(*arguments, "--json")
    assert (result.returncode, result.stderr) == (status, "")
    return json.loads(result.stdout)


def read_log(path):
    """Header, and the rows as text."""
    with open(path, newline="", encoding="ascii") as file:
        header, *rows = csv.reader(file)
    return header, rows


def columns(path):
    """The log by column: modes as text, all else as numbers."""
    header, rows = read_log(path)
    return {name: [row[i] if name == "mode" else float(row[i]) for row in rows]
            for i, name in enumerate(header)}
