"""What the target tests share: images, boards, tools of the build they belong to."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(os.environ.get("BERTH_SOURCE_DIR", Path(__file__).resolve().parents[2]))
BUILD = Path(os.environ.get("BERTH_BUILD_DIR", ROOT / "build" / "cortex-m4f"))
BOARDS = os.environ.get("BERTH_BOARDS", "mps2-an386").split(",")

sys.path.insert(0, str(ROOT / "tools" / "lib"))


def image(board, name):
    return BUILD / "tests" / "target" / f"{board}-{name}.elf"


def tool(name):
    """binutils of the images' processor."""
    return ("riscv64-unknown-elf-" if "virt" in BOARDS else "arm-none-eabi-") + name


def run(*command):
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}"
    return done.stdout
