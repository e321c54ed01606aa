"""Writes PUBLISH packets of QoS 0 and 1, reads PUBACK, and joins packets for one call of the system. Pure.

paho makes objects, a dictionary and a call of the system of each message, and reads its acknowledgement in pieces; at
some thousand values a second that is more than all the rest. What is sent at QoS 2 is still paho's.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

PUBLISH = 0x30  # MQTT 5 3.3.1; as QoS 0 its lower half is RETAIN alone
RETAIN = 0x01
AT_LEAST_ONCE = 0x02  # QoS 1
PUBACK = 0x40
FAILURE = 0x80  # reason codes from here on say that it was not done (MQTT 5 2.4)
LONGEST_HEAD = 6  # bytes before what a packet says; a length that takes them all is none
DISCONNECT = 0xE0
TOGETHER = 64 * 1024  # bytes that are joined: what waits for a slow broker is not copied again and again
LONGEST_TOPIC = 65_535  # bytes (MQTT 5 1.5.4)


def topic_bytes(topic: str) -> bytes:
    """Return a topic as it stands in a packet; ValueError where it is too long."""
    encoded = topic.encode()
    if len(encoded) > LONGEST_TOPIC:
        raise ValueError(f"a topic of {len(encoded)} bytes; at most {LONGEST_TOPIC}")
    return len(encoded).to_bytes(2, "big") + encoded


def publish(topic: bytes, payload: bytes, properties: bytes, *, retain: bool) -> bytes:
    """Return a PUBLISH at QoS 0: `topic` by `topic_bytes`; `properties` are empty where the protocol has none."""
    size = len(topic) + len(properties) + len(payload)
    head = PUBLISH | RETAIN if retain else PUBLISH
    if size < 128:
        return b"%c%c%b%b%b" % (head, size, topic, properties, payload)
    return b"%c%b%b%b%b" % (head, length(size), topic, properties, payload)


def publish_at_1(topic: bytes, payload: bytes, properties: bytes, *, retain: bool) -> tuple[bytes, bytes]:
    """Return a PUBLISH at QoS 1 in two pieces, between which its packet identifier goes; see `publish`."""
    size = len(topic) + 2 + len(properties) + len(payload)
    head = PUBLISH | AT_LEAST_ONCE | RETAIN if retain else PUBLISH | AT_LEAST_ONCE
    if size < 128:
        return b"%c%c%b" % (head, size, topic), properties + payload
    return b"%c%b%b" % (head, length(size), topic), properties + payload


def puback(packet: bytes, *, is_5: bool) -> tuple[int, int] | None:
    """Return packet identifier and reason code of a whole packet that is a PUBACK (MQTT 5 3.4); None: it is none."""
    if packet[0] != PUBACK:
        return None
    start = 2
    while packet[start - 1] & 0x80 and start < LONGEST_HEAD:
        start += 1
    size = len(packet) - start
    if size < 2 or (size > 2 and not is_5):
        return None
    return packet[start] << 8 | packet[start + 1], packet[start + 2] if size > 2 else 0


def length(size: int) -> bytes:
    """Return a variable byte integer (MQTT 5 1.5.5)."""
    written = bytearray()
    while True:
        size, digit = divmod(size, 128)
        written.append(digit | 0x80 if size else digit)
        if not size:
            return bytes(written)


class Batch:
    """Messages that are written together; whoever writes them tells it when they are."""

    __slots__ = ("_is_written", "count", "parts")

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.count = 0
        self._is_written = False

    def add(self, packet: bytes) -> None:
        """Take a packet."""
        self.parts.append(packet)
        self.count += 1

    def add_pieces(self, pieces: Sequence[bytes]) -> int:
        """Take packets in three pieces each; return how many they are."""
        self.parts += pieces
        self.count += len(pieces) // 3
        return len(pieces) // 3

    def is_written(self) -> bool:
        """Say whether the socket has taken all of it."""
        return self._is_written

    def note_written(self) -> None:
        """Take that it has."""
        self._is_written = True

    _set_as_published = note_written  # as paho calls it


class _Several:
    """What paho tells one, told to several."""

    __slots__ = ("_tell",)

    def __init__(self, infos: Sequence[Any]) -> None:
        self._tell: list[Callable[[], None]] = [info._set_as_published for info in infos if info is not None]

    def _set_as_published(self) -> None:
        for tell in self._tell:
            tell()


def join(packets: deque[dict[str, Any]]) -> None:
    """Make few of all packets that paho has queued, but for one that is half written and what ends the connection."""
    if len(packets) < 2:
        return
    together: list[dict[str, Any]] = []
    waiting, size = list(packets), 0
    packets.clear()
    for each in waiting:
        is_apart = each["pos"] or each["command"] & 0xF0 == DISCONNECT
        if is_apart or size + len(each["packet"]) > TOGETHER:
            packets.extend(_joined(together))
            together, size = [], 0
        if is_apart:
            packets.append(each)
        else:
            together.append(each)
            size += len(each["packet"])
    packets.extend(_joined(together))


def _joined(packets: Sequence[dict[str, Any]]) -> Sequence[dict[str, Any]]:
    if len(packets) < 2:
        return packets
    content = b"".join([each["packet"] for each in packets])
    told = [each["info"] for each in packets if each["command"] & 0xF0 == PUBLISH and not each["qos"]]
    joined = {"command": PUBLISH, "mid": 0, "qos": 0, "pos": 0, "packet": content, "info": _Several(told)}
    return [{**joined, "to_process": len(content)}]
