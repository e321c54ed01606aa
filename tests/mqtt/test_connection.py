"""One connection, byte by byte: what is written when, what is read how, and what keeps it alive."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Iterator
from typing import Any

import paho.mqtt.client
import pytest

from gateway.config import MqttSection
from gateway.metrics import MqttStats
from gateway.mqtt import access, client, packets, socket_loop
from gateway.mqtt.connection import Connection
from gateway.mqtt.in_flight import FIRST_ID, IN_FLIGHT
from gateway.mqtt.made import Made
from gateway.mqtt.message import Message
from gateway.mqtt.reception import Ears
from gateway.mqtt.socket_loop import READ_AT_ONCE
from tests.mqtt.played import packet
from tests.mqtt.rig import GATEWAY, Log, section

CONNACK = {"5": b"\x20\x03\x00\x00\x00", "3.1.1": b"\x20\x02\x00\x00"}
PINGREQ, PINGRESP = b"\xc0\x00", b"\xd0\x00"
EVERYTHING = 1 << 20  # bytes


class Narrow:
    """A socket of a pair that takes at most so many bytes at a time, None: all, and 0: none, it blocks."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self.takes: int | None = None
        self.error: OSError | None = None
        self.reads = 0

    def recv(self, size: int) -> bytes:
        """Return what has come."""
        self.reads += 1
        return self._sock.recv(size)

    def send(self, data: bytes) -> int:
        """Send what it takes."""
        if self.error is not None:
            raise self.error
        if self.takes == 0:
            raise BlockingIOError
        taken = data if self.takes is None else data[: self.takes]
        self.takes = None if self.takes is None else 0
        return self._sock.send(taken)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sock, name)


class Wire:
    """A connection that has been accepted, and the broker's end of it."""

    def __init__(self, version: str = "5", qos: int = 1, connack: bytes = b"", **settings: object) -> None:
        self.section: MqttSection = section(version=version, qos=qos, **settings)
        introduced = client.introduction(self.section, GATEWAY)
        made, errors = client._make_client(self.section, introduced, access.read(self.section))
        self.client: Any = made
        ours, self._broker = socket.socketpair()
        ours.setblocking(False)
        self._broker.setblocking(False)
        self.sock = Narrow(ours)
        vars(made).update(_sock=self.sock, _keepalive=60)
        is_5 = version == "5"
        nothing: Callable[[object], Any] = client._nothing
        self.stats = MqttStats()
        expiry, correlation = (client._Expiry, client._correlated) if is_5 else (nothing, nothing)
        kept = Made(made, errors, expiry, correlation, client._reason_name, is_5)
        self.connection = Connection(kept, self.section, self.stats)
        self.outgoing = self.connection.outgoing
        self.hear(connack or CONNACK[version])

    def hear(self, raw: bytes) -> None:
        """Let the connection read what the broker sends."""
        self._broker.sendall(raw)
        self.connection._socket._readable()

    def hang_up(self) -> None:
        """End the connection without a word."""
        self._broker.close()
        self.connection._socket._readable()

    def send(self, *texts: str, topic: str = "t") -> None:
        """Send messages, and flush."""
        for text in texts:
            self.outgoing.send(topic, text, retain=False, expiry=0)
        self.connection.flush()

    @property
    def written(self) -> bytes:
        """Return what the broker has got since this was asked last."""
        try:
            return self._broker.recv(EVERYTHING)
        except BlockingIOError:
            return b""

    def packet(self, text: str, number: int | None = None, topic: str = "t") -> bytes:
        """Return the packet of a message: at QoS 1 with the identifier of the number, from 0."""
        named, properties = packets.topic_bytes(topic), b"\x00" if self.section.version == "5" else b""
        if number is None:
            return packets.publish(named, text.encode(), properties, retain=False)
        before, behind = packets.publish_at_1(named, text.encode(), properties, retain=False)
        return before + (FIRST_ID + number).to_bytes(2, "big") + behind

    def end(self) -> None:
        """Let go of both ends."""
        self.connection.abort()
        self._broker.close()


@pytest.fixture
def wires() -> Iterator[Callable[..., Wire]]:
    """Return what makes connections, which are ended."""
    made: list[Wire] = []

    def make(*arguments: Any, **more: Any) -> Wire:
        made.append(Wire(*arguments, **more))
        return made[-1]

    yield make
    for wire in made:
        wire.end()


def puback(number: int, code: int | None = None) -> bytes:
    """Acknowledge a message, with a reason code where there is one."""
    return packet(packets.PUBACK, (FIRST_ID + number).to_bytes(2, "big") + (b"" if code is None else bytes([code])))


# ---- QoS 1


@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_messages_of_qos_1_are_followed_until_they_are_acknowledged(
    wires: Callable[..., Wire], version: str
) -> None:
    """They take room until then, and are counted; those that find no place in flight follow in order."""
    wire = wires(version)
    texts = [str(number) for number in range(IN_FLIGHT + 5)]
    wire.send(*texts)
    expected = [wire.packet(text, number) for number, text in enumerate(texts)]
    assert wire.written == b"".join(expected[:IN_FLIGHT])
    assert (wire.outgoing.waiting, wire.outgoing.there, wire.outgoing.handed) == (25, 0, 25)
    wire.hear(puback(0) + puback(1))
    assert wire.written == b"".join(expected[IN_FLIGHT : IN_FLIGHT + 2])
    assert (wire.outgoing.waiting, wire.outgoing.there, wire.stats.waiting) == (23, 2, 23)
    wire.hear(b"".join(puback(number) for number in range(2, IN_FLIGHT + 5)))
    assert wire.outgoing.waiting == 3, "nobody can acknowledge what was not sent"
    assert wire.written == b"".join(expected[IN_FLIGHT + 2 :])
    wire.hear(b"".join(puback(number) for number in range(IN_FLIGHT + 2, IN_FLIGHT + 5)))
    assert wire.outgoing.is_empty
    assert wire.outgoing.room == wire.outgoing.capacity


@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_acknowledgements_are_taken_wherever_the_stream_is_cut(
    wires: Callable[..., Wire], version: str
) -> None:
    """At every byte, between messages, answers to pings and acknowledgements that are for paho."""
    properties = b"\x00" if version == "5" else b""
    reason = b"\x00" if version == "5" else b""
    stop = packet(0x32, b"\x00\x04stop\x00\x07" + properties + b"now")
    for_paho = packet(packets.PUBACK, b"\x00\x01")
    late = packet(packets.PUBACK, (FIRST_ID + 2).to_bytes(2, "big") + reason)
    raw = puback(0) + stop + puback(1) + PINGRESP + for_paho + late
    for cut in range(1, len(raw)):
        wire, heard = wires(version), list[Message]()
        wire.connection.listen(client.subscriptions(["stop"], version), Ears(heard.append, lambda: None))
        wire.send("one", "two", "three")
        wire.client._ping_t = 1.0
        wire.hear(raw[:cut])
        wire.hear(raw[cut:])
        assert wire.outgoing.there == 3, cut
        assert [(each.topic, each.payload) for each in heard] == [("stop", b"now")], cut
        assert wire.client._ping_t == 0, cut
        assert wire.connection.lost is None, cut
        assert wire.written.endswith(b"\x40\x02\x00\x07"), "paho has acknowledged what came"
        wire.end()


async def test_a_refusal_is_told_once_and_counts_as_an_answer(wires: Callable[..., Wire]) -> None:
    """MQTT 5: more will follow. A message without subscribers is no refusal."""
    wire = wires()
    wire.send("one", "two", "three", "four")
    with Log() as log:
        wire.hear(puback(0, 0x10))
        assert log.lines(logging.WARNING) == []
        wire.hear(puback(1, 0x87) + puback(2, 0x87) + puback(3, 0xFF))
        (line,) = log.lines(logging.WARNING)
    assert line.startswith("the broker refuses messages: Not authorized (reason code 87H)")
    assert wire.outgoing.is_empty


@pytest.mark.parametrize("code", [0xF0, 0x92])
async def test_an_unknown_reason_code_is_told_as_it_is(wires: Callable[..., Wire], code: int) -> None:
    """A broker may be newer than this, or give one that other packets have."""
    wire = wires()
    wire.send("one")
    with Log() as log:
        wire.hear(puback(0, code))
        assert f"(reason code {code:02X}H)" in log.lines(logging.WARNING)[0]


async def test_a_refusal_at_qos_2_is_told_and_makes_room_for_the_next(wires: Callable[..., Wire]) -> None:
    """MQTT 5 4.3.3: nothing more is said of that message, and its identifier is free."""
    wire = wires(qos=2, connack=b"\x20\x06\x00\x00\x03\x21\x00\x01")  # receive maximum 1
    wire.send("one", "two")
    assert b"one" in wire.written
    with Log() as log:
        wire.hear(packet(0x50, b"\x00\x01\x87"))
        assert "Not authorized (reason code 87H)" in log.lines(logging.WARNING)[0]
    assert b"two" in wire.written
    wire.hear(packet(0x50, b"\x00\x02\x10"))
    assert wire.written == packet(0x62, b"\x00\x02")
    wire.hear(packet(0x70, b"\x00\x02\x92"))
    assert wire.outgoing.is_empty
    assert wire.connection.lost is None
    await wire.connection.wait(0)


async def test_what_the_broker_must_have_is_acknowledged_beside_values_at_qos_0(wires: Callable[..., Wire]) -> None:
    """An event: it is known to be there when it is acknowledged, the values when they are written."""
    wire = wires(qos=0, connack=b"\x20\x06\x00\x00\x03\x21\x00\x01")  # receive maximum 1
    wire.send("50.12")
    assert wire.outgoing.say("event", "trip", expiry=0, is_event=True)
    first = wire.outgoing.last_event
    assert wire.outgoing.say("event", "reset", expiry=0, is_event=True)
    second = wire.outgoing.last_event
    wire.send("50.13")
    trip, reset = (wire.packet(text, number, "event") for number, text in enumerate(("trip", "reset")))
    assert wire.written == wire.packet("50.12") + trip + wire.packet("50.13")
    assert (first(), second(), wire.outgoing.waiting) == (False, False, 1)
    wire.hear(puback(0))
    assert wire.written == reset
    assert (first(), second(), wire.outgoing.is_empty) == (True, False, False)
    wire.hear(puback(1))
    assert (second(), wire.outgoing.is_empty) == (True, True)


async def test_a_broker_that_takes_qos_0_alone_is_sent_nothing_else(wires: Callable[..., Wire]) -> None:
    """MQTT 5 3.2.2.3.4: else it would disconnect at each event, which is there when it is written."""
    wire = wires(qos=0, connack=b"\x20\x05\x00\x00\x02\x24\x00")  # maximum QoS 0
    assert wire.outgoing.say("event", "trip", expiry=0, is_event=True)
    event = wire.outgoing.last_event
    assert wire.outgoing.post("history", "old") is not None
    assert not event()
    wire.connection.flush()
    assert wire.written == wire.packet("trip", topic="event") + wire.packet("old", topic="history")
    assert event()


async def test_identifiers_of_paho_are_none_of_messages_written_here(wires: Callable[..., Wire]) -> None:
    """For as long as a connection lasts."""
    wire = wires()
    wire.client._last_mid = FIRST_ID - 2
    assert [wire.client._mid_generate() for _ in range(3)] == [FIRST_ID - 1, 1, 2]


async def test_as_many_of_qos_2_go_as_the_broker_takes(wires: Callable[..., Wire]) -> None:
    """They are all paho's, which is told of the receive maximum when it is known."""
    wire = wires(qos=2, connack=b"\x20\x06\x00\x00\x03\x21\x00\x02")
    wire.send("one", "two", "three")
    assert wire.written.count(b"t") == 2 + 1, "two topics, and the t of two"
    assert wire.outgoing.waiting == 3


@pytest.mark.parametrize("qos", [0, 1, 2])
async def test_what_is_sent_behind_the_end_of_a_connection_is_not_there(wires: Callable[..., Wire], qos: int) -> None:
    """A drive may answer in the turn of the loop in which the broker hangs up: no error of ours, and no receipt."""
    wire = wires(qos=qos)
    wire.hang_up()
    wire.send("one")
    assert wire.outgoing.handed == wire.outgoing.waiting == 1
    assert wire.outgoing.there == 0


async def test_what_was_missed_is_not_there_before_a_broker_of_qos_0_alone_has_read_it(
    wires: Callable[..., Wire],
) -> None:
    """Else it would be let go of while the kernel has it, and be lost with the connection."""
    wire = wires(qos=0, connack=b"\x20\x05\x00\x00\x02\x24\x00")  # maximum QoS 0
    is_there = wire.outgoing.post("history", "50.00")
    assert is_there is not None
    assert wire.outgoing.say("event", "trip", expiry=0, is_event=True, is_remembered=True)
    event_is_there = wire.outgoing.last_event
    wire.connection.flush()
    assert b"50.00" in wire.written
    assert (is_there(), event_is_there()) == (False, False)
    wire.connection.receipts.ask(0.0)
    wire.connection.flush()
    assert wire.written == PINGREQ
    wire.hear(PINGRESP)
    assert (is_there(), event_is_there()) == (True, True)


async def test_an_event_that_is_not_acknowledged_counts_as_untold_at_qos_0(wires: Callable[..., Wire]) -> None:
    """Values and results are done with when they are written; an event is not, and may not even be written."""
    wire = wires(qos=0, connack=b"\x20\x06\x00\x00\x03\x21\x00\x01")  # receive maximum 1
    for text in ("first", "second"):
        assert wire.outgoing.say("event", text, expiry=0, is_event=True)
    assert wire.outgoing.say("result", "done", expiry=0)
    wire.connection.flush()
    assert wire.written.endswith(b"done")
    wire.hear(puback(0))
    wire.connection.abort()
    assert wire.stats.untold == 1


async def test_a_broker_that_wants_no_keep_alive_is_asked_all_the_same(
    wires: Callable[..., Wire], monkeypatch: pytest.MonkeyPatch
) -> None:
    """MQTT 5 3.2.2.3.14: 0 is none. A broker that stands still is noticed; a question is no reason to part."""
    now = 1000.0
    monkeypatch.setattr(paho.mqtt.client, "time_func", lambda: now)
    wire = wires(qos=0, connack=b"\x20\x06\x00\x00\x03\x13\x00\x00")
    wire.send("one")
    wire.connection.receipts.ask(now)
    wire.connection.tend()
    assert wire.connection.lost is None
    now += 61.0
    wire.connection.tend()
    assert wire.connection.lost is not None


async def test_an_answer_is_not_larger_than_the_broker_takes_with_what_identifies_it(
    wires: Callable[..., Wire],
) -> None:
    """Who asks chooses that, and the topic: the broker would end the connection."""
    wire = wires(connack=b"\x20\x08\x00\x00\x05\x27\x00\x00\x00\xc8")  # at most 200 bytes
    assert wire.outgoing.reply("t", "x" * 100, bytes(60))
    assert not wire.outgoing.reply("t", "x" * 100, bytes(80))
    assert not wire.outgoing.reply("\N{DEGREE SIGN}" * 40, "x" * 100, b"")
    wire.connection.flush()
    assert len(wire.written) <= 200


# ---- writing


@pytest.mark.parametrize("qos", [0, 1])
async def test_what_the_socket_does_not_take_goes_ahead_of_all_that_comes_later(
    wires: Callable[..., Wire], qos: int
) -> None:
    """Wherever it stops: behind the rest come a question of paho's, other messages, and the end."""
    numbers = (0, 1, 2) if qos else (None, None, None)
    for takes in range(22):
        wire = wires(qos=qos)
        one, two, three = (wire.packet(text, number) for text, number in zip("123", numbers, strict=True))
        wire.sock.takes = takes
        wire.send("1", "2")
        assert wire.outgoing.waiting == (2 if qos or takes < len(one + two) else 0)
        wire.client._send_pingreq()
        wire.send("3")
        wire.client.disconnect()
        found = wire.written
        assert found == (one + two)[:takes]
        wire.sock.takes = None
        wire.connection.flush()
        found += wire.written
        assert found == one + two + PINGREQ + three + b"\xe0\x00", takes
        assert wire.outgoing.is_empty is not bool(qos)
        wire.end()


@pytest.mark.parametrize("qos", [0, 1])
async def test_what_waits_is_not_overtaken_when_the_socket_takes_more(wires: Callable[..., Wire], qos: int) -> None:
    """Neither a rest nor what paho has queued, by what is sent before they are written."""
    wire = wires(qos=qos)
    one, two, three = (wire.packet(str(number), number if qos else None) for number in range(3))
    wire.sock.takes = 3
    wire.send("0")
    wire.sock.takes = None
    wire.send("1")
    wire.client._send_pingreq()
    wire.send("2")
    assert wire.written == one + two + PINGREQ + three


async def test_a_socket_that_is_full_is_watched_until_it_takes_more(wires: Callable[..., Wire]) -> None:
    """And no longer."""
    wire = wires(qos=0)
    wire.sock.takes = 3
    wire.send("50.12")
    assert wire.connection._socket._is_writing
    wire.sock.takes = None
    while wire.connection._socket._is_writing:
        await asyncio.sleep(0)
    assert wire.written == wire.packet("50.12")
    assert wire.outgoing.is_empty


async def test_one_reading_goes_at_once_and_several_go_together(
    wires: Callable[..., Wire], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What comes shortly behind the first goes a little later, and what is told of a command at once, with it."""
    monkeypatch.setattr(socket_loop, "TOGETHER", 3600.0)
    wire, loop = wires(qos=0), asyncio.get_running_loop()
    later: list[Callable[[], None]] = []
    monkeypatch.setattr(loop, "call_later", lambda _seconds, call: later.append(call))

    def read(text: str) -> None:
        wire.outgoing.send("t", text, retain=False, expiry=0)
        wire.connection.flush_soon()

    for text in ("1", "2", "3"):
        read(text)
    assert wire.written == wire.packet("1")
    (collected,) = later
    collected()
    assert wire.written == wire.packet("2") + wire.packet("3")
    read("4")
    wire.outgoing.say("t", "done", expiry=0)
    assert wire.written == b""
    await asyncio.sleep(0)
    assert wire.written == wire.packet("4") + wire.packet("done")


# ---- reading


@pytest.mark.hazard("H24")
async def test_a_flood_is_read_in_short_turns(wires: Callable[..., Wire]) -> None:
    """No more comes from the socket meanwhile, nothing is lost, and acknowledgements in between count."""
    wire, heard = wires(), list[bytes]()
    wire.connection.listen(client.subscriptions(["t"], "5"), Ears(lambda it: heard.append(it.payload), lambda: None))
    texts = [b"%02d" % number for number in range(3 * READ_AT_ONCE)]
    wire.send("1")
    reads = wire.sock.reads
    wire.hear(b"".join(packet(0x30, b"\x00\x01t\x00" + text) for text in texts) + puback(0))
    for turn in range(1, 4):
        assert heard == texts[: turn * READ_AT_ONCE]
        assert wire.outgoing.there == 0
        wire.connection._socket._readable()
        assert len(heard) == turn * READ_AT_ONCE, "the event loop is told to go on reading"
        assert wire.sock.reads == reads + 1
        await asyncio.sleep(0)
    assert heard == texts
    assert wire.outgoing.there == 1


# ---- its life


async def test_what_goes_and_comes_keeps_the_connection_alive(
    wires: Callable[..., Wire], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pings go when nothing else does, or nothing comes: as often as they would by paho alone."""
    now = 1000.0
    monkeypatch.setattr(paho.mqtt.client, "time_func", lambda: now)
    wire = wires()
    for number in range(10):
        now += 50.0
        wire.send("one")
        wire.hear(puback(number))
        wire.connection.tend()
        assert PINGREQ not in wire.written
    now += 61.0
    wire.connection.tend()
    assert wire.written == PINGREQ
    now += 30.0
    wire.connection.tend()
    assert wire.written == b"", "one question at a time"
    now += 31.0
    wire.connection.tend()
    assert wire.connection.lost == "the broker has not answered within the keep-alive"


async def test_a_broker_that_takes_and_never_answers_is_given_up(
    wires: Callable[..., Wire], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However much is written to it."""
    now = 1000.0
    monkeypatch.setattr(paho.mqtt.client, "time_func", lambda: now)
    wire = wires()
    for _ in range(14):
        now += 10.0
        wire.send("one")
        wire.connection.tend()
    assert wire.connection.lost == "the broker has not answered within the keep-alive"


@pytest.mark.parametrize("qos", [0, 1, 2])
async def test_a_socket_that_fails_while_writing_loses_the_connection(wires: Callable[..., Wire], qos: int) -> None:
    """With its reason; what was not written is not believed to be there."""
    wire = wires(qos=qos)
    wire.sock.error = ConnectionResetError(104, "Connection reset by peer")
    wire.send("one")
    assert wire.connection.lost == "[Errno 104] Connection reset by peer"
    wire.send("two")
    assert wire.outgoing.there == 0
    assert wire.outgoing.waiting == 2


async def test_a_broker_that_hangs_up_is_noticed_behind_what_it_said(wires: Callable[..., Wire]) -> None:
    """What it had acknowledged is there."""
    wire = wires()
    wire.send("one", "two")
    assert wire.written
    wire._broker.sendall(puback(0))
    wire.hang_up()
    assert wire.outgoing.there == 1
    wire.connection._socket._readable()
    assert wire.connection.lost is not None
    assert wire.connection.lost.startswith("closed by the broker")
    wire.connection._socket._readable()


async def test_the_reason_of_a_disconnect_is_told_behind_acknowledgements(wires: Callable[..., Wire]) -> None:
    """MQTT 5: another client has taken the session over; nothing is read behind that."""
    wire = wires()
    wire.send("one", "two")
    wire.hear(puback(0) + b"\xe0\x01\x8e" + puback(1))
    assert wire.connection.lost is not None
    assert "8EH" in wire.connection.lost
    assert wire.outgoing.there == 1


@pytest.mark.parametrize("raw", [b"\x40\x01\xfd", b"\x40\xff\xff\xff\xff\xff", b"\x00\x00"])
async def test_what_is_no_mqtt_ends_the_connection(wires: Callable[..., Wire], raw: bytes) -> None:
    """As paho judges it."""
    wire = wires()
    wire.hear(raw)
    assert wire.connection.lost is not None
