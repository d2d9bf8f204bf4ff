"""Arrows point one way: host_sim -> firmware -> hal/include <- hal/<platform>."""

import re

import pytest

from tree import FIRMWARE, ROOT, files, name

INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.MULTILINE)
FIRMWARE_SYSTEM = {"stdint.h", "stdbool.h", "stddef.h", "math.h"}
PUBLIC = {name_.name for name_ in files(".h", under=FIRMWARE / "include" / "berth")}
HAL_INCLUDE = ROOT / "hal" / "include"
HAL = ROOT / "hal"
PLATFORMS = [path for path in files(".c", ".h", under=HAL) if not path.is_relative_to(HAL_INCLUDE)]


def includes(path):
    return INCLUDE.findall(path.read_text())


def is_public(header):
    return header.startswith("berth/") and header[len("berth/") :] in PUBLIC


def is_hal(header):
    return ".." not in header and (HAL_INCLUDE / header).is_file()


def firmware_may(path, kind, header):
    if kind == "<":
        return header in FIRMWARE_SYSTEM
    beside = "/" not in header and (path.parent / header).is_file()
    public_header = path.is_relative_to(FIRMWARE / "include")
    return is_public(header) or is_hal(header) or (beside and not public_header)


FIRMWARE_FILES = files(".c", ".h", under=FIRMWARE / "src") + files(
    ".h", under=FIRMWARE / "include"
)


@pytest.mark.parametrize("path", FIRMWARE_FILES, ids=name)
def test_firmware_includes_only_itself_and_four_system_headers(path):
    foreign = [header for kind, header in includes(path) if not firmware_may(path, kind, header)]
    assert foreign == []


def hal_may(kind, header):
    return header in FIRMWARE_SYSTEM if kind == "<" else is_hal(header)


def test_hal_contract_includes_only_itself():
    foreign = [
        (name(path), header)
        for path in files(".h", under=HAL_INCLUDE)
        for kind, header in includes(path)
        if not hal_may(kind, header)
    ]
    assert foreign == []


@pytest.mark.parametrize("path", PLATFORMS, ids=name)
def test_platform_knows_the_contract_and_other_platforms_alone(path):
    """Quoted headers lie in hal/include or in a platform's folder: nothing of the firmware."""
    assert [header for kind, header in includes(path) if not platform_may(kind, header)] == []


PORTABLE = [path for folder in ("blank", "slcan") for path in files(".c", ".h", under=HAL / folder)]


@pytest.mark.parametrize("path", PORTABLE, ids=name)
def test_portable_platform_includes_no_system(path):
    """They run on microcontrollers: the firmware's system headers alone."""
    assert [h for kind, h in includes(path) if kind == "<" and h not in FIRMWARE_SYSTEM] == []


def platform_may(kind, header):
    return kind == "<" or is_hal(header) or is_platform(header)


def is_platform(header):
    return header in {platform.name for platform in PLATFORMS if platform.suffix == ".h"}


@pytest.mark.parametrize("path", files(".c", ".h", under=ROOT / "host_sim"), ids=name)
def test_simulator_uses_only_the_public_firmware(path):
    """Quoted headers lie in host_sim, firmware/include, hal/include or a platform's folder: no
    private ones of the firmware."""
    foreign = [
        header
        for kind, header in includes(path)
        if kind == '"'
        and not (in_simulator(path, header) or is_public(header) or is_hal(header)
                 or is_platform(header))
    ]
    assert foreign == []


def in_simulator(path, header):
    return (path.parent / header).is_file() or (ROOT / "host_sim" / header).is_file()


def test_the_rule_catches_a_violation():
    path = FIRMWARE / "src" / "angle.c"
    assert not firmware_may(path, "<", "stdio.h")
    assert not firmware_may(path, '"', "../../host_sim/plant.h")
    assert not firmware_may(path, '"', "plant.h")
    assert firmware_may(path, "<", "math.h")
    assert not hal_may('"', "berth/types.h")
    assert not hal_may("<", "stdio.h")
    assert hal_may("<", "stdint.h")
    assert platform_may('"', "berth_hal/can.h")
    assert not platform_may('"', "berth/types.h")
