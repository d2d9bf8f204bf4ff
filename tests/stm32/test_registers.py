"""Every register, field, address and interrupt number in hal/stm32 against published data."""

import os
import re

import pytest
import register_data as data

COMPILER = os.environ.get("BERTH_CC", "gcc")


def bxcan_name(path):
    """The data's name of a member of bxcan_regs_t."""
    found = re.fullmatch(r"(?:tx|rx|bank)\[(\d+)\]\.(?:([tr](?:i|dt|dl|dh))r|fr([12]))", path)
    if not found:
        return path.upper()
    index, mailbox, half = found.groups()
    return f"F{index}R{half}" if half else f"{mailbox.upper()}{index}R"


def plain_name(path):
    return re.sub(r"\[(\d+)\]", r"\1", path).upper()


class Block:
    """A struct of ours, its macros' prefix, and what it is held against."""

    def __init__(self, header, struct, prefix, published, name=plain_name):
        self.header, self.struct, self.prefix = header, struct, prefix
        self.published, self.name = published, name

    def registers_of(self, register):
        """Paths whose fields macros named after this register are about."""
        paths = data.members(data.header(self.header), self.struct)
        return [path for path in paths if re.sub(r"\[\d+\]|.*\.", "", path).upper() == register]


BLOCKS = [
    Block("bxcan_regs.h", "bxcan_regs_t", "BXCAN", lambda: data.svd_registers("CAN1"), bxcan_name),
]
F4_HEADERS = ["bxcan_regs.h"]
IDS = [block.struct for block in BLOCKS]


@pytest.mark.parametrize("block", BLOCKS, ids=IDS)
def test_register_offsets(block, tmp_path):
    published = block.published()
    offsets = data.offsets(block.header, block.struct, COMPILER, tmp_path)
    assert len(offsets) >= 4
    theirs = {path: published[block.name(path)][0] for path in offsets}
    assert offsets == theirs


@pytest.mark.parametrize("block", BLOCKS, ids=IDS)
def test_fields(block):
    published = block.published()
    wrong = []
    checked = 0
    for macro, place in data.masks(data.header(block.header)).items():
        prefix, register, field = macro.split("_", 2)
        if prefix != block.prefix:
            continue
        paths = block.registers_of(register)
        assert paths, f"{macro} is about no register of {block.struct}"
        for path in paths:
            checked += 1
            theirs = published[block.name(path)][1]
            if theirs.get(field) != place:
                wrong.append((macro, path, place, theirs.get(field)))
    assert wrong == []
    assert checked >= 4


def constants(headers, suffix):
    found = {}
    for name in headers:
        found |= data.values(data.header(name))
    return {name: value for name, value in found.items() if name.endswith(suffix)}


def test_f4_addresses():
    ours = constants(F4_HEADERS, "_ADDRESS")
    assert ours
    names = {macro: macro.removeprefix("STM32F4_").removesuffix("_ADDRESS") for macro in ours}
    assert ours == {macro: data.svd_address(name) for macro, name in names.items()}
    chip = data.chip_addresses("stm32f405rg")
    assert ours == {macro: chip[name] for macro, name in names.items()}


def test_f4_interrupts():
    ours = constants(F4_HEADERS, "_IRQ")
    assert ours
    names = {macro: macro.removeprefix("STM32F4_").removesuffix("_IRQ") for macro in ours}
    chip = data.chip_interrupts("stm32f405rg")
    assert ours == {macro: chip[name] for macro, name in names.items()}
    svd = data.svd_interrupts()  # which does not have them all
    known = {macro: name for macro, name in names.items() if name in svd}
    assert {macro: ours[macro] for macro in known} == {m: svd[name] for m, name in known.items()}


def test_no_macro_is_left_out():
    """All masks of the register headers belong to a block above; nothing is defined by hand."""
    prefixes = {block.prefix for block in BLOCKS}
    for path in data.HEADERS.glob("*_regs.h"):
        text = path.read_text()
        assert path.name in {block.header for block in BLOCKS}
        assert {macro.split("_")[0] for macro in data.masks(text)} <= prefixes
        shifts = re.findall(r"^#define .*<<.*", text, re.MULTILINE)
        assert shifts == []


def test_a_wrong_field_would_be_seen():
    published = data.svd_registers("CAN1")
    assert published["BTR"][1]["TS2"] == (20, 3)
    assert data.masks("#define BXCAN_BTR_TS2 STM32_FIELD(20, 4)\n") == {"BXCAN_BTR_TS2": (20, 4)}
    assert data.masks("#define BXCAN_MCR_INRQ STM32_BIT(1)\n") == {"BXCAN_MCR_INRQ": (1, 1)}
