"""Virtual CAN interfaces on an emulated kernel, booted by virtme-ng with this machine's files."""

import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import termios
import threading
import time
import tty
from pathlib import Path

from vcan_common import QUEUE_LENGTH, ROOT, STOPPED, Trouble, interfaces, say

# What each Debian package is needed for.
NEEDED = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "modprobe": "kmod",
    "ip": "iproute2",
    "udevadm": "udev",
    "file": "file",
}
# Loaded ahead, because a socket that has to wait for its module waits for half a second.
MODULES = ("can", "can_raw", "can_bcm", "vcan")
# A boot takes 10 s of processor time on an idle host, and several times that on a crowded one.
BOOT_PROCESSOR_S = 90.0
BOOT_S = 900.0
BOOTS = 3
HUNG = -1000
# Of no use on another machine, or harmful.
NOT_PASSED = {"_", "PWD", "OLDPWD", "SHLVL"}
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"

LAUNCH = """\
#!/bin/sh
# Prepares the emulated machine, then becomes the command.
PATH={path}
: >{mark}
trouble() {{ echo "vcan-shell: in the emulated machine: $*" >&2; exit 125; }}
for module in {modules}; do
    modprobe "$module" || trouble "modprobe $module failed"
done
for name in {names}; do
    ip link add "$name" type vcan && ip link set "$name" txqueuelen {queue} up ||
        trouble "cannot make $name"
done
ip link set lo up
cd {folder} || trouble "no folder "{folder}
{exports}
exec {command}
"""


def search_path():
    """virtme-ng's programs call each other by name; this tree's own ones come first."""
    return f"{ROOT / '.venv' / 'bin'}:{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin"


def missing():
    """One line for each thing that is not installed."""
    lines = [
        f"{command} (Debian package {package})"
        for command, package in NEEDED.items()
        if not shutil.which(command, path=search_path())
    ]
    if not shutil.which("vng", path=search_path()):
        lines.append("vng (Python package virtme-ng)")
    return lines


def natural(path):
    """Sorts 6.1.0-9 before 6.1.0-10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]


def has_vcan(kernel, modules=Path("/lib/modules")):
    version = kernel.name.partition("-")[2]
    return any((modules / version / "kernel" / "drivers" / "net" / "can").glob("vcan.ko*"))


def newest_kernel(boot=Path("/boot"), modules=Path("/lib/modules")):
    """The newest kernel that can be read and has the vcan module."""
    found = [path for path in boot.glob("vmlinuz-*") if has_vcan(path, modules)]
    if not found:
        raise Trouble(
            f"no kernel in {boot} has vcan; install Debian's linux-image-amd64: tools/setup test"
        )
    kernel = max(found, key=natural)
    if not os.access(kernel, os.R_OK):
        raise Trouble(f"{kernel} is not readable for you: chmod a+r it, or run this as root")
    return kernel


def check():
    if platform.machine() != "x86_64":
        raise Trouble(
            f"only x86-64 machines are supported for emulation, not {platform.machine()}; "
            "use a kernel that has vcan (modprobe vcan)"
        )
    lines = missing()
    if lines:
        raise Trouble("not installed: " + ", ".join(lines) + "; run tools/setup test")


def launch_script(command, buses, mark):
    passed = {key: value for key, value in os.environ.items() if key not in NOT_PASSED}
    passed["BERTH_VCAN"] = "vcan0"
    passed["BERTH_VCAN_BUSES"] = str(buses)
    passed["PATH"] = f"{passed.get('PATH', '')}:{SYSTEM_PATH}".lstrip(":")
    names = (key for key in sorted(passed) if re.fullmatch(r"[A-Za-z_]\w*", key))
    return LAUNCH.format(
        path=SYSTEM_PATH,
        modules=" ".join(MODULES),
        names=" ".join(interfaces(buses)),
        queue=QUEUE_LENGTH,
        mark=shlex.quote(str(mark)),
        folder=shlex.quote(os.getcwd()),
        exports="\n".join(f"export {key}={shlex.quote(passed[key])}" for key in names),
        command=shlex.join(command),
    )


def shared_folders(options):
    folders = [ROOT / name for name in ("build", "out") if (ROOT / name).is_dir()]
    for name in options.rw:
        if not Path(name).is_dir():
            raise Trouble(f"--rw {name}: no such folder")
        folders.append(Path(name).resolve())
    return folders


def vng_command(options, kernel, script):
    """Without microvm and virtiofs, which Debian's kernel and bare machines lack. The append keeps
    the guest's clock usable when it is emulated."""
    command = ["vng", "--run", str(kernel), "--disable-microvm", "--force-9p"]
    command += ["--memory", "1G", "--cpus", "2", "--user", "root"]
    command += [f"--rwdir={folder}" for folder in [*shared_folders(options), script.parent]]
    if not options.kvm:
        command += ["--disable-kvm"]
        command += ["--append", "tsc=reliable clocksource=tsc mitigations=off"]
    if options.verbose:
        command += ["--verbose"]
    return command + ["--exec", f"sh {shlex.quote(str(script))}"]


class Relay(threading.Thread):
    """Copies a pipe to one of our own streams. The emulator would truncate a file."""

    def __init__(self, source, target):
        super().__init__(daemon=True)
        self.source = source
        self.target = target
        self.start()

    def run(self):
        while chunk := self.source.read1(65536):
            try:
                self.target.write(chunk)
                self.target.flush()
            except OSError:
                return


def stop(process):
    """Ends the emulator and all that it started, which are a process group."""
    for number, patience in ((signal.SIGTERM, 3.0), (signal.SIGKILL, None)):
        try:
            os.killpg(process.pid, number)
        except ProcessLookupError:
            pass
        try:
            process.wait(patience)
            return
        except subprocess.TimeoutExpired:
            continue


class Keyboard:
    """Our terminal for the shell in the emulated machine: every key goes there, Ctrl-C too, where a
    terminal is made for it. Stands aside when there is a command instead of a shell."""

    def __init__(self, interactive):
        self.interactive = interactive
        self.pipe = None

    def __enter__(self):
        if self.interactive:
            self.settings = termios.tcgetattr(0)
            tty.setraw(0)
            threading.Thread(target=self.copy, daemon=True).start()
        return self

    def copy(self):
        while key := os.read(0, 1024):
            try:
                os.write(self.pipe.fileno(), key)
            except (AttributeError, OSError, ValueError):
                continue  # between two machines: typed too early

    def __exit__(self, *unused):
        if self.interactive:
            termios.tcsetattr(0, termios.TCSADRAIN, self.settings)


def processor_seconds(group):
    """What the processes of a group have used so far."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == group:
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def wait(process, mark, deadline):
    """The exit status; STOPPED at the deadline; HUNG when the machine is busy but does not come up,
    which happens to one boot in some dozens on a crowded host."""
    start = time.monotonic()
    while True:
        try:
            return process.wait(0.1 if mark.exists() else 0.5)
        except subprocess.TimeoutExpired:
            now = time.monotonic()
        if deadline is not None and now >= deadline:
            return STOPPED
        if not mark.exists():
            if now - start > BOOT_S or processor_seconds(process.pid) > BOOT_PROCESSOR_S:
                return HUNG


def supervise(command, environment, keyboard, mark, deadline):
    """One boot. The emulator's exit status, STOPPED or HUNG."""
    process = subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.PIPE if keyboard.interactive else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    keyboard.pipe = process.stdin
    relays = [
        Relay(process.stdout, sys.stdout.buffer),
        Relay(process.stderr, sys.stderr.buffer),
    ]
    try:
        status = wait(process, mark, deadline)
    finally:
        stop(process)
    for relay in relays:
        relay.join(5.0)
    return status if status >= 0 or status == HUNG else 128 - status


def shell():
    """bash on a terminal of the emulated machine, as large as ours."""
    size = shutil.get_terminal_size()
    start = f"stty rows {size.lines} cols {size.columns}; exec bash -i"
    return ["script", "-qefc", start, "/dev/null"]


def boot(command, environment, interactive, mark, timeout):
    """Boots until the machine comes up, and returns how it ended."""
    deadline = None if timeout is None else time.monotonic() + timeout
    with Keyboard(interactive) as keyboard:
        for _ in range(BOOTS):
            status = supervise(command, environment, keyboard, mark, deadline)
            if status != HUNG:
                break
            say("the emulated machine does not come up: ended")
    if status == STOPPED and deadline is not None and time.monotonic() >= deadline:
        say(f"stopped after {timeout:g} s")
    return status


def run(options):
    interactive = not options.command
    if interactive and not (os.isatty(0) and os.isatty(1)):
        raise Trouble("a shell needs a terminal; to run a command, give it after --")
    check()
    kernel = Path(options.kernel) if options.kernel else newest_kernel()
    if options.verbose or interactive:
        say(f"booting {kernel}; 10 to 20 s")
    with tempfile.TemporaryDirectory(prefix="berth-vcan-") as folder:
        script, mark = Path(folder) / "launch", Path(folder) / "up"
        script.write_text(launch_script(options.command or shell(), options.buses, mark))
        # A home of its own: a user's settings for vng do not matter here, and nothing is left.
        environment = {**os.environ, "PATH": search_path(), "HOME": folder, "TMPDIR": folder}
        command = vng_command(options, kernel, script)
        status = boot(command, environment, interactive, mark, options.timeout)
    if status == HUNG:
        raise Trouble(f"{kernel} did not come up, {BOOTS} times; --verbose shows its messages")
    return status
