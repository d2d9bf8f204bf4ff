"""The same sources give the same image, byte by byte, wherever they lie and whenever it is made."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(os.environ["BERTH_SOURCE_DIR"])
FOLDERS = ("firmware", "hal", "host_sim", "tests", "tools")
FILES = ("CMakeLists.txt", "CMakePresets.json", "LICENSE")
IMAGES = {"cortex-m4f": "mps2-an386-whole-O2", "rv32imafc": "virt-whole-O2"}


def run(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr


def build_elsewhere(preset, image, folder):
    copy = folder / "another" / "place"
    for name in FOLDERS:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(ROOT / name, copy / name)
    unity = os.environ.get("UNITY_SOURCE_DIR") or ROOT / ".cache" / "unity"
    binary = folder / "built"
    run("cmake", "--preset", preset, "-B", binary, f"-DUNITY_SOURCE_DIR={unity}", cwd=copy)
    run("cmake", "--build", binary, "--target", image, cwd=copy)
    return binary / "tests" / "target" / f"{image}.elf"


@pytest.mark.parametrize("preset", IMAGES)
def test_image_is_the_same_from_another_folder(preset, tmp_path):
    image = IMAGES[preset]
    here = ROOT / "build" / preset / "tests" / "target" / f"{image}.elf"
    there = build_elsewhere(preset, image, tmp_path)
    data = here.read_bytes()
    assert b".debug_info" in data, "the debugging information is compared too"
    assert str(ROOT).encode() not in data
    assert there.read_bytes() == data
