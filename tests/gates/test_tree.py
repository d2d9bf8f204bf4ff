"""Rules for every file of the tree."""

import os
import re

import pytest

from tree import NOT_OURS, ROOT, files, name

TOP_LEVEL = {
    ".ci",
    ".clang-format",
    ".clang-tidy",
    ".gitattributes",
    ".gitignore",
    "CHANGELOG.md",
    "CMakeLists.txt",
    "CMakePresets.json",
    "LICENSE",
    "README.md",
    "firmware",
    "hal",
    "host_sim",
    "tests",
    "tools",
}
BINARY = {".bin", ".png", ".pdf"}
# Somebody's own folders: such a path works on one machine only.
ABSOLUTE = re.compile(r"(?<![\w.}\])])/(?:home|root|work|Users)/\w")
# Package registries are reached through the clients as they are set up, never by name.
REGISTRY = re.compile(
    r"\b(?:pypi|pythonhosted|npmjs|crates|proxy\.golang|maven"
    r"|(?:deb|ftp|security|snapshot|archive)\.(?:debian|ubuntu))\.(?:org|com|io)\b"
)
SHELL = re.compile(r"^#!.*\b(?:ba|da)?sh\b")

TEXT_FILES = [path for path in files() if path.suffix not in BINARY]


def first_line(path):
    return path.read_text().partition("\n")[0]


def executable(path):
    return os.access(path, os.X_OK)


@pytest.mark.parametrize("path", TEXT_FILES, ids=name)
def test_text(path):
    data = path.read_bytes()
    text = data.decode("utf-8")
    assert b"\r" not in data, "line ends are LF"
    assert text == "" or text.endswith("\n"), "the last line ends"
    lines = text.splitlines()
    assert [n for n, line in enumerate(lines, 1) if line != line.rstrip()] == []
    if path.suffix not in {".md", ".csv", ".json"}:
        assert [n for n, line in enumerate(lines, 1) if len(line) > 120] == []


@pytest.mark.parametrize("path", TEXT_FILES, ids=name)
def test_names_no_machine_and_no_registry(path):
    text = path.read_text()
    assert ABSOLUTE.findall(text) == []
    assert REGISTRY.findall(text) == []


@pytest.mark.parametrize("path", TEXT_FILES, ids=name)
def test_scripts_are_executable_and_strict(path):
    line = first_line(path)
    assert executable(path) == line.startswith("#!"), "a script has #! and its exec bit, or neither"
    if SHELL.match(line):
        assert re.search(r"^set -eu", path.read_text(), re.MULTILINE), "set -eu"


def test_top_level_holds_only_what_belongs_there():
    assert {path.name for path in ROOT.iterdir()} - NOT_OURS - TOP_LEVEL == set()


def test_the_rules_catch_violations():
    assert ABSOLUTE.search("cd " + "/home" + "/someone/berth")
    assert not ABSOLUTE.search("$root/work/log")
    assert REGISTRY.search("https://" + "pypi" + ".org/simple")
