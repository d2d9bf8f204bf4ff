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
# Of no use on another machine, or harmful.
NOT_PASSED = {"_", "PWD", "OLDPWD", "SHLVL"}
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"

LAUNCH = """\
#!/bin/sh
# Prepares the emulated machine, then becomes the command.
PATH={path}
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


def launch_script(command, buses):
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
    command += [f"--rwdir={folder}" for folder in shared_folders(options)]
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

    def __enter__(self):
        if self.interactive:
            self.settings = termios.tcgetattr(0)
            tty.setraw(0)
        return self

    def type_into(self, pipe):
        def copy():
            while key := os.read(0, 1024):
                try:
                    os.write(pipe.fileno(), key)
                except OSError:
                    return

        if self.interactive:
            threading.Thread(target=copy, daemon=True).start()

    def __exit__(self, *unused):
        if self.interactive:
            termios.tcsetattr(0, termios.TCSADRAIN, self.settings)


def supervise(command, environment, timeout, keyboard):
    process = subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.PIPE if keyboard.interactive else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    relays = [
        Relay(process.stdout, sys.stdout.buffer),
        Relay(process.stderr, sys.stderr.buffer),
    ]
    keyboard.type_into(process.stdin)
    try:
        status = process.wait(timeout)
    except subprocess.TimeoutExpired:
        say(f"stopped after {timeout:g} s")
        status = STOPPED
    finally:
        stop(process)
    for relay in relays:
        relay.join(5.0)
    return status if status >= 0 else 128 - status


def shell():
    """bash on a terminal of the emulated machine, as large as ours."""
    size = shutil.get_terminal_size()
    start = f"stty rows {size.lines} cols {size.columns}; exec bash -i"
    return ["script", "-qefc", start, "/dev/null"]


def run(options):
    interactive = not options.command
    if interactive and not (os.isatty(0) and os.isatty(1)):
        raise Trouble("a shell needs a terminal; to run a command, give it after --")
    check()
    kernel = Path(options.kernel) if options.kernel else newest_kernel()
    if options.verbose or interactive:
        say(f"booting {kernel}; 10 to 20 s")
    signal.signal(signal.SIGTERM, lambda *unused: sys.exit(128 + signal.SIGTERM))
    with tempfile.TemporaryDirectory(prefix="berth-vcan-") as folder:
        script = Path(folder) / "launch"
        script.write_text(launch_script(options.command or shell(), options.buses))
        # A home of its own: a user's settings for vng do not matter here, and nothing is left.
        environment = {**os.environ, "PATH": search_path(), "HOME": folder, "TMPDIR": folder}
        command = vng_command(options, kernel, script)
        with Keyboard(interactive) as keyboard:
            return supervise(command, environment, options.timeout, keyboard)
