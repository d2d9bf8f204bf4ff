"""Nothing is forgotten: every source is compiled and every test is registered."""

import json

from tree import BUILD, ROOT, files, name, run


def test_every_c_file_is_compiled():
    entries = json.loads((BUILD / "compile_commands.json").read_text())
    compiled = {entry["file"] for entry in entries}
    # The consumer is a project of its own; boards are built by their own toolchains.
    elsewhere = (ROOT / "tests" / "consumer", ROOT / "firmware" / "boards")
    forgotten = [
        name(path)
        for path in files(".c")
        if str(path) not in compiled and not any(path.is_relative_to(folder) for folder in elsewhere)
    ]
    assert forgotten == []


def test_every_python_test_is_registered():
    listing = json.loads(run("ctest", "--test-dir", BUILD, "--show-only=json-v1"))
    commands = [argument for test in listing["tests"] for argument in test.get("command", [])]
    forgotten = [
        name(path)
        for path in files(".py", under=ROOT / "tests")
        if path.name.startswith("test_") and str(path) not in commands
    ]
    # Compares several builds, so tools/test runs it after them.
    assert forgotten == ["tests/cross/test_same_bits.py"]
