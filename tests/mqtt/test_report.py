"""Report by exception."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import MqttSection
from gateway.image import DriveImage, LinkState, Quality
from gateway.mqtt.filters import policies
from gateway.mqtt.report import Report
from tests.mqtt import drives


class Reported:
    """A drive whose readings go through a report; `said` is what a subscriber last heard of each value."""

    def __init__(
        self,
        deadband: Mapping[str, float] | None = None,
        of_drive: Mapping[str, float] | None = None,
        silence: float = 60.0,
        filters: Sequence[Mapping[str, object]] = (),
    ) -> None:
        self.image: DriveImage = drives.image(drives.drive(deadband=of_drive)).drives[0]
        table = {"url": "mqtt://localhost", "deadband": deadband or {}, "filter": list(filters)}
        section = MqttSection.model_validate(table).model_copy(update={"longest_silence": silence})
        self.report = Report(self.image, policies(section, self.image))
        self.said: dict[str, int] = {}

    def read(self, now: float, **words: int) -> set[str]:
        """Read values; return the names of those that are due, which then are said."""
        drives.read(self.image, now, **words)
        return self.offer(now, *words)

    def offer(self, now: float, *names: str) -> set[str]:
        """Offer values as they are; return the names of those that are due, which then are said."""
        due = set()
        for name in names:
            sample = self.image.sample(name, now)
            said = self.report.values[name]
            if said.is_due(sample.word, sample.quality, now):
                due.add(name)
                self.said[name] = sample.word
                said.note(sample.word, sample.quality, now)
        return due


def test_the_first_reading_is_due_and_the_same_again_is_not() -> None:
    """News is what has changed."""
    drive = Reported()
    assert drive.read(0.0, output_frequency=6000, status=1) == {"output_frequency", "status"}
    assert drive.read(0.1, output_frequency=6000, status=1) == set()
    assert drive.read(0.2, output_frequency=6001, status=1) == {"output_frequency"}


def test_a_change_within_the_deadband_is_no_news_and_one_beyond_it_is() -> None:
    """In engineering units, counted from what was said last: a slow drift comes through."""
    drive = Reported({"output_frequency": 0.5})
    drive.read(0.0, output_frequency=6000)
    assert not drive.read(0.1, output_frequency=6050)
    assert not drive.read(0.2, output_frequency=5950)
    assert drive.read(0.3, output_frequency=6051)
    assert not drive.read(0.4, output_frequency=6001)


def test_the_drives_own_deadband_wins() -> None:
    """It knows better than the one for all."""
    drive = Reported({"output_frequency": 5.0}, {"output_frequency": 0.0})
    drive.read(0.0, output_frequency=6000)
    assert drive.read(0.1, output_frequency=6001)


def test_a_signed_value_crosses_zero_by_little() -> None:
    """FFFFH to 0001H is 0.02, not 655."""
    drive = Reported({"torque": 0.5})
    drive.read(0.0, torque=0xFFFF)
    assert not drive.read(0.1, torque=0x0001)


def test_bits_and_codes_have_no_deadband() -> None:
    """Each of them is something else."""
    drive = Reported({"status": 100.0, "trip_code": 100.0})
    drive.read(0.0, status=0, trip_code=0)
    assert drive.read(0.1, status=1, trip_code=1) == {"status", "trip_code"}


def test_a_derived_value_has_a_deadband_of_its_own() -> None:
    """Amperes, where the register has per cent."""
    drive = Reported({"output_current": 1.0})
    drive.read(0.0, output_current_rate=5000)
    drive.offer(0.0, "output_current")
    drive.read(0.1, output_current_rate=5500)
    assert drive.offer(0.1, "output_current_rate", "output_current") == set()  # 6.25 A, 6.88 A
    drive.read(0.2, output_current_rate=6000)
    assert drive.offer(0.2, "output_current") == {"output_current"}  # 7.50 A


@pytest.mark.hazard("H19")
def test_a_quality_that_changes_is_due_whatever_the_number() -> None:
    """Good, stale, good; offline at once."""
    drive = Reported({"output_frequency": 100.0}, silence=1000.0)
    drive.read(0.0, output_frequency=6000)
    assert drive.offer(drives.MAX_AGE + 0.1, "output_frequency") == {"output_frequency"}
    assert drive.offer(drives.MAX_AGE + 0.2, "output_frequency") == set()
    assert drive.read(2.0, output_frequency=6000) == {"output_frequency"}
    drive.image.set_link(LinkState.OFFLINE)
    assert drive.report.values["output_frequency"].quality is Quality.GOOD  # which was published
    assert drive.offer(2.0, "output_frequency") == {"output_frequency"}


def test_no_silence_means_every_reading() -> None:
    """longest_silence = "0s"."""
    drive = Reported(silence=0.0)
    assert all(drive.read(float(now), output_frequency=6000) for now in range(5))


def test_what_was_not_said_stays_due() -> None:
    """Only what is noted counts as said."""
    drive = Reported()
    drives.read(drive.image, 0.0, output_frequency=6000)
    said = drive.report.values["output_frequency"]
    assert said.is_due(6000, Quality.GOOD, 0.0)
    assert said.is_due(6000, Quality.GOOD, 0.0)


@pytest.mark.parametrize("name", ["output_frequency", "torque"])
@given(before=st.integers(0, 0xFFFF), step=st.integers(-60, 60), band=st.decimals(0, 700, places=3))
def test_a_deadband_in_counts_is_the_one_in_units(name: str, before: int, step: int, band: Decimal) -> None:
    """Signed or not; it need not be a whole number of counts."""
    drive, after = Reported({name: float(band)}), (before + step) % 0x10000
    drive.read(0.0, **{name: before})
    moved = abs(drive.image.number(name, after) - drive.image.number(name, before)) > band
    assert (drive.read(0.1, **{name: after}) == {name}) is (moved or (not band and before != after))


def test_an_endless_deadband_is_never_left() -> None:
    """Only the longest silence says such a value again."""
    drive = Reported({"torque": 1e30}, silence=10.0)
    drive.read(0.0, torque=0x7FFF)
    assert not drive.read(1.0, torque=0x8000)
    assert drive.read(10.0, torque=0x8000)


words = st.lists(st.integers(0, 0xFFFF) | st.integers(5900, 6100), min_size=1, max_size=40)


@given(words=words, band=st.integers(0, 2000))
def test_a_deadband_never_hides_more_than_itself(words: list[int], band: int) -> None:
    """What a subscriber knows is never further off than that."""
    drive = Reported({"output_frequency": band / 100})
    for now, word in enumerate(words):
        drive.read(now / 10, output_frequency=word)
        number = drive.image.number
        off = abs(number("output_frequency", drive.said["output_frequency"]) - number("output_frequency", word))
        assert off <= Decimal(band) / 100


@given(words=words)
def test_without_a_deadband_a_subscriber_knows_every_word(words: list[int]) -> None:
    """What is said reproduces what is read."""
    drive = Reported()
    for now, word in enumerate(words):
        drive.read(now / 10, torque=word)
        assert drive.said["torque"] == word


@given(period=st.floats(0.01, 5.0), silence=st.floats(0.0, 100.0))
def test_an_unchanged_value_is_said_again_after_the_longest_silence(period: float, silence: float) -> None:
    """At the first reading after it, in virtual hours; not sooner."""
    drive = Reported(silence=silence)
    said_at = 0.0
    drive.read(0.0, output_frequency=6000)
    for step in range(1, 200):
        now = step * period
        if drive.read(now, output_frequency=6000):
            assert now - said_at >= min(silence, period)
            said_at = now
        else:
            assert now - said_at < silence


def test_a_value_is_not_said_more_often_than_its_least_interval() -> None:
    """And when the time has come, as it is then."""
    drive = Reported(filters=[{"values": ["output_*"], "min_interval": "1s"}])
    drive.read(0.0, output_frequency=6000, torque=1)
    assert drive.read(0.4, output_frequency=6100, torque=2) == {"torque"}
    assert drive.read(0.8, output_frequency=6200) == set()
    assert drive.report.released(0.9) == []
    assert drive.report.released(1.0) == ["output_frequency"]
    assert drive.read(1.0, output_frequency=6300) == {"output_frequency"}
    assert drive.report.released(9.0) == []


def test_what_came_back_before_its_turn_is_not_said() -> None:
    """A subscriber knows it already."""
    drive = Reported(filters=[{"min_interval": "1s"}])
    drive.read(0.0, output_frequency=6000)
    drive.read(0.4, output_frequency=6100)
    drive.read(0.8, output_frequency=6000)
    assert drive.report.released(2.0) == []


@pytest.mark.hazard("H19")
def test_no_interval_delays_a_value_that_is_no_longer_good() -> None:
    """Nor one that is good again."""
    drive = Reported(filters=[{"min_interval": "30s", "deadband": 50.0}])
    drive.read(0.0, output_frequency=6000)
    drive.image.set_link(LinkState.OFFLINE)
    assert drive.offer(0.1, "output_frequency") == {"output_frequency"}
    drive.image.set_link(LinkState.ONLINE)
    assert drive.read(0.2, output_frequency=6000) == {"output_frequency"}


def test_a_reading_at_the_rate_of_the_interval_is_not_halved() -> None:
    """However much it jitters."""
    drive = Reported(filters=[{"min_interval": "1s"}])
    times = [float(n) - (0.02 if n % 2 else 0.0) for n in range(20)]
    assert all(drive.read(now, output_frequency=n) for n, now in enumerate(times))


def test_a_deadband_in_per_cent_goes_with_the_value() -> None:
    """Of what was said last; near zero the absolute one counts."""
    drive = Reported(filters=[{"deadband_percent": 10.0, "deadband": 0.5}])
    drive.read(0.0, output_frequency=5000)
    assert not drive.read(0.1, output_frequency=5500)
    assert drive.read(0.2, output_frequency=5501)
    drive.read(0.3, output_frequency=0)
    assert not drive.read(0.4, output_frequency=50)
    assert drive.read(0.5, output_frequency=51)


def test_a_value_within_its_deadband_is_repeated_in_time() -> None:
    """The last filter that speaks of it holds, key by key."""
    filters: list[dict[str, object]] = [
        {"deadband": 5.0, "max_interval": "10s"},
        {"values": ["output_frequency"], "max_interval": "2s"},
    ]
    drive = Reported(filters=filters)
    drive.read(0.0, output_frequency=6000, torque=0)
    assert not drive.read(1.9, output_frequency=6001, torque=1)
    assert drive.read(2.0, output_frequency=6001, torque=1) == {"output_frequency"}
    assert drive.read(10.0, torque=1) == {"torque"}


def test_a_filter_for_other_drives_says_nothing_of_this_one() -> None:
    """By the drive's name."""
    drive = Reported(filters=[{"drives": ["fan-*"], "min_interval": "1h"}])
    drive.read(0.0, output_frequency=6000)
    assert drive.read(0.1, output_frequency=6001)


@given(words=words, interval=st.floats(0.1, 5.0), period=st.floats(0.01, 2.0))
def test_the_last_word_is_said_in_the_end_and_never_too_often(
    words: list[int], interval: float, period: float
) -> None:
    """Whatever the readings: a subscriber ends up with what was read last."""
    drive = Reported(filters=[{"min_interval": f"{interval:.3f}s", "max_interval": "24h"}])
    times = []
    for step, word in enumerate(words):
        if drive.read(step * period, torque=word):
            times.append(step * period)
    assert all(later - sooner >= 0.9 * interval for sooner, later in pairwise(times))
    for name in drive.report.released(len(words) * period + interval):
        drive.said[name] = drive.image.sample(name, 0.0).word
    assert drive.said["torque"] == words[-1]
