"""Controllers: an MQTT client and a PLC on MODBUS-TCP. They ask, beat, hear results, and die without a word."""

from __future__ import annotations

import json
import struct
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from random import Random
from typing import Any

from gateway.control.command import Verb
from gateway.modbus_tcp.mirror_map import LINES_AT, MIRROR_AT, ORDERS, PER_DRIVE, Place
from tests.simulation.broker import Broker, Message
from tests.simulation.links import Cable, Network
from tests.simulation.orders import Order, Player, Script
from tests.simulation.setup import HUNDREDTHS, LINE, ROOT, TCP_PORT, Setup
from tests.simulation.world import World

MIRROR_UNIT = 255
WRITE_ONE, WRITE_MANY = 0x06, 0x10
MBAP = struct.Struct(">HHHB")
REFUSED = {0x01: "not_permitted", 0x02: "address", 0x03: "range", 0x04: "failed", 0x06: "busy", 0x0B: "no_answer"}
ACKNOWLEDGE = 0x05
COMMAND_AT, FREQUENCY_AT = 0xFA00, 0xFA01
RAW = {Verb.RUN: 0xC400, Verb.STOP: 0xC000, Verb.COAST: 0xC800, Verb.FREQUENCY: 0}  # FA00, as drives have it
SAID_TWICE = 0.05  # probability that a command is sent again
CODES = {(order.verb, order.is_reverse): code for code, order in ORDERS.items()}
BEATS = 3  # a lease
REMEMBERED = 200  # orders whose results are still waited for

Heard = Callable[[Order], None]
Beaten = Callable[[str, str, bytes], None]


class Controller(ABC):
    """One source. `heard` and `beaten` are told what has reached the gateway, and when."""

    def __init__(self, world: World, setup: Setup, source: str, heard: Heard, beaten: Beaten) -> None:
        self.source = source
        self.is_alive = True
        self.orders: deque[Order] = deque(maxlen=REMEMBERED)
        self.chance: Random = world.chance(f"controller {source}")
        self._world = world
        self._setup = setup
        self._heard = heard
        self._beaten = beaten
        self._players: list[Player] = []
        self._asked_for = 0
        self._beats = self.chance.randrange(1000)

    # ---- what it does

    def play(self, script: Script) -> None:
        """Do what a script says, beside all else."""
        self._players.append(Player(self._world, script))

    def die(self) -> None:
        """Say nothing any more."""
        self._world.note("dies", self.source)
        self.is_alive = False
        for player in self._players:
            player.end()
        self._players.clear()

    def order(self, drive: str, verb: Verb, value: Decimal | None = None, **more: Any) -> Order:
        """Ask for something."""
        order = self._made(drive, verb, value)
        if self.is_alive:
            self._send(order, **more)
        return order

    def _made(self, drive: str, verb: Verb, value: Decimal | None = None) -> Order:
        self._asked_for += 1
        order = Order(self.source, drive, verb, f"{self.source}-{self._asked_for}", value, self._world.wall())
        self.orders.append(order)
        return order

    def stop_line(self) -> None:
        """Have every drive of the line stopped in an emergency."""
        if self.is_alive:
            self._send_stop_of_line([self._made(drive, Verb.EMERGENCY_STOP) for drive in self._setup.names])

    def revive(self) -> None:
        """Come back to life, with nothing to do yet."""
        self._world.note("revives", self.source)
        self.is_alive = True

    def beat_for(self, drive: str) -> Script:
        """Give signs of life for as long as it lives."""
        while True:
            self._beats += 1
            self._beat(drive, self._beats)
            yield self._setup.lease / BEATS * self.chance.uniform(0.7, 1.0)

    def arrived(self, order: Order) -> None:
        """Take note that a command is in the gateway's socket, for the first time since the gateway was started."""
        if order.delivered is None or order.delivered < self._world.started:
            order.delivered, order.written = self._world.now, 0
            self._world.note("heard", order.source, order.drive, order.verb.value, order.id)
            self._heard(order)

    @abstractmethod
    def _send(self, order: Order, **more: Any) -> None:
        """Send a command."""

    @abstractmethod
    def _send_stop_of_line(self, orders: Sequence[Order]) -> None:
        """Send one command that is an order for each drive."""

    @abstractmethod
    def _beat(self, drive: str, beat: int) -> None:
        """Send a sign of life."""


class MqttController(Controller):
    """A client of the broker."""

    def __init__(self, world: World, setup: Setup, source: str, heard: Heard, beaten: Beaten, broker: Broker) -> None:
        super().__init__(world, setup, source, heard, beaten)
        self._broker = broker
        self.says_when = self.chance.random() < 0.5
        broker.listen(f"{ROOT}/+/result", self._on_result)

    @staticmethod
    def payload_of(order: Order, wall: float | None = None) -> bytes:
        """Return what a command looks like; `wall` is when it was issued, where it says so."""
        table: dict[str, Any] = {"command": order.verb.value, "id": order.id, "source": order.source}
        if order.value is not None:
            table["frequency"] = float(order.value)
        if wall is not None:
            table["issued"] = datetime.fromtimestamp(wall, UTC).isoformat()
        return json.dumps(table).encode()

    def message(self, order: Order, *, qos: int = 1, is_retained: bool = False) -> Message:
        """Return the message of a command."""
        topic = f"{ROOT}/{order.drive}/command"
        payload = self.payload_of(order, order.issued if self.says_when else None)
        return Message(topic, payload, qos, is_retained, tag=lambda: self.arrived(order))

    def _send(self, order: Order, **more: Any) -> None:
        self._broker.publish(self.message(order, **more))
        if self.chance.random() < SAID_TWICE:
            self._world.after(self.chance.uniform(0.0, 1.0), lambda: self._again(order, **more))

    def _again(self, order: Order, **more: Any) -> None:
        """Send the same command again, as clients do that have not heard of its arrival."""
        if self.is_alive:
            self._broker.publish(self.message(order, **more))

    def _send_stop_of_line(self, orders: Sequence[Order]) -> None:
        def arrived() -> None:
            for order in orders:
                self.arrived(order)

        payload = json.dumps({"command": Verb.EMERGENCY_STOP.value, "source": self.source}).encode()
        self._broker.publish(Message(f"{ROOT}/line/{LINE}/command", payload, 1, tag=arrived))

    def _beat(self, drive: str, beat: int) -> None:
        payload = json.dumps({"source": self.source, "beat": beat}).encode()

        def arrived() -> None:
            self._beaten(drive, self.source, payload)

        self._broker.publish(Message(f"{ROOT}/{drive}/heartbeat", payload, tag=arrived))

    def _on_result(self, message: Message) -> None:
        table = json.loads(message.payload)
        for order in reversed(self.orders):
            if order.id == table.get("id"):
                order.answered(table["status"], table.get("reason") or "")
                return


class TcpController(Controller):
    """A PLC that writes to the command mirror of unit 255; it connects anew where it is cut off."""

    def __init__(
        self, world: World, setup: Setup, address: str, heard: Heard, beaten: Beaten, network: Network
    ) -> None:
        super().__init__(world, setup, address, heard, beaten)
        self._network = network
        self._cable: Cable | None = None
        self._arrived = b""
        self._transaction = 0
        self._asked: dict[int, Order | None] = {}
        self.is_raw = self.chance.random() < 0.3

    def die(self) -> None:
        """Say nothing any more; the connection stays, as it does where the power fails."""
        super().die()
        self._cable = None

    def _send(self, order: Order, **more: Any) -> None:
        if self.is_raw and order.verb in RAW:
            self._send_raw(order)
            return
        base = MIRROR_AT + PER_DRIVE * self._setup.names.index(order.drive)
        self._beats += 1
        hertz = 0 if order.value is None else int(order.value * HUNDREDTHS)
        if order.verb is Verb.FREQUENCY:
            pdu = struct.pack(">BHH", WRITE_ONE, base + Place.FREQUENCY, hertz)
        elif order.value is not None:
            words = (CODES[order.verb, False], self._beats & 0xFFFF, hertz, 0, self._asked_for & 0xFFFF)
            pdu = struct.pack(">BHHB5H", WRITE_MANY, base, 5, 10, *words)
        else:
            pdu = struct.pack(">BHH", WRITE_ONE, base, CODES[order.verb, False])
        beat = self._beats
        if not self._put(pdu, order, lambda: self._order_arrived(order, beat)):
            order.answered("unknown", "not connected")

    def _send_raw(self, order: Order) -> None:
        """Write to the drive's own numbers under its own unit."""
        number = self._setup.numbers[self._setup.names.index(order.drive)]
        hertz = 0 if order.value is None else int(order.value * HUNDREDTHS)
        if order.verb is Verb.RUN:
            pdu = struct.pack(">BHHB2H", WRITE_MANY, COMMAND_AT, 2, 4, RAW[Verb.RUN], hertz)
        elif order.verb is Verb.FREQUENCY:
            pdu = struct.pack(">BHH", WRITE_ONE, FREQUENCY_AT, hertz)
        else:
            pdu = struct.pack(">BHH", WRITE_ONE, COMMAND_AT, RAW[order.verb])
        if not self._put(pdu, order, lambda: self.arrived(order), unit=number):
            order.answered("unknown", "not connected")

    def _send_stop_of_line(self, orders: Sequence[Order]) -> None:
        def arrived() -> None:
            for order in orders:
                self.arrived(order)

        pdu = struct.pack(">BHH", WRITE_ONE, LINES_AT, CODES[Verb.EMERGENCY_STOP, False])
        self._put(pdu, None, arrived)

    def _order_arrived(self, order: Order, beat: int) -> None:
        if order.verb is not Verb.FREQUENCY and order.value is not None:
            self._beaten(order.drive, self.source, str(beat & 0xFFFF).encode())
        self.arrived(order)

    def _beat(self, drive: str, beat: int) -> None:
        base = MIRROR_AT + PER_DRIVE * self._setup.names.index(drive)
        pdu = struct.pack(">BHH", WRITE_ONE, base + Place.HEARTBEAT, beat & 0xFFFF)
        self._put(pdu, None, lambda: self._beaten(drive, self.source, str(beat & 0xFFFF).encode()))

    def _put(self, pdu: bytes, order: Order | None, delivered: Callable[[], None], unit: int = MIRROR_UNIT) -> bool:
        """Send a request; False where there is no connection."""
        if self._cable is None or not self._cable.is_open:
            self._arrived = b""
            self._asked.clear()
            self._cable = self._network.dial(self.source, TCP_PORT, self._take)
        if self._cable is None:
            return False
        self._transaction = (self._transaction + 1) % 0x10000
        self._asked[self._transaction] = order
        self._cable.send(MBAP.pack(self._transaction, 0, len(pdu) + 1, unit) + pdu, delivered)
        return True

    def _take(self, data: bytes) -> None:
        """Take answers; b"" says that the connection is gone."""
        if not data:
            asked, self._asked, self._arrived = self._asked, {}, b""
            for order in asked.values():
                if order is not None:
                    order.answered("unknown", "cut off")
            return
        self._arrived += data
        while len(self._arrived) >= MBAP.size:
            transaction, _, length, _ = MBAP.unpack_from(self._arrived)
            if len(self._arrived) < 6 + length:
                return
            pdu, self._arrived = self._arrived[MBAP.size : 6 + length], self._arrived[6 + length :]
            self._answered(self._asked.pop(transaction, None), pdu)

    def _answered(self, order: Order | None, pdu: bytes) -> None:
        if order is None or not pdu:
            return
        if not pdu[0] & 0x80:
            order.answered("done", "")
        elif pdu[1] == ACKNOWLEDGE:
            order.answered("unknown", "acknowledged")
        else:
            order.answered("refused", REFUSED.get(pdu[1], str(pdu[1])))
