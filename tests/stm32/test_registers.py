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


def fdcan_name(path):
    """The data's name of a member of fdcan_regs_t: FIFOs are an array there."""
    return re.sub(r"^RXF(\d)([SA])$", r"RXF\2\1", path.upper())


def fdcan_field(field):
    """Likewise of a field; RF0N is element 0 of RFN, and F0FL is FFL of FIFO 0's register."""
    return re.sub(r"^F0(FL|GI|AI)$", r"F\1", re.sub(r"^RF(\d)([NFL]E?)$", r"RF\2\1", field))


def plain_name(path):
    return re.sub(r"\[(\d+)\]", r"\1", path).upper()


class Block:
    """A struct of ours, its macros' prefix, and what it is held against."""

    def __init__(self, header, struct, prefix, published, name=plain_name, field=str):
        self.header, self.struct, self.prefix = header, struct, prefix
        self.published, self.name, self.field = published, name, field

    def registers_of(self, register):
        """Paths whose fields macros named after this register are about."""
        paths = data.members(data.header(self.header), self.struct)
        return [path for path in paths if re.sub(r"\[\d+\]|.*\.", "", path).upper() == register]


BLOCKS = [
    Block("bxcan_regs.h", "bxcan_regs_t", "BXCAN", lambda: data.svd_registers("CAN1"), bxcan_name),
    Block("fdcan_regs.h", "fdcan_regs_t", "FDCAN", lambda: data.crate_registers("can_fdcan_v1"),
          fdcan_name, fdcan_field),
    *(
        Block("stm32f4_regs.h", f"stm32f4_{name.lower()}_t", name,
              lambda name=name: data.svd_registers(name + {"GPIO": "B", "USART": "1"}.get(name, "")))
        for name in ("RCC", "FLASH", "GPIO", "USART", "IWDG")
    ),
]
# Their fields are in no data.
MESSAGE_RAM = {"ELEMENT0", "ELEMENT1", "STANDARD", "EXTENDED0", "EXTENDED1"}
F4_HEADERS = ["bxcan_regs.h", "stm32f4_regs.h"]
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
        if prefix != block.prefix or register in MESSAGE_RAM:
            continue
        paths = block.registers_of(register)
        assert paths, f"{macro} is about no register of {block.struct}"
        for path in paths:
            checked += 1
            theirs = published[block.name(path)][1]
            if theirs.get(block.field(field)) != place:
                wrong.append((macro, path, place, theirs.get(block.field(field))))
    assert wrong == []
    assert checked >= 2 or block.prefix == "GPIO"


def test_message_ram(tmp_path):
    offsets = data.offsets("fdcan_regs.h", "fdcan_ram_t", COMPILER, tmp_path)
    published = data.crate_registers("fdcanram_v1")
    assert offsets == {path: published[plain_name(path)][0] for path in offsets}
    assert len(offsets) == len(published)


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


def test_g4_addresses_and_interrupts():
    text = data.header("fdcan_regs.h")
    addresses = {name: value for name, value in data.values(text).items() if "_ADDRESS" in name}
    interrupts = {name: value for name, value in data.values(text).items() if "_IRQ" in name}
    chip = data.chip_addresses("stm32g474re")
    numbers = data.chip_interrupts("stm32g474re")
    assert len(addresses) == 6
    for name, value in addresses.items():
        assert chip[name.removeprefix("STM32G4_").removesuffix("_ADDRESS")] == value
    assert len(interrupts) == 3
    for name, value in interrupts.items():
        assert numbers[name.removeprefix("STM32G4_").removesuffix("_IRQ")] == value


def test_f4_interrupts():
    ours = constants(F4_HEADERS, "_IRQ")
    assert ours
    names = {macro: macro.removeprefix("STM32F4_").removesuffix("_IRQ") for macro in ours}
    svd, chip = data.svd_interrupts(), data.chip_interrupts("stm32f405rg")
    assert ours == {macro: svd[name] for macro, name in names.items()}
    assert ours == {macro: chip[name] for macro, name in names.items()}


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
