"""One drive on its way to a broker: decides which messages it sends, what is news and what it owes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from gateway.config import MqttSection
from gateway.control.drive_control import DriveControl
from gateway.image import DriveImage, Quality
from gateway.metrics import MqttStats
from gateway.mqtt import outcome, payload, topics
from gateway.mqtt.description import Description
from gateway.mqtt.filters import Policy, policies
from gateway.mqtt.report import Report, Said
from gateway.mqtt.topics import ValueTopics

PER_VALUE = 3  # messages: number, words, quality
FOR_EVER = 0  # seconds of expiry: the broker keeps it until told otherwise


class Wire(Protocol):
    """The way to the broker: takes messages in order, never waits."""

    @property
    def room(self) -> int:
        """Return how many more messages may be on their way."""
        ...

    def send(self, topic: str, text: str, *, retain: bool, expiry: int) -> None:
        """Take a message; the broker may forget it after `expiry` seconds (0: never)."""
        ...


class _Value:
    """One value on its way to the broker: all that is known of it, found once."""

    __slots__ = ("expiry", "name", "place", "quality_topic", "said", "spelling", "text_topic", "topic")

    def __init__(self, image: DriveImage, named: ValueTopics, said: Said, expiry: int) -> None:
        self.name = said.name
        self.place = image.places[said.name]
        self.said = said
        self.spelling = payload.Spelling(image, said.name)
        self.topic = named.value
        self.text_topic = named.text or ""
        self.quality_topic = named.quality
        self.expiry = expiry  # seconds


class Outlet:
    """One drive on its way to the broker: what was said of it, and what is owed."""

    def __init__(
        self,
        image: DriveImage,
        section: MqttSection,
        gateway: str,
        stats: MqttStats,
        control: DriveControl | None = None,
    ) -> None:
        self.image = image
        self._control = control
        self._stats = stats
        self._topics = topics.of_drive(section.base, gateway, image)
        found = policies(section, image)
        self._report = Report(image, found)
        self._description = Description(image, section, gateway)
        self._state = payload.StateWriter(image) if "state" in section.publish else None
        self._has_values = "values" in section.publish
        self._retain = section.retain
        self._values = {
            name: _Value(image, self._topics.values[name], self._report.values[name], self._expiry_of(name, policy))
            for name, policy in found.items()
        }
        self._state_expiry = max(v.expiry for v in self._values.values()) + math.ceil(section.state_interval)
        self._state_interval = section.state_interval
        self._state_at = float("-inf")
        self._is_state_held = False
        self._qualities: dict[str, Quality] = {}
        self._owed: dict[str, None] = {}
        self._owes_state = False
        self._owes_standing = False
        self._standing: tuple[object, ...] | None = None  # of control, of which the text below is made
        self._standing_text = ""
        self._said: dict[str, str] = {}  # topic -> what the broker was last told of all but values

    def _expiry_of(self, name: str, policy: Policy) -> int:
        """Return when a number is to be forgotten: twice the time in which a value that is read is said again."""
        derived = self.image.derived.get(name)
        max_age = self.image.points[derived.of if derived else name].max_age
        return math.ceil(2 * (policy.max_interval + max_age))

    @property
    def is_owing(self) -> bool:
        """Say whether the broker lacks anything."""
        return bool(self._owed) or self._owes_state or self._owes_standing

    def owe_everything(self) -> None:
        """Forget what was said: the broker may know nothing."""
        self._qualities.clear()
        self._owed = dict.fromkeys(self.image.names)
        self._owes_state = self._state is not None
        self._owes_standing = True
        self._said.clear()

    def owe_standing(self) -> None:
        """Take that availability, trip, reset or control may have changed."""
        self._owes_standing = True

    @property
    def is_control_news(self) -> bool:
        """Say whether the broker was told something else of who may command."""
        said = self._said.get(self._topics.control)
        return self._control is not None and said is not None and said != self._control_standing()

    def _control_standing(self) -> str:
        """Say who may command, as JSON that is made anew only when that has changed: each second asks each drive."""
        control = self._control
        standing: tuple[object, ...] = ()
        if control is not None:
            standing = control.settings.is_leased, control.standing, control.reason, control.lease.owner
        if standing != self._standing:
            self._standing, self._standing_text = standing, outcome.standing(control)
        return self._standing_text

    def tell(self, wire: Wire, names: Sequence[str], now: float) -> None:
        """Send what is news after an answer, or, without names, after a change of the link."""
        if names:
            self._tell_values(wire, names, now, are_good=now <= self.image.good_until)
            return
        self._owes_standing = True
        self._settle_standing(wire)
        self._owes_state |= self._state is not None and self.image.version > 0
        turned = [name for name, v in self._values.items() if v.said.quality is not self.image.quality(name, now)]
        self._tell_values(wire, turned, now, are_good=False)

    def _tell_values(self, wire: Wire, names: Sequence[str], now: float, *, are_good: bool) -> None:
        """Send what is news of these values: the way of every answer, so that nothing is looked up twice here."""
        has_room = wire.room >= PER_VALUE * len(names)  # for all of them
        is_news = has_turned = False
        for name in names:
            value = self._values[name]
            place, said = value.place, value.said
            if are_good:
                word, quality = place.numbers[place.offset], Quality.GOOD
            else:
                word, quality, _, _ = self.image.sample(name, now)
            if said.is_due(word, quality, now):
                is_news = True
                has_turned |= said.quality is not quality
                if not self._has_values and not self._owed:
                    said.note(word, quality, now)
                elif not self._has_values or has_room or wire.room >= PER_VALUE:
                    self._send_value(wire, value, word, quality, now)
                else:
                    self._owed[name] = None
                    self._stats.dropped += 1
        if is_news and self._state is not None:
            if has_turned or now - self._state_at >= self._state_interval:
                self._tell_state(self._state, wire, now)
            else:
                self._is_state_held = True

    def release(self, now: float) -> None:
        """Owe what had to wait for its turn, when that has come."""
        self._owed.update(dict.fromkeys(self._report.released(now)))
        if self._is_state_held and now - self._state_at >= self._state_interval:
            self._owes_state = True

    def _tell_state(self, state: payload.StateWriter, wire: Wire, now: float) -> None:
        if wire.room:
            self._send_state(wire, state.write(now), now)
        else:
            self._owes_state = True
            self._stats.dropped += 1

    def settle(self, wire: Wire, now: float) -> None:
        """Send one of the things that are owed: availability, then values, then the state."""
        if self._owes_standing:
            self._settle_standing(wire)
        elif self._owed:
            name = next(iter(self._owed))
            word, quality, _, _ = self.image.sample(name, now)
            self._send_value(wire, self._values[name], word, quality, now)
        elif self._state is not None and self._owes_state:
            self._send_state(wire, self._state.write(now), now)

    def _settle_standing(self, wire: Wire) -> None:
        """Say what the broker does not know yet of availability, trip, reset and control, as far as there is room."""
        image, to = self.image, self._topics
        standing = {
            to.tripped: payload.TRUTH[image.is_tripped],
            to.reset_needed: payload.TRUTH[image.is_reset_needed],
            to.control: self._control_standing(),
            to.description: self._description.write(),
            to.availability: payload.presence(image.link.is_connected),
        }
        for topic, text in standing.items():
            if self._said.get(topic) == text:
                continue
            if not wire.room:
                return
            self._said[topic] = text
            wire.send(topic, text, retain=True, expiry=FOR_EVER)
        self._owes_standing = False

    def _send_value(self, wire: Wire, value: _Value, word: int, quality: Quality, now: float) -> None:
        """Send a value's messages so that its quality never promises more than its number keeps.

        Nothing is sent as retained always, since that is what clears a topic.
        """
        if self._owed:
            self._owed.pop(value.name, None)
        value.said.note(word, quality, now)
        if not self._has_values:
            return
        is_good = quality is Quality.GOOD
        if not is_good:
            self._send_quality(wire, value, quality)
        retain = self._retain or not is_good
        wire.send(value.topic, value.spelling.value(word, quality), retain=retain, expiry=value.expiry)
        if value.text_topic:
            wire.send(value.text_topic, value.spelling.text(word, quality), retain=retain, expiry=value.expiry)
        if is_good:
            self._send_quality(wire, value, quality)

    def _send_quality(self, wire: Wire, value: _Value, quality: Quality) -> None:
        if self._qualities.get(value.name) is not quality:
            self._qualities[value.name] = quality
            wire.send(value.quality_topic, payload.WORDS[quality], retain=True, expiry=FOR_EVER)

    def _send_state(self, wire: Wire, text: str, now: float) -> None:
        self._owes_state = self._is_state_held = False
        self._state_at = now
        wire.send(self._topics.state, text, retain=self._retain, expiry=self._state_expiry)

    def leave(self, wire: Wire) -> None:
        """Say that the drive cannot be seen from here any more."""
        wire.send(self._topics.availability, payload.presence(False), retain=True, expiry=FOR_EVER)

    def clear(self, wire: Wire, now: float) -> None:
        """Take back every number that was said to be good."""
        for topic in (self._topics.tripped, self._topics.control):
            if self._said.get(topic):
                wire.send(topic, payload.NOTHING, retain=True, expiry=FOR_EVER)
        for name in [name for name, quality in self._qualities.items() if quality is Quality.GOOD]:
            word, quality, _, _ = self.image.sample(name, now)
            self._send_value(wire, self._values[name], word, payload.left_behind(quality), now)
        if self._state is not None:
            self._send_state(wire, self._state.write(now, is_leaving=True), now)
