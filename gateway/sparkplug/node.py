"""Decides which messages an edge node sends, and in which order: births first, then deaths, births and data. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from typing import Protocol

from gateway import __version__
from gateway.backlog import milliseconds
from gateway.config import SparkplugSection
from gateway.control.command import Channel, Result, Source
from gateway.control.drive_control import DriveControl
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt import outcome
from gateway.sparkplug import drive_metrics
from gateway.sparkplug.definition import Definer, Definition
from gateway.sparkplug.device import Device, Moment
from gateway.sparkplug.drive_metrics import EVENT, RESULT
from gateway.sparkplug.history import Missed
from gateway.sparkplug.payload import DataType, Metric, Payload, Value, Written, encode, message
from gateway.sparkplug.session import Happening, Phase, Session
from gateway.sparkplug.topics import Topics

BD_SEQ, REBIRTH = "bdSeq", "Node Control/Rebirth"  # the two metrics of the node that the specification names
CONNECTED = "Drives Connected"
ANY_HOST = Source(Channel.SPARKPLUG)
TELLING = (Phase.DEVICE_BIRTHS, Phase.LIVE)  # when hosts may know drives: those that were born
BETWEEN_BIRTHS = 1.0  # seconds, so that no flood of requests for a rebirth becomes one of births


class Wire(Protocol):
    """The way to the broker: takes messages in order, never waits."""

    @property
    def room(self) -> int:
        """Return how many more messages may be on their way."""
        ...

    def carry(self, topic: str, payload: bytes) -> bool:
        """Take a message at QoS 0, not to be retained; False where it is larger than the broker takes."""
        ...


class Node:
    """The edge node of a gateway: all its drives on their way to the hosts of one broker."""

    def __init__(
        self,
        section: SparkplugSection,
        gateway: str,
        image: Image,
        stats: MqttStats,
        controls: Mapping[str, DriveControl] | None = None,
        lines: Mapping[str, tuple[str, ...]] | None = None,
    ) -> None:
        self.topics = Topics(section.group_id, section.edge_node_id or gateway)
        self.session = Session()
        self._stats = stats
        self._images = image.drives
        self._birth_at = float("-inf")  # monotonic seconds: an NBIRTH must not come sooner
        self._told: dict[str, Value] = {}
        controls = controls or {}
        definer = Definer(count(1))
        self._standing = {CONNECTED: definer.define(CONNECTED, DataType.INT32)}
        self._constants = [
            (definer.define("Properties/Software", DataType.STRING), "tosvert-gateway"),
            (definer.define("Properties/Version", DataType.STRING), __version__),
            (definer.define("Properties/Gateway", DataType.STRING), gateway),
        ]
        self.line_inputs: dict[str | int, str] = {}  # metric name or alias -> line
        self._inputs: list[Definition] = []
        for line, drives in (lines or {}).items():
            if section.commands and any(drive in controls for drive in drives):
                self._define_line(definer, line)
        self.devices: dict[str, Device] = {}
        for each in image.drives:
            control = controls.get(each.drive.name)
            may_command = section.commands and control is not None and control.settings.may_write(ANY_HOST)
            metrics = drive_metrics.define(definer, each, is_controlled=control is not None, may_command=may_command)
            self.devices[each.drive.name] = Device(each, metrics, section.deadband, control)
        self._debtors: dict[str, Device] = {}
        self._connected = 0  # drives
        self._count()

    def _define_line(self, definer: Definer, line: str) -> None:
        definition = definer.define(f"Lines/{line}/Command", DataType.STRING, is_writable=True)
        self._inputs.append(definition)
        self.line_inputs |= {definition.name: line, definition.alias: line}

    # ---- what happens

    def will(self, ms: int) -> bytes:
        """Return the NDEATH of the next connection."""
        return self._death(self.session.next_bd_seq, ms)

    def death(self, ms: int) -> bytes:
        """Return the NDEATH of this connection."""
        return self._death(self.session.bd_seq, ms)

    def _death(self, bd_seq: int, ms: int) -> bytes:
        return encode(Payload(ms, (Metric(BD_SEQ, None, ms, DataType.INT64, bd_seq),)))

    def take(self, happening: Happening) -> None:
        """Take what happens to the session; where it ends, or begins anew, hosts know of no drive any more."""
        self._count()
        self.session.take(happening)
        if self.session.phase not in TELLING:
            for device in self.devices.values():
                device.begin()

    def rebirth(self) -> None:
        """Send no data any more, and every birth anew."""
        self.take(Happening.REBIRTH)

    def note_change(self, image: DriveImage, names: Sequence[str], now: float) -> None:
        """Take what is news of a drive."""
        if not names:
            self._count()
        device = self.devices[image.drive.name]
        device.take(names, now)
        self._debtors[device.name] = device

    def note_result(self, result: Result, wall: float) -> None:
        """Take what became of a command, to be told by its drive."""
        drive, text = result.command.drive, outcome.result(result, wall)
        self._stats.untold += not self._note(drive, RESULT, text, wall)

    def note_event(self, drive: str, event: str, reason: str, wall: float) -> bool:
        """Take what happened to a drive, to be told by it; False where it cannot be told now."""
        return self._note(drive, EVENT, outcome.event(event, reason, wall), wall)

    def tells_events(self, drive: str) -> bool:
        """Say whether hosts are told what happens to a drive: who may be commanded has a metric for it."""
        return drive in self.devices and EVENT in self.devices[drive].metrics.told

    def _note(self, drive: str, name: str, text: str, wall: float) -> bool:
        device = self.devices.get(drive)
        if device is None:
            return True
        self._debtors[drive] = device
        return device.note(name, text, milliseconds(wall))

    def look(self) -> None:
        """Look at every drive, since who may command it changes without a word."""
        self._count()
        self._debtors |= {name: device for name, device in self.devices.items() if device.is_owing}

    # ---- what is said

    def held_back(self, now: float) -> float:
        """Return for how many seconds an NBIRTH that was asked for too soon has to wait; 0 where none has."""
        return max(0.0, self._birth_at - now) if self.session.phase is Phase.NODE_BIRTH else 0.0

    def is_owing(self, now: float) -> bool:
        """Say whether hosts lack anything that may be sent now."""
        match self.session.phase:
            case Phase.NODE_BIRTH:
                return not self.held_back(now)
            case Phase.DEVICE_BIRTHS:
                return True
            case Phase.LIVE:
                return bool(self._debtors) or self._is_node_news
        return False

    def settle(self, wire: Wire, moment: Moment, steps: int) -> None:
        """Send some of what is owed: at most `steps` messages, so that no line need wait long."""
        for _ in range(steps):
            if not wire.room or not self.is_owing(moment.now):
                return
            match self.session.phase:
                case Phase.NODE_BIRTH:
                    self._send_node_birth(wire, moment)
                case Phase.DEVICE_BIRTHS:
                    self._send_next_birth(wire, moment)
                case _:
                    self._send_live(wire, moment)

    def settle_drive(self, wire: Wire, name: str, moment: Moment) -> None:
        """Send what one drive owes, at once, where data may be sent and there is room."""
        if self.session.phase is Phase.LIVE and wire.room:
            self._settle_device(wire, self.devices[name], moment)

    def send_told(self, wire: Wire, name: str, moment: Moment) -> bool:
        """Send what became of a drive's commands and what happened to it, and nothing else; say whether that went.

        How the drive stands goes later: whoever tells of an event may be about to change it.
        """
        device = self.devices[name]
        if self.session.phase is not Phase.LIVE or not wire.room or not device.is_born or device.owes_death:
            return False
        return self._send(wire, self.topics.of_device("DDATA", name), device.told(), moment)

    def send_missed(self, wire: Wire, missed: Missed, moment: Moment) -> bool:
        """Send what hosts have missed of a drive; False where it is larger than the broker takes."""
        return self._send(wire, self.topics.of_device("DDATA", missed.drive), missed.metrics, moment)

    @property
    def is_live(self) -> bool:
        """Say whether data may be sent."""
        return self.session.phase is Phase.LIVE

    def is_told(self, drive: str) -> bool:
        """Say whether hosts know all that is to be known of a drive."""
        device = self.devices[drive]
        return self.is_live and device.is_born and not device.is_owing

    @property
    def unborn(self) -> frozenset[str]:
        """Return the drives that hosts do not know, and could not be told anything of."""
        return frozenset(name for name, device in self.devices.items() if not device.is_born)

    def _send_node_birth(self, wire: Wire, moment: Moment) -> None:
        ms = moment.ms
        self._told = self._node_values()
        metrics = [
            Metric(BD_SEQ, None, ms, DataType.INT64, self.session.bd_seq),
            Metric(REBIRTH, None, ms, DataType.BOOLEAN, False),
            *(definition.born(value, ms) for definition, value in self._constants),
            *(definition.born("", ms) for definition in self._inputs),
            *(definition.born(self._told[name], ms) for name, definition in self._standing.items()),
        ]
        self._birth_at = moment.now + BETWEEN_BIRTHS
        if self._send(wire, self.topics.of_node("NBIRTH"), metrics, moment):
            self.session.take(Happening.NODE_BORN)

    def _send_next_birth(self, wire: Wire, moment: Moment) -> None:
        for device in self.devices.values():
            if device.owes_birth:
                self._send_device_birth(wire, device, moment)
                return
        self.session.take(Happening.DEVICES_BORN)
        self._debtors = dict(self.devices)

    def _send_live(self, wire: Wire, moment: Moment) -> None:
        if self._is_node_news:
            before, self._told = self._told, self._node_values()
            news = [name for name, value in self._told.items() if value != before[name]]
            metrics = [self._standing[name].told(self._told[name], moment.ms) for name in news]
            self._send(wire, self.topics.of_node("NDATA"), metrics, moment)
            return
        name, device = next(iter(self._debtors.items()))
        self._settle_device(wire, device, moment)
        if name in self._debtors:  # it may owe more, and lets the others go first
            self._debtors[name] = self._debtors.pop(name)

    def _settle_device(self, wire: Wire, device: Device, moment: Moment) -> None:
        """Send the next message that a drive owes."""
        if device.owes_death:
            device.death()
            self._send(wire, self.topics.of_device("DDEATH", device.name), (), moment)
        elif device.owes_birth:
            self._send_device_birth(wire, device, moment)
        elif device.owes_data:
            metrics = device.data(moment)
            if not self._send(wire, self.topics.of_device("DDATA", device.name), metrics, moment):
                self._stats.dropped += 1
        if device.is_owing:
            self._debtors[device.name] = device
        else:
            self._debtors.pop(device.name, None)

    def _send_device_birth(self, wire: Wire, device: Device, moment: Moment) -> None:
        if not self._send(wire, self.topics.of_device("DBIRTH", device.name), device.birth(moment), moment):
            device.death()
            device.is_barred = True

    def _send(self, wire: Wire, topic: str, metrics: Sequence[Metric | Written], moment: Moment) -> bool:
        """Send a message with the next number, which counts only where the broker takes the message."""
        if not wire.carry(topic, message(moment.ms, metrics, self.session.seq)):
            return False
        self.session.sent()
        return True

    def _node_values(self) -> dict[str, Value]:
        return {CONNECTED: self._connected}

    @property
    def _is_node_news(self) -> bool:
        return self._told.get(CONNECTED) != self._connected

    def _count(self) -> None:
        """Count the drives that are connected; after each change of a link, since answers are many."""
        self._connected = sum(image.link.is_connected for image in self._images)
