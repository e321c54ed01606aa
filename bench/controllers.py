"""Ways in which a controller commands a drive, one request at a time, with the times of request and result."""

from __future__ import annotations

import contextlib
import itertools
import json
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from bench.whole_gateway import ROOT, Ports, drive_name
from gateway.modbus_tcp.mirror_map import MIRROR_AT, ORDERS, PER_DRIVE, Place

ANSWER_WITHIN = 10.0  # seconds
DONE = "done"
COMMAND, FREQUENCY = 0xFA00, 0xFA01
STOPPED = 0x8000  # FA00: command by communication, no run bit (E6581657 7.1)
GATEWAY_UNIT = 255
WRITE_SINGLE = 6
REQUEST = struct.Struct(">HHHBBHH")  # MBAP header, function, register, word; the answer is the same
EXCEPTION_SIZE = 9  # bytes
HEARD = ("command", "result")  # levels of the topics of a drive
IDS = itertools.count(1)  # an id that another controller has used would be taken for a repetition
CODES = {order.word: code for code, order in ORDERS.items()}


@dataclass(frozen=True, slots=True)
class Asked:
    """One command, in monotonic seconds, and what its result was.

    When it was sent; when whoever listens beside the gateway had it, by MQTT; when its result was there.
    """

    sent: float
    known: float
    told: float
    result: str

    @property
    def is_done(self) -> bool:
        """Say whether it was done, and read back."""
        return self.result == DONE


class Controller(Protocol):
    """Whoever commands drives, by their numbers."""

    def set_frequency(self, number: int, hundredths: int) -> Asked:
        """Give a drive its frequency, in hundredths of a hertz."""
        ...

    def stop(self, number: int) -> Asked:
        """Stop a drive."""
        ...


class MqttController:
    """Publishes commands with an id (QoS 1), and waits for the result of that id; it hears its own commands, too."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._heard: dict[str, tuple[float, dict[str, Any]]] = {}
        client.on_message = self._on_message

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        self._heard[message.topic.rpartition("/")[2]] = time.monotonic(), json.loads(message.payload)

    def set_frequency(self, number: int, hundredths: int) -> Asked:
        """Publish the frequency."""
        return self._ask(number, {"command": "frequency", "value": hundredths / 100})

    def stop(self, number: int) -> Asked:
        """Publish a stop."""
        return self.order(number, "stop")

    def order(self, number: int, command: str) -> Asked:
        """Publish a command that is one word."""
        return self._ask(number, {"command": command})

    def _ask(self, number: int, document: dict[str, Any]) -> Asked:
        name = f"bench-{next(IDS)}"
        topic, payload = f"{ROOT}/{drive_name(number)}/command", json.dumps(document | {"id": name})
        sent = time.monotonic()
        self._client.publish(topic, payload, qos=1)
        while (now := time.monotonic()) < sent + ANSWER_WITHIN:
            self._client.loop(sent + ANSWER_WITHIN - now)
            if all(level in self._heard and self._heard[level][1]["id"] == name for level in HEARD):
                (known, _), (told, result) = (self._heard[level] for level in HEARD)
                status = result["status"]
                return Asked(sent, known, told, status if status == DONE else f"{status} ({result['reason']})")
        raise SystemExit(f"no result of {payload} for {topic} within {ANSWER_WITHIN:g} s")


class UnitController:
    """Writes registers of drives by 06H under their own unit ids; the answer comes when they were read back."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._transactions = itertools.cycle(range(1, 0x10000))

    def set_frequency(self, number: int, hundredths: int) -> Asked:
        """Write FA01."""
        return self.write(number, FREQUENCY, hundredths)

    def stop(self, number: int) -> Asked:
        """Write FA00."""
        return self.write(number, COMMAND, STOPPED)

    def write(self, unit: int, register: int, word: int) -> Asked:
        """Write one register of a unit, and wait for the answer."""
        request = REQUEST.pack(next(self._transactions), 0, 6, unit, WRITE_SINGLE, register, word)
        sent = time.monotonic()
        self._connection.sendall(request)
        answer = b""
        while len(answer) < EXCEPTION_SIZE:
            more = self._connection.recv(REQUEST.size)
            if not more:
                raise SystemExit(f"closed by the gateway, after {request.hex(' ')} and {answer.hex(' ')}")
            answer += more
        told = time.monotonic()
        return Asked(sent, sent, told, DONE if answer == request else f"answer {answer.hex(' ')}")


class MirrorController(UnitController):
    """Writes the command mirror of unit 255: registers of its own for each drive, in the order of the file."""

    def set_frequency(self, number: int, hundredths: int) -> Asked:
        """Write the frequency register."""
        return self._write(number, Place.FREQUENCY, hundredths)

    def stop(self, number: int) -> Asked:
        """Write a stop to the command register."""
        return self._write(number, Place.COMMAND, CODES["stop"])

    def _write(self, number: int, place: Place, word: int) -> Asked:
        return self.write(GATEWAY_UNIT, MIRROR_AT + PER_DRIVE * (number - 1) + place, word)


@contextlib.contextmanager
def by_mqtt(ports: Ports) -> Iterator[MqttController]:
    """Connect a controller to the broker while the block lasts."""
    client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    is_subscribed = False

    def on_subscribe(*_: Any) -> None:
        nonlocal is_subscribed
        is_subscribed = True

    client.on_subscribe = on_subscribe
    client.connect("127.0.0.1", ports.broker)
    client.subscribe([(f"{ROOT}/+/{level}", 0) for level in HEARD])
    end = time.monotonic() + ANSWER_WITHIN
    while not is_subscribed:
        if time.monotonic() > end:
            raise SystemExit("the broker lets nobody subscribe")
        client.loop(1.0)
    yield MqttController(client)
    client.disconnect()


@contextlib.contextmanager
def _connected(ports: Ports) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", ports.tcp), ANSWER_WITHIN) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield connection


@contextlib.contextmanager
def by_unit(ports: Ports) -> Iterator[UnitController]:
    """Connect a controller to the units of the drives while the block lasts."""
    with _connected(ports) as connection:
        yield UnitController(connection)


@contextlib.contextmanager
def by_mirror(ports: Ports) -> Iterator[MirrorController]:
    """Connect a controller to the mirror while the block lasts."""
    with _connected(ports) as connection:
        yield MirrorController(connection)


CONTROLLERS: dict[str, Callable[[Ports], AbstractContextManager[Controller]]] = {
    "MQTT publish": by_mqtt,
    "TCP 06H, drive's unit": by_unit,
    "TCP 06H, mirror (255)": by_mirror,
}
