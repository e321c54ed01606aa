"""Unit 255: the compact map and the counters."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import MapSection
from gateway.image import Image, LinkState, Missing, Quality
from gateway.metrics import LineStats, MqttStats, Stats
from gateway.modbus_tcp.gateway_unit import COUNTERS, COUNTERS_AT, VALUES, GatewayUnit, version_number
from gateway.modbus_tcp.server import IDENTITY
from gateway.modbus_tcp.user_map import UserMap
from tests.modbus_tcp.rig import ALL, NOW, answer, drive

NONE = 0x8000


def unit(image: Image, stats: Stats | None = None) -> GatewayUnit:
    """Make unit 255 over an image."""
    return GatewayUnit(image, stats or Stats(0.0), IDENTITY, NOW)


def words(served: GatewayUnit, start: int, count: int, now: float = NOW) -> tuple[int, ...]:
    """Read some registers; AssertionError when they are not given."""
    told = served.read(start, count, now)
    assert isinstance(told, bytes)
    return struct.unpack(f">{count}H", told)


def online(*units: int) -> Image:
    """Return an image of drives that have just told all that is polled."""
    image = Image([drive(f"pump-{number}", number) for number in units])
    for each in image.drives:
        each.set_link(LinkState.ONLINE)
        answer(each, **ALL)
    return image


def test_a_drive_has_sixteen_registers() -> None:
    """Link, quality, age, the values at fixed places, and which of them are there; 8000H where none is read."""
    values = [3, 6000, 0x1234, NONE, NONE, 1, 5000, NONE, 0xFFFF, NONE, NONE, NONE]
    present = 0b0000_1011_0011_1000
    assert words(unit(online(1)), 0, 16, NOW + 0.25) == (0, 0, 250, *values, present)


def test_a_bit_says_which_registers_hold_a_value() -> None:
    """8000H may be a true alarm word (bit 15 alone); the last register tells it from a missing one."""
    served = unit(online(1))
    told = words(served, 0, 16)
    for offset, name in enumerate(VALUES, 3):
        assert bool(told[15] >> offset & 1) is (name in ALL)


@pytest.mark.hazard("H19")
def test_a_stale_value_is_8000h_and_the_others_stay() -> None:
    """Quality 1 says that some value is old."""
    image = Image([drive(max_ages={"trip_code": 10.0})])
    served = unit(image)
    image.drives[0].set_link(LinkState.ONLINE)
    answer(image.drives[0], **ALL)
    told = words(served, 0, 16, NOW + 2.0)
    assert told[:3] == (LinkState.ONLINE, Quality.STALE, 2000)
    assert told[4] == NONE
    assert told[8] == 1
    assert told[15] == 1 << 8


@pytest.mark.hazard("H19")
def test_a_lost_drive_has_no_values_and_its_state_can_always_be_read() -> None:
    """Also when it comes back, until it is read again."""
    image = online(1)
    served = unit(image)
    assert words(served, 4, 1) == (6000,)
    image.drives[0].set_link(LinkState.OFFLINE, "no answer")
    told = words(served, 0, 16, NOW + 0.5)
    assert told == (LinkState.OFFLINE, Quality.OFFLINE, 500, *[NONE] * 12, 0)
    image.drives[0].set_link(LinkState.ONLINE)
    assert words(served, 0, 16, NOW + 0.5) == (0, Quality.STALE, 500, *[NONE] * 12, 0)
    answer(image.drives[0], NOW + 0.5, output_frequency=1)
    assert words(served, 4, 1, NOW + 0.5) == (1,)


def test_a_drive_that_was_never_heard_is_65535_ms_old() -> None:
    """And one that was heard long ago."""
    served = unit(Image([drive()]))
    assert words(served, 0, 3) == (LinkState.STARTING, Quality.NEVER_READ, 0xFFFF)
    served = unit(online(1))
    assert words(served, 2, 1, NOW + 65.534) in ((65533,), (65534,))
    assert words(served, 2, 1, NOW + 65.535) == (0xFFFF,)
    assert words(served, 2, 1, NOW + 1e9) == (0xFFFF,)


def test_one_request_reads_seven_drives() -> None:
    """112 registers, in the order of the file whatever the unit ids."""
    image = online(9, 3, 7, 1, 2, 8, 5, 4)
    for place, each in enumerate(image.drives):
        answer(each, output_frequency=place)
    told = words(unit(image), 0, 112)
    assert [told[16 * place + 4] for place in range(7)] == list(range(7))


@given(st.integers(0, 130), st.integers(1, 125))
def test_any_window_of_the_map_is_cut_from_the_whole(start: int, count: int) -> None:
    """Beyond the last drive nothing is mapped."""
    served = unit(online(1, 2, 3, 4, 5))
    told = served.read(start, count, NOW)
    if start + count <= 80:
        assert told == struct.pack(">80H", *words(served, 0, 80))[2 * start : 2 * (start + count)]
    else:
        assert told is Missing.UNMAPPED


def test_counters() -> None:
    """Each at its address, 32 bits with the high word first, and readable one by one."""
    stats = Stats(0.0, {"a": LineStats(is_up=True, exchanges=0x12345), "b": LineStats(exchanges=1)})
    stats.lines["a"].errors.update(no_reply=70_000, bad_reply=1)
    stats.brokers = {"a": MqttStats(is_connected=True, published=2, dropped=4), "b": MqttStats(published=1)}
    stats.brokers["b"].is_connected = True
    stats.tcp.connections, stats.tcp.turned_away = 2, 5
    stats.tcp.requests.update({3: 65_536})
    stats.tcp.exceptions.update({2: 6})
    image = online(1, 2)
    image.drives[1].set_link(LinkState.OFFLINE)
    told = words(unit(image, stats), 0xF000, 24, NOW + 65_537.9)
    version = version_number(IDENTITY["version"])
    expected = (2, version, 1, 1, 2, 1, 2, 1, 1, 0x2346, 1, 4465, 1, 2, 1, 0, 0, 6, 0, 5, 0, 3, 0, 4)
    assert told == expected
    assert words(unit(image, stats), 0xF008, 2) == (1, 0x2346)


def test_long_counters_stand_at_even_addresses() -> None:
    """Some masters read 32 bits at even addresses only."""
    address = COUNTERS_AT
    for counter in COUNTERS:
        assert not (counter.is_long and address % 2)
        address += 2 if counter.is_long else 1


def test_counters_run_over_and_saturate() -> None:
    """32 bits run over; 16 bits stay at the top."""
    stats = Stats(0.0, {"a": LineStats(exchanges=2**32 + 7)})
    stats.tcp.connections = 70_000
    told = words(unit(online(1), stats), 0xF000, 24)
    assert told[8:10] == (0, 7)
    assert told[13] == 0xFFFF


@pytest.mark.parametrize(
    ("text", "number"), [("1.2.3", 10203), ("0.1.0", 100), ("2.0", 20000), ("1.4.2.dev1", 10402), ("", 0)]
)
def test_versions(text: str, number: int) -> None:
    """Two digits a part."""
    assert version_number(text) == number


@pytest.mark.unmeasured
@pytest.mark.hazard("H19")
@given(st.data())
def test_the_block_kept_is_the_block_built_anew(data: st.DataObject) -> None:
    """Whatever answers, silences and times come: a unit that was read all along says the same as a new one."""
    image = Image([drive(max_ages={"trip_code": 3.0, "status": 0.5})])
    each, served, now = image.drives[0], unit(image), NOW
    again = served.reading(0, 16)
    for _ in range(data.draw(st.integers(1, 12))):
        now += data.draw(st.sampled_from([0.0, 0.0001, 0.0009, 0.1, 0.5, 0.6, 1.0, 2.5]))
        if data.draw(st.booleans()):
            names = data.draw(st.sets(st.sampled_from(sorted(ALL))))
            answer(each, now, **dict.fromkeys(names, data.draw(st.integers(0, 0xFFFF))))
        else:
            each.set_link(data.draw(st.sampled_from(LinkState)))
        assert words(served, 0, 16, now) == words(unit(image), 0, 16, now)
        assert again(now) == served.read(0, 16, now)


def test_what_is_read_again_is_built_anew_with_each_millisecond_and_each_change() -> None:
    """Of the drives that are read, and not for each request; long silent ones have no age that goes on."""
    image = online(1, 2)
    served = unit(image)
    again = served.reading(0, 32)
    first = again(NOW + 0.0101)
    assert again(NOW + 0.0109) is first
    assert struct.unpack_from(">3H", cut(again(NOW + 0.0111))) == (0, 0, 11)
    answer(image.drives[1], NOW + 0.0112, status=4)
    assert struct.unpack_from(">4H", cut(again(NOW + 0.0112)), 32) == (0, 0, 0, 4)
    image.drives[0].set_link(LinkState.OFFLINE)
    assert struct.unpack_from(">2H", cut(again(NOW + 0.0112))) == (2, 2)
    silent = again(NOW + 100.0)
    assert again(NOW + 200.0) is silent


def cut(told: bytes | Missing) -> bytes:
    """Return what was read; AssertionError where it is not given."""
    assert isinstance(told, bytes)
    return told


@pytest.mark.parametrize("before", [0.0004, 70.0])
def test_what_is_read_again_knows_of_an_answer_that_brought_no_value(before: float) -> None:
    """The gateway looks after an armed drive so: nobody is told, and its age begins anew, saturated or not."""
    image = online(1, 2)
    served = unit(image)
    again = served.reading(0, 32)
    later = NOW + 60.0 + before
    assert again(later) == served.read(0, 32, later)
    image.drives[1].apply([(0x0001, 0)], later, later)
    assert again(later) == served.read(0, 32, later)
    assert words(served, 18, 1, later) == (0,)


def test_a_user_map_beside_the_compact_one_is_read_again_by_its_own_way() -> None:
    """Counters and holes are read each time."""
    image = online(1)
    maps = UserMap([MapSection(point="pump-1.status", address=0x6000, type="word")], image, IDENTITY)
    served = GatewayUnit(image, Stats(0.0), IDENTITY, NOW, maps)
    for start, count in ((0x6000, 1), (0x6001, 1), (COUNTERS_AT, 2), (15, 2)):
        assert served.reading(start, count)(NOW) == served.read(start, count, NOW)
    assert unit(image).reading(0x6000, 1)(NOW) is Missing.UNMAPPED
