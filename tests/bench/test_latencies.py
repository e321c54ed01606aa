"""The benchmarks of commands, stops and values work: each in small, against the whole gateway."""

from __future__ import annotations

import pytest

from bench import command_latency, mqtt_latency, stop_latency
from bench.controllers import CONTROLLERS
from bench.line_journal import Exchange

POLLED = bytes.fromhex("02 03 18 75 00 05 00 00")


def answer(hundredths: int) -> bytes:
    """Make the answer of a drive to its block read."""
    return bytes.fromhex("02 03 0A 24 00") + hundredths.to_bytes(2, "big") + bytes(8)


def test_a_reading_is_known_by_its_frequency() -> None:
    """What was read twice is nobody's, a standing motor's no news, and other requests are not polls."""
    exchanges = [
        Exchange(0.0, 0.1, POLLED, answer(0)),
        Exchange(0.2, 0.3, POLLED, answer(1000)),
        Exchange(0.4, 0.5, POLLED, answer(1010)),
        Exchange(0.6, 0.7, POLLED, answer(1010)),
        Exchange(0.8, 0.9, bytes.fromhex("02 03 FD 00 00 01"), bytes.fromhex("02 03 02 04 1A")),
        Exchange(1.0, 1.1, POLLED, b""),
    ]
    assert mqtt_latency.readings(exchanges) == {(2, 1000): 0.3}
    assert mqtt_latency.delays({(2, 1000): 0.3, (2, 1100): 0.4}, {(2, 1000): 0.301}) == [pytest.approx(0.001)]


@pytest.mark.e2e
def test_commands_are_found_on_the_line_by_every_way() -> None:
    """Each is done, and on the line before its result."""
    cells = list(command_latency.measured((38400,), (1,), count=3))
    assert [cell.way for cell in cells] == list(CONTROLLERS)
    for cell in cells:
        assert (len(cell.waits), cell.failed) == (3, 0)
        for wait, round_trip in zip(cell.waits, cell.round_trips, strict=True):
            assert 0 < wait.whole < round_trip
            assert -0.001 < wait.beyond <= wait.whole
        assert cell.polls
        assert cell.way in command_latency.row(cell)
    assert "of 3 rows" in command_latency.verdict(cells)


@pytest.mark.e2e
def test_stops_are_found_on_a_line_with_a_dead_drive() -> None:
    """The longest exchange is the time-out of a dead drive: far longer than any that is answered."""
    rows = list(stop_latency.measured((1,), drives=2, count=2))
    assert [row.way for row in rows] == list(CONTROLLERS)
    for row in rows:
        assert (len(row.waits), row.failed) == (2, 0)
        assert row.longest > 0.05
        assert all(wait.whole < round_trip for wait, round_trip in zip(row.waits, row.round_trips, strict=True))
        assert row.way in stop_latency.row(row)
    assert "of the longest exchange" in stop_latency.verdict(rows)


@pytest.mark.e2e
def test_values_are_followed_from_the_line_to_a_subscriber() -> None:
    """None comes before it was read, and the state behind the value."""
    (row,) = mqtt_latency.measured((38400,), (1,), seconds=0.5)
    assert len(row.values) > 5
    assert row.missed <= 2
    assert all(delay > -0.001 for delay in [*row.values, *row.states])
    assert sum(row.states) >= sum(row.values)
    assert "38400" in mqtt_latency.row(row)
