"""Nothing is forgotten: every source is compiled and every test is registered."""

import json
import re

from tree import BUILD, ROOT, files, name, run


def test_every_c_file_is_compiled():
    entries = json.loads((BUILD / "compile_commands.json").read_text())
    compiled = {entry["file"] for entry in entries}
    # The consumer is a project of its own, proofs are for the analyser alone; what is for boards is
    # built by their own toolchains.
    elsewhere = (
        ROOT / "tests" / "consumer",
        ROOT / "tests" / "target",
        ROOT / "tests" / "proof",
        ROOT / "firmware" / "boards",
        ROOT / "hal" / "mps2",
        ROOT / "tools" / "bench",
    )
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
    # Those in cross compare several builds, so tools/test runs them after these; those in target
    # belong to the builds for boards.
    assert [path for path in forgotten if not path.startswith(("tests/cross/", "tests/target/"))] == []
    lists = (ROOT / "tests" / "target" / "CMakeLists.txt").read_text()
    found = re.findall(r"foreach\(name ([a-z ]+)\)\n *add_test\(NAME target_", lists)
    names = " ".join(found).split()
    presets = (ROOT / "CMakePresets.json").read_text()
    for boards in re.findall(r'"BERTH_DRIVE_BOARDS": "([^"]+)"', presets):
        names += boards.split(";")
    assert {f"tests/target/test_{name}.py" for name in names} == {
        path for path in forgotten if path.startswith("tests/target/")
    }


def test_every_test_of_the_firmware_runs_on_the_boards():
    """But for those that need the host."""
    host = (ROOT / "tests" / "CMakeLists.txt").read_text()
    firmware = host[host.index("# The firmware.") : host.index("# The HAL.")]
    target = (ROOT / "tests" / "target" / "CMakeLists.txt").read_text()
    listed = set(re.findall(r"berth_add_target_test\(test_(\w+)", target))
    listed |= set(re.search(r"foreach\(name\n([a-z0-9_ \n]+)\)", target).group(1).split())
    names = set(re.findall(r"berth_add_test\(test_(\w+)", firmware))
    assert names - listed == {"closed_loop", "drive_pairs", "drive_cia402_pair"}


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
