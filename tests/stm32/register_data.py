"""Published register data (see tools/fetch-registers), and the registers of our headers."""

import re
import subprocess
import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / ".cache" / "registers"
HEADERS = ROOT / "hal" / "stm32"


@cache
def fetched():
    """The folder with the data; fetches it when it is not there. Fails when that fails."""
    done = subprocess.run([ROOT / "tools" / "fetch-registers"], capture_output=True, text=True)
    assert done.returncode == 0, f"no register data:\n{done.stdout}{done.stderr}"
    return DATA


# ---- STM32F4: an SVD file --------------------------------------------------------------------


def number(text):
    return int(text, 0)


@cache
def svd():
    return ElementTree.parse(fetched() / "stm32f4.svd").getroot()


def svd_peripheral(name):
    for peripheral in svd().iter("peripheral"):
        if peripheral.findtext("name") == name:
            return peripheral
    raise KeyError(name)


def joined(fields):
    """With fields that are written down bit by bit (SW0, SW1) also as one (SW)."""
    groups = {}
    for field, (shift, bits) in fields.items():
        found = re.fullmatch(r"(.*?)(\d+)", field)
        if found and bits == 1:
            groups.setdefault(found[1], {})[int(found[2])] = shift
    whole = {
        name: (places[0], len(places))
        for name, places in groups.items()
        if places == {index: places.get(0, -1) + index for index in range(len(places))}
    }
    return whole | fields


def svd_registers(name):
    """{register: (offset, {field: (shift, bits)})}"""
    peripheral = svd_peripheral(name)
    if "derivedFrom" in peripheral.attrib:
        return svd_registers(peripheral.attrib["derivedFrom"])
    return {
        register.findtext("name"): (
            number(register.findtext("addressOffset")),
            joined({
                field.findtext("name"): (
                    number(field.findtext("bitOffset")), number(field.findtext("bitWidth"))
                )
                for field in register.iter("field")
            }),
        )
        for register in peripheral.iter("register")
    }


def svd_address(name):
    return number(svd_peripheral(name).findtext("baseAddress"))


def svd_interrupts():
    return {
        i.findtext("name").removesuffix("_IRQ"): number(i.findtext("value"))
        for i in svd().iter("interrupt")
    }


# ---- STM32G4: tables of a crate --------------------------------------------------------------

ITEM = re.compile(
    r'BlockItem \{\s*name: "(?P<name>\w+)",(?P<rest>.*?)byte_offset: (?P<offset>\d+),'
    r"\s*inner: (?P<inner>.*?)(?=BlockItem \{|extends:|\Z)",
    re.DOTALL,
)
SET = re.compile(r'FieldSet \{\s*name: "(\w+)",(.*?)(?=FieldSet \{|enums: |\Z)', re.DOTALL)
FIELD_PARTS = re.compile(
    r'name: "(?P<name>\w+)".*?offset: (?P<shift>\d+).*?bit_size: (?P<bits>\d+)', re.DOTALL
)


def places_of(text):
    """Where the elements of an array are, beyond the first; None where there is no array."""
    regular = re.search(r"len: (\d+),\s*stride: (\d+)", text)
    if regular:
        return [int(regular[2]) * index for index in range(int(regular[1]))]
    listed = re.search(r"offsets: &\[([\d,\s]+)\]", text)
    return [int(place) for place in re.findall(r"\d+", listed[1])] if listed else None


def crate_fields(text):
    fields = {}
    for part in re.split(r"\bField \{", text)[1:]:
        field = FIELD_PARTS.search(part)
        places = places_of(part)
        for index, place in enumerate(places or [0]):
            name = field["name"].upper() + (str(index) if places else "")
            fields[name] = (int(field["shift"]) + place, int(field["bits"]))
    return fields


def crate_blocks(table):
    """{block: [(name, offset, places, field set, inner block)]} and {field set: fields} of a table."""
    text = (fetched() / "metapac" / f"{table}.rs").read_text()
    blocks, _, sets = text.partition("fieldsets: &[")
    found = {}
    for part in re.split(r"\bBlock \{", blocks)[1:]:
        name = re.search(r'name: "(\w+)"', part)[1]
        found[name] = []
        for item in ITEM.finditer(part):
            fieldset = re.search(r'fieldset: Some\(\s*"(\w+)"', item["inner"])
            inner = re.search(r'block: "(\w+)"', item["inner"])
            found[name].append((
                item["name"], int(item["offset"]), places_of(item["rest"]),
                fieldset[1] if fieldset else None, inner[1] if inner else None,
            ))
    return found, {name: crate_fields(body) for name, body in SET.findall(sets)}


def crate_registers(table):
    """As svd_registers; registers of arrays have their index in the name."""
    blocks, sets = crate_blocks(table)
    main = next(iter(sorted(blocks, key=lambda name: -len(blocks[name]))))
    found = {}

    def add(block, base, suffix):
        for name, offset, places, fieldset, inner in blocks[block]:
            for index, place in enumerate(places or [0]):
                own = suffix + (str(index) if places else "")
                at = base + offset + place
                if inner:
                    add(inner, at, own)
                else:
                    found[name.upper() + own] = (at, sets.get(fieldset, {}))

    add(main, 0, "")
    return found


def chip_addresses(chip):
    text = (fetched() / "metapac" / f"{chip}.rs").read_text()
    found = re.findall(r"pub const (\w+): [\w:]+ =\s*unsafe \{\s*[\w:]+\((0x[0-9a-f_]+)", text)
    return {name: number(value.replace("_", "")) for name, value in found}


def chip_interrupts(chip):
    text = (fetched() / "metapac" / f"{chip}.rs").read_text()
    return {name: int(value) for name, value in re.findall(r"\b([A-Z]\w+) = (\d+),", text)}


# ---- Ours ------------------------------------------------------------------------------------

STRUCT = re.compile(r"typedef struct \{(.*?)\} (\w+);", re.DOTALL)
MEMBER = re.compile(r"^\s*(?:volatile )?(\w+) (\w+)(?:\[([\w* ]+)\])?;", re.MULTILINE)
MASK = re.compile(r"^#define (\w+) STM32_(?:BIT\((\d+)\)|FIELD\((\d+), (\d+)\))", re.MULTILINE)
VALUE = re.compile(r"^#define (\w+) (0x[0-9a-f]+|\d+)u?$", re.MULTILINE)


def header(name):
    return (HEADERS / name).read_text()


def masks(text):
    """{macro: (shift, bits)}"""
    return {
        name: (int(bit), 1) if bit else (int(shift), int(bits))
        for name, bit, shift, bits in MASK.findall(text)
    }


def values(text):
    return {name: number(value) for name, value in VALUE.findall(text)}


def evaluate(text, product):
    """A product of numbers and of constants that are defined there."""
    result = 1
    for factor in product.split("*"):
        factor = factor.strip()
        digits = re.fullmatch(r"(\d+)u?", factor)
        result *= int(digits[1]) if digits else values(text)[factor]
    return result


def members(text, struct):
    """Paths of all registers of a struct, with arrays and structs inside spelled out."""
    structs = {name: body for body, name in STRUCT.findall(text)}
    paths = []
    for kind, name, length in MEMBER.findall(structs[struct]):
        if name.startswith("reserved"):
            continue
        count = evaluate(text, length) if length else 0
        places = [f"{name}[{i}]" for i in range(count)] if length else [name]
        for place in places:
            if kind == "uint32_t":
                paths.append(place)
            else:
                paths += [f"{place}.{inner}" for inner in members(text, kind)]
    return paths


def offsets(header_name, struct, compiler, folder):
    """{path: offset}, as the compiler has it."""
    paths = members(header(header_name), struct)
    lines = "".join(f'    printf("%zu\\n", offsetof({struct}, {path}));\n' for path in paths)
    source = folder / "offsets.c"
    source.write_text(
        f'#include "{header_name}"\n#include <stddef.h>\n#include <stdio.h>\n'
        f"int main(void) {{\n{lines}    return 0;\n}}\n"
    )
    program = folder / "offsets"
    subprocess.run([compiler, "-std=c11", "-I", HEADERS, source, "-o", program], check=True)
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    return dict(zip(paths, map(int, printed), strict=True))
