"""Decides which messages go to the broker, and sees to it that none is missing there for good.

What is news is sent at once while there is room for it. What found no room is owed, and so is everything after a
connect; owed values are sent as they are when their turn comes, so that an old number never follows a newer one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

from gateway.config import MqttSection
from gateway.control.drive_control import DriveControl
from gateway.image import DriveImage, Image, Quality, Sample
from gateway.metrics import MqttStats
from gateway.mqtt import outcome, payload, topics
from gateway.mqtt.description import Description
from gateway.mqtt.discovery import Discovery
from gateway.mqtt.filters import Policy, policies
from gateway.mqtt.message import Message
from gateway.mqtt.report import Report

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
        self._expiry = {name: self._expiry_of(name, policy) for name, policy in found.items()}
        self._state_expiry = max(self._expiry.values()) + math.ceil(section.state_interval)
        self._state_interval = section.state_interval
        self._state_at = float("-inf")
        self._is_state_held = False
        self._qualities: dict[str, Quality] = {}
        self._owed: dict[str, None] = {}
        self._owes_state = False
        self._owes_standing = False
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
        return self._control is not None and said is not None and said != outcome.standing(self._control)

    def tell(self, wire: Wire, names: Sequence[str], now: float) -> None:
        """Send what is news after an answer, or, without names, after a change of the link."""
        if not names:
            self._owes_standing = True
            self._settle_standing(wire)
            self._owes_state |= self._state is not None and self.image.version > 0
            names = [n for n in self.image.names if self._report.has_turned(n, self.image.quality(n, now))]
        is_news = has_turned = False
        for name in names:
            sample = self.image.sample(name, now)
            if self._report.is_due(name, sample, now):
                is_news = True
                has_turned |= self._report.has_turned(name, sample.quality)
                self._tell_value(wire, name, sample, now)
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

    def _tell_value(self, wire: Wire, name: str, sample: Sample, now: float) -> None:
        if not self._has_values or wire.room >= PER_VALUE:
            self._send_value(wire, name, sample, now)
        else:
            self._owed[name] = None
            self._stats.dropped += 1

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
            self._send_value(wire, name, self.image.sample(name, now), now)
        elif self._state is not None and self._owes_state:
            self._send_state(wire, self._state.write(now), now)

    def _settle_standing(self, wire: Wire) -> None:
        """Say what the broker does not know yet of availability, trip, reset and control, as far as there is room."""
        image, to = self.image, self._topics
        standing = {
            to.tripped: payload.TRUTH[image.is_tripped],
            to.reset_needed: payload.TRUTH[image.is_reset_needed],
            to.control: outcome.standing(self._control),
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

    def _send_value(self, wire: Wire, name: str, sample: Sample, now: float) -> None:
        """Send a value's messages so that its quality never promises more than its number keeps."""
        self._owed.pop(name, None)
        self._report.note(name, sample, now)
        if not self._has_values:
            return
        if sample.quality is not Quality.GOOD:
            self._send_quality(wire, name, sample.quality)
        named = self._topics.values[name]
        self._send_text(wire, named.value, payload.value(self.image, name, sample), self._expiry[name])
        if named.text is not None:
            self._send_text(wire, named.text, payload.text(self.image, name, sample), self._expiry[name])
        if sample.quality is Quality.GOOD:
            self._send_quality(wire, name, sample.quality)

    def _send_text(self, wire: Wire, topic: str, text: str, expiry: int) -> None:
        """Send a number or words; nothing is sent as retained always, since that is what clears a topic."""
        wire.send(topic, text, retain=self._retain or text == payload.NOTHING, expiry=expiry)

    def _send_quality(self, wire: Wire, name: str, quality: Quality) -> None:
        if self._qualities.get(name) is not quality:
            self._qualities[name] = quality
            wire.send(self._topics.values[name].quality, payload.WORDS[quality], retain=True, expiry=FOR_EVER)

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
            self._send_value(wire, name, payload.left_behind(self.image.sample(name, now)), now)
        if self._state is not None:
            self._send_state(wire, self._state.write(now, is_leaving=True), now)


class Publisher:
    """All drives of a gateway on their way to one broker."""

    def __init__(
        self,
        section: MqttSection,
        gateway: str,
        image: Image,
        stats: MqttStats,
        controls: Mapping[str, DriveControl] | None = None,
    ) -> None:
        is_discovered = section.home_assistant.enabled
        self.discovery = Discovery(section, gateway, image) if is_discovered else None
        self._forgets = not section.retain
        self.status_topic = topics.status(section.base, gateway)
        control = controls or {}
        self._outlets = {
            drive.drive.name: Outlet(drive, section, gateway, stats, control.get(drive.drive.name))
            for drive in image.drives
        }
        self._debtors: dict[str, Outlet] = {}
        self._owes_birth = False

    @property
    def is_owing(self) -> bool:
        """Say whether the broker lacks anything."""
        has_to_tell = self.discovery is not None and self.discovery.is_owing
        return bool(self._debtors) or self._owes_birth or has_to_tell

    def owe_everything(self) -> None:
        """Begin anew after a connect. The birth comes last: "online" vouches for all that was said before."""
        for outlet in self._outlets.values():
            outlet.owe_everything()
        self._debtors = dict(self._outlets)
        self._owes_birth = True
        if self.discovery is not None:
            self.discovery.owe_everything()

    def tell(self, wire: Wire, image: DriveImage, names: Sequence[str], now: float) -> None:
        """Send what is news of a drive; see `Outlet.tell`."""
        name = image.drive.name
        outlet = self._outlets[name]
        outlet.tell(wire, names, now)
        if not names and self.discovery is not None:
            self.discovery.notice(image)
        if outlet.is_owing:
            self._debtors[name] = outlet

    def owe_standing(self, drive: str) -> None:
        """Take that who may command a drive has changed."""
        self._outlets[drive].owe_standing()
        self._debtors[drive] = self._outlets[drive]

    def look(self, now: float) -> None:
        """Look whether who may command a drive has changed without a word, and what need not wait any longer."""
        for drive, outlet in self._outlets.items():
            outlet.release(now)
            if outlet.is_control_news:
                outlet.owe_standing()
            if outlet.is_owing:
                self._debtors[drive] = outlet
        if self.discovery is not None and self.discovery.look(now):
            self._tell_again()

    def settle(self, wire: Wire, now: float, steps: int) -> None:
        """Send some of what is owed: at most `steps` values, so that the line need not wait long."""
        for _ in range(steps):
            if wire.room < PER_VALUE:
                return
            if not self._debtors:
                self._settle_rest(wire)
                return
            name, outlet = next(iter(self._debtors.items()))
            outlet.settle(wire, now)
            if not outlet.is_owing:
                del self._debtors[name]

    def _settle_rest(self, wire: Wire) -> None:
        """Send the birth, or one message for Home Assistant."""
        if self._owes_birth:
            self._owes_birth = False
            wire.send(self.status_topic, payload.ONLINE, retain=True, expiry=FOR_EVER)
        elif self.discovery is not None and self.discovery.is_owing:
            topic, text = self.discovery.next()
            wire.send(topic, text, retain=True, expiry=FOR_EVER)

    def hear(self, message: Message, now: float) -> None:
        """Take what the broker keeps from before, or that Home Assistant has started."""
        if self.discovery is not None and self.discovery.hear(message, now):
            self._tell_again()

    def _tell_again(self) -> None:
        """Owe the values as well, where the broker keeps none."""
        if self._forgets:
            self.owe_everything()

    def leave(self, wire: Wire, now: float) -> None:
        """Say that the gateway ends: first what takes the trust from everything, then the rest one by one."""
        wire.send(self.status_topic, payload.OFFLINE, retain=True, expiry=FOR_EVER)
        for outlet in self._outlets.values():
            outlet.leave(wire)
        for outlet in self._outlets.values():
            outlet.clear(wire, now)
