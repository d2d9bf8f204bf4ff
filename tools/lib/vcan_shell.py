"""Runs a command, or a shell, on a kernel that has virtual CAN interfaces.

Where the running kernel has vcan the interfaces are made on it (vcan_direct), else Debian's kernel
is booted in an emulator with this machine's files (vcan_guest). Standard library only, so that any
Python 3 of the system runs it.
"""

import argparse
import os
import signal
import subprocess
import sys

import vcan_direct
import vcan_guest
from vcan_common import CANNOT_RUN, MOST_BUSES, STOPPED, Trouble, say

ABOUT = """\
Gives a shell, or runs COMMAND, on a kernel that has the CAN interfaces vcan0, vcan1 and so on, all
of them up. COMMAND's output and exit status come through. It finds BERTH_VCAN=vcan0 and
BERTH_VCAN_BUSES in its environment, besides yours.

Where the running kernel has vcan it is used: interfaces that exist stay as they are, those made
here are removed at the end. That takes root, or sudo without a password, unless the interfaces are
there already. Everywhere else an emulated machine boots the newest kernel in /boot that has vcan,
in 10 to 20 seconds, with this machine's files: COMMAND runs as root there, its standard input is
empty, and all it writes is lost, except below build/ and out/ of this tree and what --rw names.
Code runs 4 to 30 times slower there. `tools/setup test` installs what it needs.
"""
STATUSES = """\
exit status: that of COMMAND (128 + N when signal N ended it); 124 after --timeout; 125 when there
is no such kernel or it could not be set up, with the reason on the error stream; 126 and 127 when
COMMAND cannot be run.

examples:
  tools/vcan-shell                                       a shell
  tools/vcan-shell -- sh -c 'candump -n 1 vcan0 & sleep 1; cansend vcan0 123#11'
  tools/vcan-shell --buses 4 --timeout 60 -- ip -br link
"""


def bus_count(text):
    count = int(text)
    if not 1 <= count <= MOST_BUSES:
        raise argparse.ArgumentTypeError(f"{count} is not between 1 and {MOST_BUSES}")
    return count


def seconds(text):
    value = float(text)
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text} is not a time in seconds")
    return value


def parse(arguments):
    parser = argparse.ArgumentParser(
        prog="tools/vcan-shell",
        description=ABOUT,
        epilog=STATUSES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="%(prog)s [options] [-- COMMAND...]",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--buses", type=bus_count, default=1, metavar="N", help="make vcan0 to vcan(N-1); default 1"
    )
    parser.add_argument(
        "--timeout", type=seconds, metavar="S", help="end everything after S seconds, boot included"
    )
    parser.add_argument(
        "--rw",
        action="append",
        default=[],
        metavar="DIR",
        help="a folder to share for writing with the emulated machine; may be repeated",
    )
    parser.add_argument(
        "--private",
        action="store_true",
        help="interfaces that nobody else sees, in a network namespace of their own",
    )
    parser.add_argument(
        "--emulate", action="store_true", help="do not use the running kernel, whatever it has"
    )
    parser.add_argument(
        "--kvm",
        action="store_true",
        help="let the emulator use KVM: much faster where it works, but a KVM that hangs is common",
    )
    parser.add_argument(
        "--kernel", metavar="FILE", help="the kernel to boot, instead of the newest in /boot"
    )
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="tell what is done; show the emulated boot"
    )
    parser.add_argument("command", nargs="*", metavar="COMMAND", help=argparse.SUPPRESS)
    return parser.parse_args(arguments)


def run_here(plan, options):
    """Runs the command on the running kernel, in a plan that vcan_direct has made."""
    command = options.command or [os.environ.get("SHELL") or "/bin/sh"]
    environment = {
        **os.environ,
        "BERTH_VCAN": "vcan0",
        "BERTH_VCAN_BUSES": str(options.buses),
    }
    with plan:
        try:
            done = subprocess.run(
                plan.wrap(command), env=environment, timeout=options.timeout, check=False
            )
        except subprocess.TimeoutExpired:
            say(f"stopped after {options.timeout:g} s")
            return STOPPED
        except OSError as error:
            say(f"{command[0]}: {error.strerror}")
            return 127 if isinstance(error, FileNotFoundError) else 126
    return done.returncode if done.returncode >= 0 else 128 - done.returncode


def main(arguments):
    options = parse(arguments)
    # As an exception, so that what was made or started is cleaned up.
    signal.signal(signal.SIGTERM, lambda *unused: sys.exit(128 + signal.SIGTERM))
    try:
        if not options.emulate:
            plan, why_not = vcan_direct.plan(options.buses, options.private)
            if plan:
                return run_here(plan, options)
            if options.verbose or why_not.surprising:
                say(f"{why_not.text}: emulating a kernel")
        return vcan_guest.run(options)
    except Trouble as trouble:
        say(str(trouble))
        return CANNOT_RUN
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
