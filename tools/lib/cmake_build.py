"""Builds what a part of tools/verify runs."""

import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def build(preset, *targets):
    """Configures a preset and builds the targets, or all; ends the program with what the tools said."""
    selection = ["--target", *targets] if targets else []
    for command in (["cmake", "--preset", preset],
                    ["cmake", "--build", "--preset", preset, "--parallel", str(os.cpu_count()), *selection]):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = done.stdout[-4000:] + done.stderr[-4000:]
            raise SystemExit(f"{' '.join(command)}: status {done.returncode}\n{said}")
