"""A project outside the tree builds with Berth in each way that is promised, and gets it right."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

SOURCE = Path(os.environ["BERTH_SOURCE_DIR"])
BUILD = Path(os.environ["BERTH_BUILD_DIR"])
CONSUMER = SOURCE / "tests" / "consumer"
STRICT = "-std=c11 -Wall -Wextra -Wpedantic -Werror"


def run(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}"
    return done.stdout


def configure_and_build(folder, *settings):
    """Builds a copy of the consumer and returns its program."""
    project = folder / "project"
    shutil.copytree(CONSUMER, project)
    build = folder / "build"
    run(
        *("cmake", "-S", project, "-B", build, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release"),
        *(f"-DCMAKE_C_FLAGS={STRICT}", "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", *settings),
    )
    run("cmake", "--build", build)
    return build / "consumer"


def check_result(program):
    x, y = map(float, run(program).split())
    assert x == pytest.approx(0.975, abs=0.02)
    assert y == pytest.approx(0.0, abs=0.02)


def commands(build):
    return json.loads((build / "compile_commands.json").read_text())


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """An installed package, moved after it was installed: nothing may remember the old place."""
    folder = tmp_path_factory.mktemp("install")
    run("cmake", "--install", BUILD, "--prefix", folder / "first")
    return (folder / "first").rename(folder / "moved")


@pytest.mark.parametrize("way", ["subdirectory", "fetch"])
def test_from_source(way, tmp_path):
    program = configure_and_build(tmp_path, f"-DBERTH_FROM={way}", f"-DBERTH_ROOT={SOURCE}")
    check_result(program)
    files = [entry["file"] for entry in commands(tmp_path / "build")]
    assert any("firmware/src/" in file for file in files)
    assert not [file for file in files if "host_sim/" in file or "/tests/" in file]


def test_from_source_keeps_flags_to_itself(tmp_path):
    """Berth is compiled with exact arithmetic; its flags and warnings do not reach the consumer."""
    configure_and_build(tmp_path, "-DBERTH_FROM=subdirectory", f"-DBERTH_ROOT={SOURCE}")
    for entry in commands(tmp_path / "build"):
        own = "firmware/src/" in entry["file"] or "/hal/" in entry["file"]
        assert ("-ffp-contract=off" in entry["command"]) == own
        assert ("-Wconversion" in entry["command"]) == own


def test_installed_with_find_package(prefix, tmp_path):
    program = configure_and_build(tmp_path, "-DBERTH_FROM=package", f"-DCMAKE_PREFIX_PATH={prefix}")
    check_result(program)


def test_installed_with_pkg_config(prefix, tmp_path):
    (folder,) = {path.parent for path in prefix.rglob("berth.pc")}
    environment = {**os.environ, "PKG_CONFIG_PATH": str(folder)}
    flags = run("pkg-config", "--cflags", "--libs", "berth", env=environment).split()
    compiler = os.environ["BERTH_CC"]
    program = tmp_path / "consumer"
    run(compiler, *STRICT.split(), CONSUMER / "main.c", "-o", program, *flags)
    check_result(program)


def test_version_is_checked(prefix, tmp_path):
    script = tmp_path / "CMakeLists.txt"
    script.write_text(
        "cmake_minimum_required(VERSION 3.25)\nproject(p C)\nfind_package(berth 0.2 REQUIRED)\n"
    )
    done = subprocess.run(
        ["cmake", "-S", tmp_path, "-B", tmp_path / "build", "-G", "Ninja",
         f"-DCMAKE_PREFIX_PATH={prefix}"],
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0 and "0.1.0" in done.stderr


def test_installed_files(prefix):
    installed = {str(path.relative_to(prefix)) for path in prefix.rglob("*") if path.is_file()}
    headers = {path.name for path in (SOURCE / "firmware/include/berth").glob("*.h")}
    assert {f"include/berth/{header}" for header in headers} <= installed
    assert {"bin/berth-sim", "bin/berth-gen", "share/licenses/berth/LICENSE"} <= installed
    for path in prefix.rglob("*.cmake"):
        assert str(SOURCE) not in path.read_text()
        assert str(BUILD) not in path.read_text()
