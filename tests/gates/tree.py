"""The files of this tree, for the gates."""

import os
import subprocess
from pathlib import Path

ROOT = Path(os.environ.get("BERTH_SOURCE_DIR", Path(__file__).resolve().parents[2]))
BUILD = Path(os.environ.get("BERTH_BUILD_DIR", ROOT / "build" / "gcc-release"))
FIRMWARE = ROOT / "firmware"
NOT_OURS = {".pytest_cache", ".git", ".venv", ".cache", "build", "out", "__pycache__"}


def files(*suffixes, under=ROOT):
    """All files below a folder that belong to the tree, by suffix (all without one)."""
    found = []
    for folder, folders, names in os.walk(under):
        folders[:] = sorted(set(folders) - NOT_OURS)
        names = sorted(set(names) - NOT_OURS)
        found += [Path(folder) / name for name in names if not name.endswith(".pyc")]
    return [path for path in found if not suffixes or path.suffix in suffixes]


def name(path):
    """A path as it is shown in test names and messages."""
    return str(path.relative_to(ROOT))


def run(*command, **options):
    """Runs a tool and returns its output; an error shows what the tool said."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}"
    return done.stdout
