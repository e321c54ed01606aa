"""The process image: freshness, links, listeners, and that no answer is ever seen in halves."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.drives.model import Model
from gateway.drives.register import Derived, Kind, Register
from gateway.drives.scaling import Scaling
from gateway.image import NEVER, DriveImage, Image, LinkState, Missing, Quality
from gateway.site import Drive, Point

NOW, WALL = 100.0, 1_700_000_000.0
ADDRESSES = (0xFD00, 0xFD01, 0xFD02, 0xFD03, 0xFD05, 0xFFFF)
MAX_AGES = (1.0, 1.0, 3.0, 1.0, 0.5, 1.0)


def drive(unit: int = 1) -> Drive:
    """Make a drive with a run of four numbers and two single ones; FD01H has three defined bits."""
    registers = {
        f"v{address:04x}": Register(
            f"v{address:04x}",
            address,
            Kind.MONITOR,
            "test",
            unit="%",
            scaling=Scaling(Decimal("0.01")),
            mask=7 if address == 0xFD01 else 0xFFFF,
            bits={0: "a", 1: "b", 2: "c"} if address == 0xFD01 else {},
        )
        for address in ADDRESSES
    }
    base = Register("base", 0xFE70, Kind.MONITOR, "test", unit="A", scaling=Scaling(Decimal("0.1")))
    return Drive(
        name=f"pump-{unit}",
        line="a",
        number=unit,
        unit=unit,
        model=Model("test", "Test drive", "test", {**registers, "base": base}),
        protocol="modbus-rtu",
        wait_time=0.0,
        groups=(),
        points={name: Point(r, age) for (name, r), age in zip(registers.items(), MAX_AGES, strict=True)},
        derived=(Derived("amperes", "vfd03", "base", "A"),),
        deadband={},
    )


def online() -> DriveImage:
    """Return the image of a connected drive that has told every value: its own address."""
    image = DriveImage(drive())
    image.set_link(LinkState.ONLINE)
    image.apply([(address, address) for address in ADDRESSES], NOW, WALL)
    return image


@pytest.mark.hazard("H20")
def test_words_are_given_as_they_stand_on_the_wire() -> None:
    """Big-endian, undefined bits removed."""
    assert online().read(0xFD00, 4, NOW) == struct.pack(">4H", 0xFD00, 0x0001, 0xFD02, 0xFD03)
    assert online().read(0xFFFF, 1, NOW) == b"\xff\xff"


@pytest.mark.parametrize(
    ("start", "count"), [(0xFD00, 5), (0xFD03, 2), (0xFD04, 1), (0xFCFF, 2), (0, 1), (0xFFFF, 2)]
)
def test_a_hole_is_not_bridged(start: int, count: int) -> None:
    """What is not polled has no value, not even between two that are."""
    assert online().read(start, count, NOW) is Missing.UNMAPPED


@pytest.mark.hazard("H19")
def test_a_range_is_as_fresh_as_its_oldest_word() -> None:
    """FD02H may be older than its neighbours."""
    image = online()
    assert isinstance(image.read(0xFD00, 4, NOW + 1.0), bytes)
    assert image.read(0xFD00, 4, NOW + 1.01) is Missing.NOT_FRESH
    assert image.read(0xFD02, 2, NOW + 1.01) is Missing.NOT_FRESH
    assert isinstance(image.read(0xFD02, 1, NOW + 3.0), bytes)
    assert image.read(0xFD02, 1, NOW + 3.01) is Missing.NOT_FRESH


@pytest.mark.hazard("H19")
@pytest.mark.parametrize("link", [LinkState.OFFLINE, LinkState.STRANGER, LinkState.STARTING, LinkState.LINE_DOWN])
def test_a_lost_link_ends_freshness_for_good(link: LinkState) -> None:
    """The link alone brings no value back; an answer does."""
    image = online()
    image.set_link(link, "test")
    lost = Missing.LINE_DOWN if link is LinkState.LINE_DOWN else Missing.NOT_FRESH
    assert image.read(0xFD00, 1, NOW) is lost
    image.set_link(LinkState.ONLINE)
    assert image.read(0xFD00, 1, NOW) is Missing.NOT_FRESH
    image.apply([(0xFD00, 1)], NOW, WALL)
    assert image.read(0xFD00, 1, NOW) == b"\x00\x01"
    assert image.read(0xFD00, 2, NOW) is Missing.NOT_FRESH


@pytest.mark.hazard("H19")
def test_an_answer_of_a_lost_drive_is_forgotten_when_it_is_lost_again() -> None:
    """A single answer between two silences is no connection; nobody is told twice that it is lost."""
    image = online()
    image.set_link(LinkState.OFFLINE, "no answer")
    told: list[Sequence[str]] = []
    image.apply([(0xFD00, 1)], NOW, WALL)
    image.subscribe(lambda _, names: told.append(names))
    image.set_link(LinkState.OFFLINE, "no answer")
    assert told == []
    image.set_link(LinkState.ONLINE)
    assert image.read(0xFD00, 1, NOW) is Missing.NOT_FRESH


def test_a_suspect_drive_is_still_believed() -> None:
    """One lost frame makes nothing stale."""
    image = online()
    image.set_link(LinkState.SUSPECT)
    assert isinstance(image.read(0xFD00, 4, NOW), bytes)


@pytest.mark.hazard("H21")
def test_all_words_of_an_answer_appear_at_once() -> None:
    """A listener that reads while it is told sees every word of the answer, under one version."""
    image = online()
    seen: list[tuple[bytes | Missing, int]] = []

    def read_all(told: DriveImage, names: Sequence[str]) -> None:
        seen.append((told.read(0xFD00, 4, NOW), told.version))

    image.subscribe(read_all)
    image.apply([(0xFD00, 1), (0xFD01, 2), (0xFD02, 3), (0xFD03, 4)], NOW, WALL)
    assert seen == [(struct.pack(">4H", 1, 2, 3, 4), 2)]


@pytest.mark.hazard("H21")
def test_an_answer_that_breaks_off_changes_nothing() -> None:
    """Half an answer is none."""
    image = online()
    before = image.read(0xFD00, 4, NOW), image.sample("vfd00", NOW), image.version, image.revision

    def broken() -> Iterator[tuple[int, int]]:
        yield 0xFD00, 1
        raise ValueError("the rest is missing")

    with pytest.raises(ValueError, match="the rest"):
        image.apply(broken(), NOW, WALL)
    assert (image.read(0xFD00, 4, NOW), image.sample("vfd00", NOW), image.version, image.revision) == before


def test_numbers_that_are_no_points_are_passed_over() -> None:
    """Words between the wanted ones of a block."""
    image = online()
    image.apply([(0xFD04, 9), (0xFD05, 1)], NOW, WALL)
    assert image.read(0xFD04, 1, NOW) is Missing.UNMAPPED
    assert image.read(0xFD05, 1, NOW) == b"\x00\x01"


def test_versions_count_answers_and_revisions_changes() -> None:
    """A change of the link is no answer."""
    image = online()
    version, revision = image.version, image.revision
    image.set_link(LinkState.SUSPECT)
    assert (image.version, image.revision) == (version, revision + 1)
    image.set_link(LinkState.SUSPECT)
    assert image.revision == revision + 1
    image.apply([], NOW, WALL)
    assert (image.version, image.revision) == (version + 1, revision + 2)


@pytest.mark.hazard("H19")
def test_what_listeners_are_told_of_is_good_until_the_first_of_it_turns_stale() -> None:
    """Of an answer; nothing is known of it beforehand once the link is lost, or for what turned stale."""
    image = online()
    seen: list[tuple[Sequence[str], float]] = []
    image.subscribe(lambda told, names: seen.append((names, told.good_until)))
    image.apply([(0xFD00, 1), (0xFD02, 1)], NOW, WALL)
    image.apply([(0xFD02, 1)], NOW + 0.1, WALL)
    image.sweep(NOW + 0.6)
    image.set_link(LinkState.OFFLINE)
    image.apply([(0xFD00, 1)], NOW + 1.0, WALL)
    assert seen == [
        (["vfd00", "vfd02"], NOW + 1.0),
        (["vfd02"], NOW + 3.1),
        (["vfd05"], NEVER),
        ((), NEVER),
        (["vfd00"], NEVER),
    ]


@pytest.mark.hazard("H19")
def test_an_answer_of_a_lost_drive_is_swept_away_again() -> None:
    """Though nothing has turned stale since the last sweep."""
    image = online()
    image.sweep(NOW)
    image.set_link(LinkState.OFFLINE)
    image.sweep(NOW)
    told: list[Sequence[str]] = []
    image.subscribe(lambda _, names: told.append(names))
    image.apply([(0xFD00, 1)], NOW, WALL)
    image.sweep(NOW)
    assert told == [["vfd00"], ["vfd00"]]
    assert image.quality("vfd00", NOW) is Quality.OFFLINE


def test_a_sweep_tells_that_a_derived_value_has_lost_its_base_or_got_one() -> None:
    """Another drive may have been found there."""
    image = online()
    image.sweep(NOW)
    told: list[Sequence[str]] = []
    image.subscribe(lambda _, names: told.append(names))
    image.bases = {"base": Decimal("8.0")}
    image.sweep(NOW)
    image.bases = {}
    image.sweep(NOW)
    image.sweep(NOW)
    assert told == [["amperes"], ["amperes"]]


@pytest.mark.hazard("H19")
def test_the_newest_reading_has_a_time() -> None:
    """0 where there is none; an answer without any value of this drive is no reading."""
    image = DriveImage(drive())
    assert image.newest_wall == 0.0
    image.set_link(LinkState.ONLINE)
    image.apply([], NOW, WALL)
    assert image.newest_wall == 0.0
    image.apply([(0xFD00, 1)], NOW + 1.0, WALL + 1.0)
    image.apply([(0xFD04, 1)], NOW + 2.0, WALL + 2.0)
    assert image.newest_wall == WALL + 1.0


@pytest.mark.hazard("H19")
def test_a_sample_has_quality_age_and_source_time() -> None:
    """From never read to stale and offline; the source time stays that of the answer."""
    image = DriveImage(drive())
    assert image.sample("vfd00", NOW).quality is Quality.NEVER_READ
    image.set_link(LinkState.ONLINE)
    image.apply([(0xFD00, 6000)], NOW, WALL)
    good = image.sample("vfd00", NOW + 0.5)
    assert (good.word, good.quality, good.age, good.wall) == (6000, Quality.GOOD, 0.5, WALL)
    stale = image.sample("vfd00", NOW + 1.5)
    assert (stale.quality, stale.age, stale.wall) == (Quality.STALE, 1.5, WALL)
    image.set_link(LinkState.OFFLINE)
    assert image.sample("vfd00", NOW).quality is Quality.OFFLINE
    assert image.sample("vfd05", NOW).quality is Quality.NEVER_READ


def test_a_derived_value_waits_for_its_base() -> None:
    """10.00 % of 8.0 A."""
    image = online()
    assert image.sample("amperes", NOW).quality is Quality.NEVER_READ
    image.bases["base"] = Decimal("8.0")
    image.apply([(0xFD03, 1000)], NOW, WALL)
    assert image.sample("amperes", NOW).quality is Quality.GOOD
    assert image.show("amperes", 1000) == "0.80"
    assert image.unit("amperes") == "A"
    assert image.text("amperes", 1000) is None


def test_values_are_shown_with_their_decimals_and_bits_in_words() -> None:
    """6000 at 0.01 is 60.00."""
    image = online()
    assert (image.show("vfd00", 6000), image.unit("vfd00")) == ("60.00", "%")
    assert image.text("vfd01", 5) == "a, c"
    assert image.names[-1] == "amperes"


@pytest.mark.hazard("H19")
def test_the_sweep_tells_each_change_of_quality_once() -> None:
    """What turned stale, what went offline, and nothing twice."""
    image = Image([drive()])
    each = image.by_name["pump-1"]
    each.set_link(LinkState.ONLINE)
    each.apply([(address, 1) for address in ADDRESSES], NOW, WALL)
    told: list[Sequence[str]] = []
    image.subscribe(lambda _, names: told.append(names))
    image.sweep(NOW)
    image.sweep(NOW + 0.6)
    image.sweep(NOW + 0.6)
    assert told == [["vfd05"]]
    each.set_link(LinkState.OFFLINE)
    image.sweep(NOW + 0.7)
    assert told[1] == ()
    assert set(told[2]) == set(each.points)
    assert len(told) == 3


def test_the_worst_quality_of_a_drive() -> None:
    """A value that was never read is the worst; then a lost link; then age."""
    image = DriveImage(drive())
    assert image.worst_quality(NOW) is Quality.NEVER_READ
    image.set_link(LinkState.ONLINE)
    image.apply([(address, 1) for address in ADDRESSES[:-1]], NOW, WALL)
    assert image.worst_quality(NOW) is Quality.NEVER_READ
    image.apply([(ADDRESSES[-1], 1)], NOW, WALL)
    assert image.worst_quality(NOW) is Quality.GOOD
    assert image.worst_quality(NOW + 0.51) is Quality.STALE
    image.set_link(LinkState.OFFLINE)
    assert image.worst_quality(NOW) is Quality.OFFLINE


def test_the_next_expiry_is_that_of_the_first_value_to_turn_stale() -> None:
    """Infinity when all are."""
    image = online()
    assert image.next_expiry(NOW) == NOW + 0.5
    assert image.next_expiry(NOW + 0.6) == NOW + 1.0
    assert image.next_expiry(NOW + 1.1) == NOW + 3.0
    assert image.next_expiry(NOW + 3.1) == float("inf")


@pytest.mark.unmeasured
@pytest.mark.hazard("H19")
@given(st.data())
def test_reading_agrees_with_a_naive_image(data: st.DataObject) -> None:
    """The kept bound on freshness changes no answer, whatever comes in whatever order."""
    image, now = DriveImage(drive()), NOW
    ages = dict(zip(ADDRESSES, MAX_AGES, strict=True))
    naive: dict[int, tuple[int, float]] = {}
    ranges = ((0xFD00, 1), (0xFD00, 4), (0xFD01, 2), (0xFD03, 1), (0xFD05, 1), (0xFD00, 5), (0xFD08, 1))
    readings = {each: image.reading(*each) for each in ranges}
    for _ in range(data.draw(st.integers(1, 15))):
        now += data.draw(st.sampled_from([0.0, 0.1, 0.4, 0.5, 1.0, 1.5]))
        if data.draw(st.integers(0, 3)):
            words = data.draw(st.dictionaries(st.sampled_from(ADDRESSES), st.integers(0, 7)))
            image.apply(words.items(), now, WALL)
            naive |= {address: (word, now + ages[address]) for address, word in words.items()}
        else:
            image.set_link(data.draw(st.sampled_from(LinkState)), data.draw(st.sampled_from(["", "why"])))
            if not image.link.is_connected:
                naive.clear()
        for start, count in ranges[:5]:
            told = [naive.get(address, (0, 0.0)) for address in range(start, start + count)]
            is_fresh = image.link.is_connected and all(expires >= now for _, expires in told)
            lost = Missing.LINE_DOWN if image.link is LinkState.LINE_DOWN else Missing.NOT_FRESH
            expected = b"".join(word.to_bytes(2, "big") for word, _ in told) if is_fresh else lost
            assert readings[start, count](now) == image.read(start, count, now) == expected
        assert all(readings[each](now) is image.read(*each, now) is Missing.UNMAPPED for each in ranges[5:])
