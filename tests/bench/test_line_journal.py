"""What a simulated line says of its exchanges, and what a command waited for."""

from __future__ import annotations

import os
import time

import pytest

from bench import line_journal
from bench.line_journal import Exchange, Wait
from bench.whole_gateway import simulated
from gateway.protocol.checksum import crc16
from gateway.sim.process import SimulatedLine
from tests.processes import until

GAP = 0.002
POLL, COMMAND = bytes.fromhex("01 03 18 75"), bytes.fromhex("01 06 FA 01 0B B8")


def poll(begin: float, end: float) -> Exchange:
    """Make an exchange that was answered."""
    return Exchange(begin, end, POLL, b"\x01\x03")


def test_an_answer_belongs_to_the_request_before_it() -> None:
    """Entries come as they ended; events and what drives said before any fault are left out."""
    entries = [
        {"way": "request", "begin": 0.0, "end": 0.25, "data": "01 03"},
        {"way": "answer", "begin": 0.5, "end": 1.5, "data": "01 03 02", "drive": 1},
        {"way": "heard", "begin": 0.5, "end": 1.5, "data": "01 03 02", "drive": 1},
        {"way": "event", "begin": 1.0, "end": 1.0, "note": "force"},
        {"way": "request", "begin": 1.75, "end": 2.0, "data": "02 03"},
    ]
    assert line_journal.exchanges(entries, opened=100.0) == [
        Exchange(100.0, 101.5, b"\x01\x03", b"\x01\x03\x02"),
        Exchange(101.75, 102.0, b"\x02\x03"),
    ]


def test_a_command_is_not_blamed_for_the_exchange_in_flight() -> None:
    """Sent at 10 ms; the line is free at 22 ms; its frame begins at 22.5 ms."""
    found = [poll(0.0, 0.020), Exchange(0.0225, 0.030, COMMAND)]
    wait = line_journal.wait(0.010, 0.010, COMMAND, found, GAP)
    assert wait is not None
    assert wait.whole == pytest.approx(0.0125)
    assert wait.beyond == pytest.approx(0.0005)
    assert wait.slipped_in == ()


def test_on_a_quiet_line_all_of_the_wait_counts() -> None:
    """The last exchange is long over."""
    found = [poll(0.0, 0.020), Exchange(0.503, 0.510, COMMAND)]
    wait = line_journal.wait(0.5, 0.5, COMMAND, found, GAP)
    assert wait is not None
    assert wait.beyond == pytest.approx(0.003)


def test_a_poll_that_begins_after_a_command_is_excused_only_at_once() -> None:
    """A third of a millisecond later nobody could know of it; after one and a half all of the poll counts."""
    excused, blamed = (waited_behind_a_poll(after) for after in (0.0003, 0.0015))
    slow_broker = waited_behind_a_poll(0.0015, told=0.0012)
    assert slow_broker.beyond == pytest.approx(0.0005)
    assert excused.slipped_in == pytest.approx((0.0003,))
    assert excused.beyond == pytest.approx(0.0005)
    assert blamed.slipped_in == pytest.approx((0.0015,))
    assert blamed.beyond == blamed.whole == pytest.approx(0.0015 + 0.020 + GAP + 0.0005)


def waited_behind_a_poll(after: float, told: float = 0.0) -> Wait:
    """Send a command when the line is free; a poll begins so long after it, and the command's frame behind that.

    The broker tells the command after `told` seconds.
    """
    sent = 1.0
    second = poll(sent + after, sent + after + 0.020)
    frame = Exchange(second.end + GAP + 0.0005, second.end + 0.01, COMMAND)
    wait = line_journal.wait(sent, sent + told, COMMAND, [poll(0.9, 0.995), second, frame], GAP)
    assert wait is not None
    return wait


def test_an_earlier_frame_of_the_same_form_is_not_the_commands() -> None:
    """A stop's frame looks the same each time; a command that never came has no wait."""
    found = [Exchange(0.0, 0.01, COMMAND), poll(0.012, 0.03)]
    assert line_journal.wait(0.005, 0.005, COMMAND, found, GAP) is None


def test_how_late_the_master_was_is_told_for_requests_behind_answers() -> None:
    """What follows silence is a time-out's affair."""
    found = [poll(0.0, 0.020), Exchange(0.0225, 0.026, POLL), poll(0.1, 0.12)]
    ((late, request),) = line_journal.late(found, GAP)
    assert late == pytest.approx(0.0005)
    assert request == POLL
    assert line_journal.longest(found) == pytest.approx(0.0775)


@pytest.mark.e2e
def test_the_times_are_those_of_this_machine() -> None:
    """A frame that is written between two looks at the clock began between them."""
    request = bytes.fromhex("01 03 FD 00 00 01")
    with SimulatedLine(simulated(38400, 1)) as line:
        port = os.open(line.port, os.O_RDWR | os.O_NOCTTY)
        try:
            before = time.monotonic()
            os.write(port, request + crc16(request))
            until(lambda: line.stats()["answers"] == 1, "the answer")
            after = time.monotonic()
        finally:
            os.close(port)
        (exchange,) = line_journal.read(line)
    assert before - 0.001 <= exchange.begin < exchange.end <= after + 0.001
    assert exchange.request.startswith(request)
    assert exchange.answer.startswith(b"\x01\x03\x02")
