"""Whether a drive can be armed within its `command_timeout`: with a long send waiting time F805 it cannot.

Before the mark is written that arms it, a drive is read anew, one value in each exchange (`Resets`), overdue polls go
between, and no frame is sent after the deadline (SAFETY.md H11). Reckoned before anything runs; times are in seconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from gateway.bus import refresh
from gateway.bus.controls import FRAMES_IN_A_ROW
from gateway.control.resets import worth_a_look
from gateway.protocol.pdu import ReadWords
from gateway.site import Drive, Line, Site

TENTHS = 10  # what is advised is rounded up to a tenth of a second


def takes(line: Line, drive: Drive) -> float:
    """Return how long arming may take to its last frame: the exchange under way, the looks, and the polls between.

    All that follows the exchange under way is answered in time.
    """
    codec, processing = drive.codec, drive.model.times.processing + drive.wait_time
    look = ReadWords(drive.number, 0)
    one = line.timing.exchange(len(codec.encode(look)), codec.answer_size(look), processing) + refresh.OWN_TIME
    looks = len(worth_a_look(drive.model, is_marked=True))
    poll = max(refresh.turn(line, each) for each in line.drives) + refresh.OWN_TIME
    return refresh.worst_case(line).blocking.seconds + looks * one + looks // FRAMES_IN_A_ROW * poll


def objection(line: Line, drive: Drive) -> str:
    """Say that a drive can hardly be armed in time, and what would help; "" where it can, or nobody commands it."""
    section = drive.section
    if section is None or not drive.is_controlled or (least := takes(line, drive)) <= section.command_timeout:
        return ""
    advised = math.ceil(least * TENTHS) / TENTHS
    return (
        f"{section.command_timeout:g} s is too short to arm this drive, whose send waiting time is"
        f" {drive.wait_time:g} s: set command_timeout to {advised:g} s or more"
    )


def too_short(site: Site) -> Iterator[str]:
    """Yield each `command_timeout` within which a drive can hardly be armed: key, and what to do."""
    for index, line in enumerate(site.lines):
        for place, drive in enumerate(line.drives):
            if text := objection(line, drive):
                yield f"line[{index}].drive[{place}] ({drive.name}).command_timeout: {text}"
