"""Which frames reach exactly the drives of a group."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import site
from gateway.bus.groups import family, reach
from gateway.protocol.pdu import EVERY_DRIVE, Group, WriteRam
from gateway.protocol.registry import PROTOCOLS
from gateway.site import Drive

ASCII, BINARY, MODBUS = "toshiba-ascii", "toshiba-binary", "modbus-rtu"


@cache
def drive(number: int, protocol: str) -> Drive:
    """Return a configured drive; its name has its number."""
    name = f"{protocol[:9]}-{number}"
    table = {"name": name, "number": number, "model": "vf-nc3", "protocol": protocol, "unit": 1}
    line = {"name": "a", "port": "/dev/null", "drive": [table]}
    return site.build({"gateway": {"name": "t"}, "line": [line]}, "test", Path()).drives[0]


def drives(protocol: str, *numbers: int) -> list[Drive]:
    """Return several."""
    return [drive(number, protocol) for number in numbers]


def targets(members: list[Drive], on_line: list[Drive]) -> list[int | Group]:
    """Return whom the frames are addressed to."""
    return [frame.target for frame in reach(members, on_line)]


def test_ascii_reaches_all_a_tens_digit_or_a_ones_digit() -> None:
    """Whatever fits exactly; the narrow one where several do."""
    line = drives(ASCII, 0, 2, 10, 12, 22)
    assert targets(line, line) == [EVERY_DRIVE]
    assert targets(drives(ASCII, 10, 12), line) == [Group(tens=1)]
    assert targets(drives(ASCII, 2, 12, 22), line) == [Group(ones=2)]
    assert targets(drives(ASCII, 10, 12), drives(ASCII, 10, 12)) == [Group(tens=1)]


def test_one_by_one_where_no_frame_reaches_exactly_the_group() -> None:
    """In the order of the group."""
    line = drives(ASCII, 1, 2, 3)
    assert targets(drives(ASCII, 3, 1), line) == [3, 1]
    assert targets(drives(BINARY, 10, 21), drives(BINARY, 10, 20, 21)) == [10, 21]
    assert targets(drives(MODBUS, 1, 2), drives(MODBUS, 1, 2, 3)) == [1, 2]


def test_binary_and_modbus_know_all_drives_only() -> None:
    """FFH and 0."""
    for protocol in (BINARY, MODBUS):
        line = drives(protocol, 11, 12)
        assert targets(line, line) == [EVERY_DRIVE]


def test_drives_that_are_read_in_binary_are_reached_by_a_digit_in_ascii() -> None:
    """TOSHIBA drives hear both; not where binary was asked for."""
    line = drives(BINARY, 10, 12, 20)
    (frame,) = reach(drives(BINARY, 10, 12), line)
    assert (frame.protocol, frame.target, frame.representative) == (ASCII, Group(tens=1), drive(10, BINARY))
    assert [frame.target for frame in reach(drives(BINARY, 10, 12), line, BINARY)] == [10, 12]


def test_one_drive_is_addressed_by_its_number() -> None:
    """Even if it is alone on the line: it answers, and no stranger hears it."""
    line = drives(ASCII, 7)
    assert targets(line, line) == [7]


def test_the_representative_is_named_where_it_is_on_the_line() -> None:
    """The drive with 0 in the place of *; in MODBUS-RTU nobody."""
    (frame,) = reach(drives(ASCII, 10, 12), drives(ASCII, 10, 12, 20))
    assert frame.representative is drive(10, ASCII)
    assert str(frame) == "1* (toshiba-ascii): toshiba-a-10, toshiba-a-12; toshiba-a-10 answers"
    (frame,) = reach(drives(ASCII, 2, 12), drives(ASCII, 2, 12, 20))
    assert (str(frame.target), frame.representative) == ("*2", drive(2, ASCII))
    (frame,) = reach(drives(BINARY, 1, 2), drives(BINARY, 1, 2))
    assert frame.representative is None
    assert str(frame) == "FFH (toshiba-binary): toshiba-b-1, toshiba-b-2; nobody answers"
    (frame,) = reach(drives(MODBUS, 1, 2), drives(MODBUS, 1, 2))
    assert str(frame) == "0 (modbus-rtu): modbus-rt-1, modbus-rt-2; nobody answers"


def test_a_group_of_two_protocols_has_a_frame_for_each() -> None:
    """TOSHIBA and MODBUS-RTU drives do not hear each other's frames."""
    line = drives(ASCII, 1, 2) + drives(MODBUS, 3, 4)
    assert [(frame.protocol, frame.target) for frame in reach(line, line)] == [
        (ASCII, Group(tens=0)),
        (MODBUS, EVERY_DRIVE),
    ]


def test_toshiba_drives_hear_both_modes() -> None:
    """One frame reaches drives configured for either, and ** would reach one that is not a member."""
    mixed = [drive(10, ASCII), drive(11, BINARY)]
    (frame,) = reach(mixed, mixed)
    assert (frame.protocol, frame.target) == (ASCII, Group(tens=1))
    assert targets(drives(ASCII, 5, 16), [*drives(ASCII, 5, 16), drive(27, BINARY)]) == [5, 16]
    assert targets(drives(BINARY, 5, 16), [*drives(BINARY, 5, 16), drive(70, ASCII)]) == [5, 16]


def test_a_protocol_can_be_asked_for() -> None:
    """The proportional command exists in binary mode only."""
    line = drives(BINARY, 10, 11)
    (frame,) = reach(line, line, BINARY)
    assert (frame.protocol, frame.target) == (BINARY, EVERY_DRIVE)
    assert [frame.protocol for frame in reach(line[:1], line, BINARY)] == [BINARY]


NUMBERED = st.dictionaries(
    st.tuples(st.sampled_from(["TOSHIBA", "MODBUS"]), st.integers(1, 63)), st.booleans(), min_size=1, max_size=12
)


@pytest.mark.unmeasured
@given(NUMBERED)
def test_every_member_is_reached_once_and_no_other_configured_drive(numbered: dict[tuple[str, int], bool]) -> None:
    """By frames that the codecs can make, and that drives outside the group do not obey."""
    on_line, members = [], []
    for (name, number), is_member in numbered.items():
        protocol = MODBUS if name == "MODBUS" else (ASCII if number % 3 else BINARY)
        on_line.append(drive(number, protocol))
        members += on_line[-1:] if is_member else []
    frames = reach(members, on_line)
    reached = [other.name for frame in frames for other in frame.drives]
    assert sorted(reached) == sorted(member.name for member in members)
    for frame in frames:
        assert PROTOCOLS[frame.protocol].encode(WriteRam(frame.target, 0xFA01, 0))
        target = frame.target
        obeys = [
            other.name
            for other in on_line
            if family(other.protocol) == family(frame.protocol)
            and (target.has(other.number) if isinstance(target, Group) else target == other.number)
        ]
        assert sorted(obeys) == sorted(member.name for member in frame.drives)


def test_the_family_says_who_hears_one_frame() -> None:
    """ASCII and binary are told apart by the start code, by every drive (E6581657 4)."""
    assert family(ASCII) == family(BINARY) != family(MODBUS)


@pytest.mark.parametrize("protocol", [ASCII, BINARY, MODBUS])
def test_nobody_is_reached_by_nothing(protocol: str) -> None:
    """An empty group has no frame."""
    assert reach([], drives(protocol, 1, 2)) == ()
