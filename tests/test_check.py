"""What `check` says of a configuration before anything runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway import check, site

FIVE = ["status", "output_frequency", "output_current", "output_voltage", "alarm"]


def built(polls: list[dict[str, Any]], drives: int = 1, baud: int = 19200) -> site.Site:
    """Return a site of equal VF-nC3 on one line."""
    entries = [{"name": f"d{n}", "number": n, "model": "vf-nc3", "poll": polls} for n in range(1, drives + 1)]
    line = {"name": "a", "port": "/dev/ttyUSB0", "baud": baud, "drive": entries}
    return site.build({"gateway": {"name": "g"}, "line": [line]}, "test", Path())


def text(configured: site.Site) -> str:
    """Return the whole report."""
    return "\n".join(check.report(configured))


def test_the_selectors_to_set_are_said_and_used() -> None:
    """F875-F879 for the most often wanted values, and one exchange then."""
    said = text(built([{"values": FIVE, "every": "100ms"}]))
    assert "F875=1, F876=2, F877=3, F878=4, F879=5" in said
    assert "indirect block, 5 words: status, output_frequency" in said


def test_the_load_is_the_wire_time_over_the_period() -> None:
    """Five words at 19200 baud: 8 and 15 characters, two gaps, 15 ms in the drive at the most: 33 ms in 100."""
    configured = built([{"values": FIVE, "every": "100ms"}])
    plan = check.plan_drive(configured.drives[0], configured.lines[0], with_selectors=True)
    assert plan.load == pytest.approx((8 * 11 + 15 * 12 + 2 * 3.5 * 11) / 19200 / 0.1 + 0.15)


def test_what_does_not_fit_is_said_with_a_remedy() -> None:
    """Eight drives ten times a second at 9600 baud."""
    said = text(built([{"values": FIVE, "every": "100ms"}], drives=8, baud=9600))
    assert "DOES NOT FIT" in said
    assert "38400" in said


def test_what_fits_only_by_the_block_is_said() -> None:
    """A line that single reads would overload."""
    wide = ["status", "output_current", "alarm", "pid_feedback", "output_voltage"]
    said = text(built([{"values": wide, "every": "150ms"}], drives=4))
    assert "FITS ONLY with F875-F879" in said


def test_polls_without_a_period_get_the_rest_and_their_period_is_said() -> None:
    """As fast as the line allows: 33 ms at the worst."""
    assert "the rest by polls without a period, each every 33 ms" in text(built([{"values": FIVE, "every": "0s"}]))


def test_a_value_that_a_faster_block_brings_is_not_read_twice() -> None:
    """The slow group's status comes with the fast one."""
    configured = built([{"values": FIVE, "every": "100ms"}, {"values": ["status", "trip_code"], "every": "5s"}])
    plan = check.plan_drive(configured.drives[0], configured.lines[0], with_selectors=True)
    (_, slow) = plan.groups
    assert [r.name for read in slow[1] for r in read.registers] == ["trip_code"]
    assert "status: come with a faster block" in text(configured)


def toshiba(protocol: str, **more: Any) -> site.Site:
    """Return a line of three VF-nC3 with the numbers 11, 12 and 21 in a TOSHIBA protocol, two of them a group."""
    entries = [
        {"name": f"d{n}", "number": n, "model": "vf-nc3", "protocol": protocol, **more} for n in (11, 12, 21)
    ]
    group = {"name": "fans", "drives": ["d11", "d12"]}
    line = {"name": "a", "port": "/dev/ttyUSB0", "drive": entries, "group": [group]}
    return site.build({"gateway": {"name": "g"}, "line": [line]}, "test", Path())


def test_what_a_protocol_has_not_got_is_said() -> None:
    """ASCII has no block, so provisioning has no effect; binary has it, and the gateway may set it."""
    said = text(toshiba("toshiba-ascii", provision=True))
    assert "toshiba-ascii has no block: single reads instead; with a block: modbus-rtu or toshiba-binary" in said
    assert "provision = true has no effect" in said
    said = text(toshiba("toshiba-binary", provision=True))
    assert "has no block" not in said
    assert "set once by the gateway (EEPROM), then reset the drive: F875=1" in said


def test_the_frames_that_reach_a_group_are_said() -> None:
    """A digit in ASCII, which drives hear that are read in binary."""
    for protocol in ("toshiba-ascii", "toshiba-binary"):
        said = text(toshiba(protocol))
        assert "group fans: written by 1 frame\n    1* (toshiba-ascii): d11, d12; nobody answers" in said
