"""Decides which messages go to the broker, and sees to it that none is missing there for good.

What is news is sent at once while there is room for it. What found no room is owed, and so is everything after a
connect; owed values are sent as they are when their turn comes, so that an old number never follows a newer one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gateway.config import MqttSection
from gateway.control.drive_control import DriveControl
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt import payload, topics
from gateway.mqtt.discovery import Discovery
from gateway.mqtt.message import Message
from gateway.mqtt.outlet import FOR_EVER, PER_VALUE, Outlet, Wire


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
