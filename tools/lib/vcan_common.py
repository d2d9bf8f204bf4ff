"""What both ways to a kernel with vcan share."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MOST_BUSES = 16
STOPPED = 124
CANNOT_RUN = 125
# Real controllers have a queue of ten frames by default; this many never fills by chance.
QUEUE_LENGTH = 1000


class Trouble(Exception):
    """Something is missing or does not work; the text says what, and what to do."""


def say(text):
    print(f"vcan-shell: {text}", file=sys.stderr, flush=True)


def interfaces(count):
    return [f"vcan{index}" for index in range(count)]
