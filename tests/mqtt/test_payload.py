"""How values, qualities and times are spelt."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.drives.register import Kind, Register
from gateway.image import DriveImage, LinkState, Quality
from gateway.mqtt import payload
from gateway.site import Point
from tests.mqtt import drives

EVERY = dict.fromkeys(drives.MODEL.registers, 0)


def pump() -> DriveImage:
    """Return a drive that is online and was never read."""
    return drives.image().drives[0]


def spelling(name: str) -> payload.Spelling:
    """Return how a value of a drive is spelt."""
    return payload.Spelling(pump(), name)


def state(image: DriveImage, now: float) -> dict[str, Any]:
    """Parse a state as strictly as can be, numbers exactly."""
    read: dict[str, Any] = json.loads(payload.StateWriter(image).write(now), parse_float=Decimal, parse_int=Decimal)
    return read


def test_a_value_has_the_decimals_of_its_scale() -> None:
    """6000 at 0.01 is "60.00", and a sign is kept."""
    assert spelling("output_frequency").value(6000, Quality.GOOD) == "60.00"
    assert spelling("torque").value(0xFFFB, Quality.GOOD) == "-0.05"


@pytest.mark.hazard("H19")
@pytest.mark.parametrize("quality", [Quality.STALE, Quality.OFFLINE, Quality.NEVER_READ])
def test_what_is_not_good_has_no_number_and_no_words(quality: Quality) -> None:
    """An empty payload makes the broker forget the number that it retains."""
    assert spelling("output_frequency").value(1, quality) == ""
    assert spelling("status").text(1, quality) == ""


def test_bits_and_codes_are_said_in_words() -> None:
    """No set bit is a word too: an empty payload means that nothing is known."""
    assert spelling("status").text(0b101, Quality.GOOD) == "running, tripped"
    assert spelling("status").text(0, Quality.GOOD) == "none"
    assert spelling("trip_code").text(1, Quality.GOOD) == "OC1: overcurrent during acceleration"


def test_times_are_utc_with_milliseconds() -> None:
    """ISO 8601, never rounded into the future."""
    assert payload.timestamp(drives.WALL) == "2026-03-01T12:00:00.250Z"
    assert payload.timestamp(1_772_366_400.0) == "2026-03-01T12:00:00.000Z"
    assert payload.timestamp(1_772_366_399.9996) == "2026-03-01T11:59:59.999Z"


@given(wall=st.floats(-4e9, 4e9) | st.integers(0, 4 * 10**12).map(lambda ms: ms / 1000))
def test_a_time_of_a_second_that_is_known_is_the_time_made_anew(wall: float) -> None:
    """To the millisecond, as the library has it."""
    exact = datetime.fromtimestamp(wall, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    assert payload.timestamp(wall) == exact


def test_the_state_is_flat_json_of_numbers_and_words() -> None:
    """Every value, its time, its quality; a derived value by its base."""
    image = pump()
    drives.read(image, 0.0, **EVERY | {"output_frequency": 6000, "output_current_rate": 5000, "status": 1})
    assert state(image, 0.0) == {
        "time": "2026-03-01T12:00:00.250Z",
        "quality": "good",
        "tripped": None,
        "reset_needed": False,
        "output_frequency": Decimal("60.00"),
        "torque": Decimal("0.00"),
        "status": 1,
        "status_text": "running",
        "trip_code": 0,
        "trip_code_text": "no trip",
        "command": 0,
        "output_current_rate": Decimal("50.00"),
        "output_current": Decimal("6.25"),
    }


def test_the_state_writes_numbers_with_their_decimals() -> None:
    """60.00 and not 60.0: the text of the number tells the resolution."""
    image = pump()
    drives.read(image, 0.0, output_frequency=6000)
    assert '"output_frequency":60.00,' in payload.StateWriter(image).write(0.0)


@pytest.mark.hazard("H19")
def test_a_stale_value_is_null_in_the_state_and_the_quality_is_the_worst() -> None:
    """Its words are null too; the time is still that of the newest reading."""
    image = pump()
    drives.read(image, 0.0, **EVERY)
    drives.read(image, 1.5, output_frequency=6000)
    later = state(image, 1.6)
    assert later["output_frequency"] == 60
    assert later["status"] is None
    assert later["status_text"] is None
    assert later["quality"] == "stale"
    assert later["time"] == "2026-03-01T12:00:01.750Z"


@pytest.mark.hazard("H19")
def test_a_lost_drive_has_no_value_in_the_state() -> None:
    """Offline, at once."""
    image = pump()
    drives.read(image, 0.0, **EVERY)
    image.set_link(LinkState.OFFLINE)
    lost = state(image, 0.0)
    assert lost["quality"] == "offline"
    assert {lost[name] for name in image.names} == {None}


def test_before_the_first_reading_there_is_neither_time_nor_value() -> None:
    """Never read."""
    fresh = state(pump(), 0.0)
    assert fresh["time"] is None
    assert fresh["quality"] == "never_read"


@pytest.mark.hazard("H19")
def test_a_gateway_that_leaves_takes_its_numbers_back() -> None:
    """What was read is offline to those who stay."""
    image = pump()
    drives.read(image, 0.0, **EVERY)
    left = json.loads(payload.StateWriter(image).write(0.0, is_leaving=True))
    assert left["quality"] == "offline"
    assert left["output_frequency"] is None
    assert payload.left_behind(Quality.NEVER_READ) is Quality.NEVER_READ


def test_a_value_called_like_a_key_of_the_state_keeps_out_of_its_way() -> None:
    """`time` and `quality` mean what they mean."""
    register = Register("time", 0xFE20, Kind.MONITOR, "7.2")
    named = DriveImage(replace(drives.drive(), points={"time": Point(register, 1.0)}, derived=()))
    named.set_link(LinkState.ONLINE)
    named.apply([(0xFE20, 7)], 0.0, drives.WALL)
    written = state(named, 0.0)
    assert (written["time"], written["time_value"]) == ("2026-03-01T12:00:00.250Z", 7)


@given(words=st.lists(st.fixed_dictionaries({name: st.integers(0, 0xFFFF) for name in EVERY}), max_size=4))
def test_a_state_made_of_known_parts_is_the_state_made_anew(words: list[dict[str, int]]) -> None:
    """The writer remembers parts; nobody can tell."""
    image = pump()
    writer = payload.StateWriter(image)
    for now, answer in enumerate(words):
        drives.read(image, float(now), **answer)
        assert writer.write(float(now)) == payload.StateWriter(image).write(float(now))
        for name in image.points:
            sample = image.sample(name, float(now))
            assert state(image, float(now))[name] == image.number(name, sample.word)


def test_a_new_base_makes_a_derived_value_anew() -> None:
    """Another drive under the number may be of another size."""
    image = pump()
    writer = payload.StateWriter(image)
    drives.read(image, 0.0, output_current_rate=5000)
    assert '"output_current":6.25' in writer.write(0.0)
    image.bases["rated_current"] = Decimal("25")
    assert '"output_current":12.50' in writer.write(0.0)
