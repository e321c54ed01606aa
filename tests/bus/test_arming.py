"""A slow drive can be armed within the `command_timeout` that is advised, and is warned of where it cannot."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from gateway import check, site
from gateway.bus import arming
from gateway.control.command import Command, Reason, Result, Status, Verb
from tests.control.test_control_line import CONTROL, DASHBOARD, Stage, play

WAIT = "200ms"
WAIT_WORD = 20  # F805, in 10 ms
AS_SHIPPED = 1.0  # seconds, `command_timeout` by default

every_protocol = pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])


def built(**drive: Any) -> site.Site:
    """Return a site of one drive that may be commanded."""
    entry = {"name": "d1", "number": 1, "model": "vf-nc3", **CONTROL, "communication_timeout": "5s", **drive}
    return site.build(
        {"gateway": {"name": "t"}, "line": [{"name": "a", "port": "/dev/null", "drive": [entry]}]}, "test", Path()
    )


async def arm(stage: Stage, within: float) -> Result:
    """Take the drive and arm it by a deadline so many seconds away."""
    assert (await stage.ask(Verb.TAKE)).status is Status.DONE
    now = asyncio.get_running_loop().time()
    future: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
    stage.door.submit(Command("d1", Verb.ARM, DASHBOARD, now, now + within), future.set_result)
    return await future


@every_protocol
def test_a_drive_with_a_long_waiting_time_is_armed_within_what_is_advised(protocol: str) -> None:
    """And not within a second: the looks before take longer, and nothing is sent after the deadline."""
    (line,) = built(protocol=protocol, wait_time=WAIT).lines
    least = arming.takes(line, line.drives[0])
    assert least > AS_SHIPPED

    def arming_within(seconds: float) -> Result:
        results = []

        async def script(stage: Stage) -> None:
            await stage.beat_for(10.0)  # it is set up slowly as well
            results.append(await arm(stage, seconds))

        slow = {"wait_time": WAIT, "communication_timeout": "5s", "lease": "9s"}
        play(script, slow, protocol=protocol, registers={"communication_wait_time": WAIT_WORD})
        return results[0]

    late = arming_within(AS_SHIPPED)
    assert (late.status, late.reason) == (Status.REFUSED, Reason.EXPIRED)
    assert arming_within(least).status is Status.DONE


@every_protocol
def test_what_is_too_short_is_told_with_what_to_set(protocol: str) -> None:
    """By `check` and when the gateway starts; what is advised is long enough, and a quick drive is not spoken of."""
    slow = built(protocol=protocol, wait_time=WAIT)
    (line,) = slow.lines
    advised = math.ceil(arming.takes(line, line.drives[0]) * 10) / 10
    (told,) = arming.too_short(slow)
    assert told.startswith("line[0].drive[0] (d1).command_timeout: 1 s is too short")
    assert told.endswith(f"set command_timeout to {advised:g} s or more")
    assert any("WARNING: command_timeout 1 s is too short" in text for text in check.report(slow))
    assert list(arming.too_short(built(protocol=protocol, wait_time=WAIT, command_timeout=f"{advised}s"))) == []
    assert list(arming.too_short(built(protocol=protocol))) == []


def test_a_drive_that_is_only_read_needs_no_time_to_be_armed() -> None:
    """However slow it is."""
    assert list(arming.too_short(built(control="off", wait_time=WAIT))) == []
