"""Messages of QoS 1: their packet identifiers, how many are under way, and what is known of them."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.mqtt.in_flight import FIRST_ID, IDS, IN_FLIGHT, LAST_ID, InFlight


def add(flight: InFlight, count: int) -> None:
    """Hand over messages whose packets are b"<" and b">" round the identifier."""
    for _ in range(count):
        flight.add(b"<", b">")


def released(flight: InFlight) -> list[int]:
    """Return the identifiers of what may be sent now."""
    pieces = flight.release()
    assert pieces[0::3] == [b"<"] * (len(pieces) // 3)
    assert pieces[2::3] == [b">"] * (len(pieces) // 3)
    return [int.from_bytes(written, "big") for written in pieces[1::3]]


def test_no_more_are_under_way_than_the_broker_takes() -> None:
    """The others wait in order, one for each that is acknowledged."""
    flight = InFlight()
    add(flight, IN_FLIGHT + 2)
    assert released(flight) == list(range(FIRST_ID, FIRST_ID + IN_FLIGHT))
    assert released(flight) == []
    assert (flight.open, flight.queued) == (IN_FLIGHT + 2, 2)
    assert flight.acknowledge(FIRST_ID)
    assert released(flight) == [FIRST_ID + IN_FLIGHT]
    assert (flight.open, flight.queued, flight.there) == (IN_FLIGHT + 1, 1, 1)


@pytest.mark.parametrize(("receive_maximum", "most"), [(1, 1), (3, 3), (65_535, IN_FLIGHT)])
def test_the_receive_maximum_counts_where_it_is_less(receive_maximum: int, most: int) -> None:
    """MQTT 5 3.2.2.3.3; without one it is 65,535."""
    flight = InFlight()
    flight.limit(receive_maximum)
    add(flight, 2 * IN_FLIGHT)
    assert len(released(flight)) == most


def test_a_message_is_there_when_all_before_it_are() -> None:
    """A broker that acknowledges in another order proves nothing too much."""
    flight = InFlight()
    add(flight, 1)
    first = flight.receipt()
    add(flight, 2)
    last = flight.receipt()
    released(flight)
    assert flight.acknowledge(FIRST_ID + 2)
    assert (flight.there, first(), last()) == (0, False, False)
    assert flight.acknowledge(FIRST_ID)
    assert (flight.there, first(), last()) == (1, True, False)
    assert flight.acknowledge(FIRST_ID + 1)
    assert (flight.there, first(), last()) == (3, True, True)


@pytest.mark.parametrize("packet_id", [0, 1, FIRST_ID - 1, FIRST_ID + 1, FIRST_ID + 2, LAST_ID])
def test_what_is_not_under_way_is_not_acknowledged(packet_id: int) -> None:
    """Of two messages one waits, so that only one identifier is known; and that only once."""
    flight = InFlight()
    flight.limit(1)
    add(flight, 2)
    released(flight)
    assert not flight.acknowledge(packet_id)
    assert flight.there == 0
    assert flight.acknowledge(FIRST_ID)
    assert not flight.acknowledge(FIRST_ID)
    assert flight.there == 1


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, IN_FLIGHT - 1), st.booleans()), max_size=200))
def test_no_identifier_is_given_twice_while_it_is_under_way(steps: list[tuple[int, int, bool]]) -> None:
    """However many are handed over, and in whatever order they are acknowledged."""
    flight, under_way, sent, acknowledged = InFlight(), deque[int](), 0, set[int]()
    numbers: dict[int, int] = {}
    for count, place, is_twice in steps:
        add(flight, count)
        for packet_id in released(flight):
            assert FIRST_ID <= packet_id <= LAST_ID
            assert packet_id == FIRST_ID + sent % IDS
            assert packet_id not in under_way
            numbers[packet_id] = sent
            under_way.append(packet_id)
            sent += 1
        if under_way:
            packet_id = under_way[min(place, len(under_way) - 1)]
            assert flight.acknowledge(packet_id)
            acknowledged.add(numbers[packet_id])
            under_way.remove(packet_id)
            assert not is_twice or flight.acknowledge(packet_id) is (numbers[packet_id] > flight.there)
        first_missing = next(number for number in range(sent + 1) if number not in acknowledged)
        assert flight.there == first_missing
        assert len(under_way) <= IN_FLIGHT


def test_identifiers_come_again_when_all_have_been_given() -> None:
    """In turn, for as long as a connection lasts; the oldest may still be under way."""
    flight = InFlight()
    add(flight, 3 * IDS)
    given_out = released(flight)
    for number in range(3 * IDS):
        if number % 2:
            assert flight.acknowledge(FIRST_ID + number % IDS)
            assert flight.acknowledge(FIRST_ID + (number - 1) % IDS)
            given_out += released(flight)
    assert given_out == [FIRST_ID + number % IDS for number in range(3 * IDS)]
    assert flight.there == 3 * IDS - 1, "one has no other behind it"
