"""Worst-case stack of the firmware's public functions on a target, from the compiler's call graph.

Every function's frame and calls come from gcc (-fcallgraph-info=su). A call through a pointer is
resolved by what the source says where it stands: a drive protocol's or a tracker's function can be
any of those in the tables that the sources define; a platform's (HAL) is not counted, since it is
the platform's. Recursion and frames without a bound are errors, and so is a pointer call that this
file does not know.
"""

import re
import subprocess
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "firmware/src"
FLAGS = ["-std=c11", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fcallgraph-info=su",
         "-I", str(ROOT / "firmware/include"), "-I", str(ROOT / "hal/include")]
# What the C library's and the compiler's own routines take, from their disassembly, rounded up.
LIBRARY = {"memset": 16, "memmove": 32, "memcpy": 32, "__aeabi_ldivmod": 64, "__aeabi_uldivmod": 64}
# Pointer calls by the member that is called through.
PLATFORM = {"api->state", "api->receive", "api->send"}


class CallGraph:
    def __init__(self, compiler, flags):
        self.frames = {}
        self.calls = {}
        self.tables = {}
        with tempfile.TemporaryDirectory() as folder:
            for source in sorted(SOURCES.glob("*.c")):
                self._add(source, Path(folder), compiler, flags)

    def _add(self, source, folder, compiler, flags):
        target = folder / f"{source.stem}.o"
        subprocess.run([compiler, *flags, *FLAGS, "-c", str(source), "-o", str(target)], check=True)
        text = target.with_suffix(".ci").read_text()
        lines = source.read_text().splitlines()
        for name, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]+)" \}', text):
            size = re.search(r"(\d+) bytes \((\w+)\)", label)
            if size is None or size[2] != "static":
                raise SystemExit(f"target_stack: {name} has no bounded frame: {label}")
            self.frames[name] = int(size[1])
        for caller, callee, label in re.findall(
            r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"(?: label: "([^"]*)")? \}', text
        ):
            calls = self.calls.setdefault(caller, set())
            calls.add(self._pointer(source, lines, label) if callee == "__indirect_call" else callee)
        self._library_calls(text, target)
        self._tables(source, lines)

    def _library_calls(self, text, target):
        """Calls that the compiler makes up late are not in its graph: taken to be everybody's."""
        undefined = subprocess.run(["arm-none-eabi-nm", "-u", str(target)], capture_output=True,
                                   text=True, check=True).stdout.split()
        for name in set(undefined) & set(LIBRARY):
            for function in re.findall(r'node: \{ title: "([^"]+)" label: "[^"]*bytes', text):
                self.calls.setdefault(function, set()).add(name)

    @staticmethod
    def _pointer(source, lines, label):
        place = re.search(r":(\d+):\d+$", label)
        around = " ".join(lines[int(place[1]) - 1 : int(place[1]) + 1])
        member = re.search(r"(?:protocol|api)->\w+(?=\()", around)
        if member is None:
            raise SystemExit(f"target_stack: an unknown call through a pointer at {label}")
        return member[0]

    def _tables(self, source, lines):
        text = "\n".join(lines)
        for body in re.findall(r"berth_drive_protocol_t berth_drive_\w+ = \{(.*?)\};", text, re.S):
            for member, function in re.findall(r"\.(\w+) = (\w+),", body):
                self._may_be(f"protocol->{member}", source, function)
        for body in re.findall(r"berth_tracker_api_t api = \{(.*?)\};", text, re.S):
            for member, function in zip(("init", "reset", "step"), re.findall(r"\w+", body)):
                self._may_be(f"api->{member}", source, function)

    def _may_be(self, member, source, function):
        local = next((n for n in self.frames if n.endswith(f"{source.name}:{function}")), function)
        self.tables.setdefault(member, set()).add(local)

    def depth(self, function, path=()):
        """Bytes of stack that a call takes, all that it calls included."""
        if function in path:
            raise SystemExit(f"target_stack: recursion: {' '.join((*path, function))}")
        if "->" in function:
            if function not in self.tables and function not in PLATFORM:
                raise SystemExit(f"target_stack: nothing is known to stand behind {function}")
            callees = self.tables.get(function, set())
            return max((self.depth(callee, path) for callee in callees), default=0)
        if function in LIBRARY:
            return LIBRARY[function]
        if function not in self.frames:
            raise SystemExit(f"target_stack: {function} is called and not known")
        callees = self.calls.get(function, ())
        return self.frames[function] + max(
            (self.depth(callee, (*path, function)) for callee in callees), default=0)
