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


def test_bus_tests_are_just_those_that_need_real_interfaces():
    """The label keeps a test out of all runs but the one on real interfaces."""
    listing = json.loads(run("ctest", "--test-dir", BUILD, "--show-only=json-v1"))
    labels, environments = {}, {}
    for test in listing["tests"]:
        properties = {entry["name"]: entry["value"] for entry in test["properties"]}
        labels[test["name"]] = properties.get("LABELS", [])
        environments[test["name"]] = properties.get("ENVIRONMENT", [])
    bus = {name for name, value in labels.items() if "bus" in value}
    assert bus == {name for name, value in environments.items() if "BERTH_VCAN=vcan0" in value}
    assert {name for name in bus if labels[name] != ["bus"]} == set()
    assert "bus_vcan" in bus
