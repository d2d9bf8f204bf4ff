"""Virtual CAN interfaces on the running kernel."""

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from vcan_common import QUEUE_LENGTH, Trouble, interfaces

CAN_INTERFACE = "280"  # ARPHRD_CAN
IFF_UP = 1


@dataclass
class WhyNot:
    """Why the running kernel is not used; surprising when it could have been."""

    text: str
    surprising: bool = False


def state(name, folder=Path("/sys/class/net")):
    """"absent", "down" or "up"."""
    try:
        kind = (folder / name / "type").read_text().strip()
        flags = int((folder / name / "flags").read_text(), 16)
    except OSError:
        return "absent"
    if kind != CAN_INTERFACE:
        raise Trouble(f"there is an interface {name} that is not CAN; please remove or rename it")
    return "up" if flags & IFF_UP else "down"


def tool(name):
    """Administrators' tools are not on everybody's search path."""
    path = os.environ.get("PATH", os.defpath) + ":/usr/sbin:/sbin"
    return shutil.which(name, path=path) or name


def succeeds(command):
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
        )
    except OSError:
        return False
    return done.returncode == 0


def as_root():
    """How to run a command as root without being asked anything: a prefix, or None."""
    if os.geteuid() == 0:
        return []
    return ["sudo", "-n"] if succeeds(["sudo", "-n", "true"]) else None


class Existing:
    """All interfaces are there and up."""

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        pass

    def wrap(self, command):
        return command


class Made:
    """Makes the interfaces that are missing, and removes them again."""

    def __init__(self, root, names):
        self.root = root
        self.names = names
        self.undo = []

    def ip(self, *arguments):
        return succeeds([*self.root, tool("ip"), "link", *arguments])

    def provide(self):
        for name in self.names:
            before = state(name)
            if before == "up":
                continue
            if before == "absent":
                if not self.ip("add", name, "type", "vcan"):
                    return False
                self.undo.append(("del", name))
            else:
                self.undo.append(("set", name, "down"))
            if not self.ip("set", name, "txqueuelen", str(QUEUE_LENGTH), "up"):
                return False
        return True

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        for step in reversed(self.undo):
            self.ip(*step)

    def wrap(self, command):
        return command


class Private:
    """Interfaces in a network namespace of their own, which vanish with it."""

    SCRIPT = """
for name in $1; do
    "$2" link add "$name" type vcan && "$2" link set "$name" txqueuelen "$3" up || exit 125
done
shift 3
exec "$@"
"""

    def __init__(self, root, names):
        self.root = root
        self.names = names

    def wrap(self, command):
        elevate = [*self.root, "--preserve-env"] if self.root else []
        script = ["sh", "-c", self.SCRIPT, "vcan-shell", " ".join(self.names), tool("ip")]
        return [*elevate, tool("unshare"), "--net", "--", *script, str(QUEUE_LENGTH), *command]

    def works(self):
        return succeeds(self.wrap(["true"]))

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        pass


def kernel_offers_vcan():
    return Path("/sys/module/vcan").exists() or succeeds([tool("modprobe"), "-n", "-q", "vcan"])


def plan(buses, private):
    """(context manager that provides the interfaces, None), or (None, WhyNot)."""
    names = interfaces(buses)
    if not private and all(state(name) == "up" for name in names):
        return Existing(), None
    root = as_root()
    if root is None:
        if kernel_offers_vcan():
            text = "the running kernel has vcan, but this takes root or sudo without a password"
            return None, WhyNot(text, surprising=True)
        return None, WhyNot("the running kernel has no vcan")
    succeeds([*root, tool("modprobe"), "-q", "vcan"])
    if private:
        alone = Private(root, names)
        if alone.works():
            return alone, None
    else:
        made = Made(root, names)
        if made.provide():
            return made, None
        made.__exit__()
    return None, WhyNot("the running kernel lets no vcan interface be made")
