"""MQTT packets to bytes and back."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from enum import IntEnum

from tests.simulation.packet_parts import NONE, Malformed, Reader, pack, text, unpack, varint
from tests.simulation.packets import (
    V5,
    V311,
    Connack,
    Connect,
    Disconnect,
    Filter,
    Packet,
    Pingreq,
    Pingresp,
    Puback,
    Publish,
    Suback,
    Subscribe,
    Unsuback,
    Unsubscribe,
)


class Kind(IntEnum):
    """Types of control packets (5.0, 2.1.2)."""

    CONNECT = 1
    CONNACK = 2
    PUBLISH = 3
    PUBACK = 4
    SUBSCRIBE = 8
    SUBACK = 9
    UNSUBSCRIBE = 10
    UNSUBACK = 11
    PINGREQ = 12
    PINGRESP = 13
    DISCONNECT = 14


FLAGS = {Kind.SUBSCRIBE: 2, Kind.UNSUBSCRIBE: 2}  # the low half of the first byte where it is not 0


def encode(packet: Packet, version: int) -> bytes:
    """Return the bytes of a packet."""
    match packet:
        case Publish():
            flags = packet.is_duplicate << 3 | packet.qos << 1 | packet.is_retained
            number = struct.pack(">H", packet.packet_id) if packet.qos else b""
            body = text(packet.topic) + number + pack(packet.properties, version) + packet.payload
            return bytes([Kind.PUBLISH << 4 | flags]) + varint(len(body)) + body
        case Connect():
            kind, body = Kind.CONNECT, _connect(packet)
        case Connack():
            kind = Kind.CONNACK
            body = bytes([packet.is_session_present, packet.code]) + pack(packet.properties, version)
        case Puback():
            kind, body = Kind.PUBACK, struct.pack(">H", packet.packet_id)
            body += bytes([packet.code]) if packet.code else b""
        case Subscribe():
            kind = Kind.SUBSCRIBE
            wishes = (text(f.topic) + bytes([_options(f)]) for f in packet.filters)
            body = struct.pack(">H", packet.packet_id) + pack(NONE, version) + b"".join(wishes)
        case Suback():
            kind = Kind.SUBACK
            body = struct.pack(">H", packet.packet_id) + pack(NONE, version) + bytes(packet.codes)
        case Unsubscribe():
            kind = Kind.UNSUBSCRIBE
            body = struct.pack(">H", packet.packet_id) + pack(NONE, version) + b"".join(map(text, packet.topics))
        case Unsuback():
            kind, body = Kind.UNSUBACK, struct.pack(">H", packet.packet_id)
            body += pack(NONE, version) + bytes(packet.codes) if version == V5 else b""
        case Pingreq():
            kind, body = Kind.PINGREQ, b""
        case Pingresp():
            kind, body = Kind.PINGRESP, b""
        case Disconnect():
            kind = Kind.DISCONNECT
            body = bytes([packet.code]) + pack(packet.properties, version) if version == V5 else b""
    return bytes([kind << 4 | FLAGS.get(kind, 0)]) + varint(len(body)) + body


def _connect(packet: Connect) -> bytes:
    will, version = packet.will, packet.version
    flags = packet.is_clean << 1 | (packet.user is not None) << 7 | (packet.password is not None) << 6
    if will is not None:
        flags |= 1 << 2 | will.qos << 3 | will.is_retained << 5
    body = text("MQTT") + bytes([version, flags]) + struct.pack(">H", packet.keep_alive)
    body += pack(packet.properties, version) + text(packet.client_id)
    if will is not None:
        body += pack(will.properties, version) + text(will.topic) + text(will.payload)
    body += b"" if packet.user is None else text(packet.user)
    return body + (b"" if packet.password is None else text(packet.password))


def _options(wish: Filter) -> int:
    return wish.qos | wish.is_no_local << 2 | wish.keeps_retain << 3 | wish.retain_handling << 4


class Decoder:
    """Eats bytes and yields packets; Malformed is final. The version is 3.1.1 until a CONNECT says otherwise."""

    def __init__(self, version: int = V311) -> None:
        self.version = version
        self._data = b""

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Take bytes, and yield every packet that is whole by now."""
        self._data += data
        while (found := self._next()) is not None:
            yield self._packet(*found)

    def _next(self) -> tuple[int, bytes] | None:
        """Return first byte and body of the next packet; None while bytes are missing."""
        size = 0
        for place in range(4):
            if len(self._data) < place + 2:
                return None
            byte = self._data[place + 1]
            size |= (byte & 0x7F) << 7 * place
            if byte < 0x80:
                begin = place + 2
                break
        else:
            raise Malformed("a packet's length is longer than four bytes")
        if len(self._data) < begin + size:
            return None
        first, body = self._data[0], self._data[begin : begin + size]
        self._data = self._data[begin + size :]
        return first, body

    def _packet(self, first: int, body: bytes) -> Packet:
        try:
            kind = Kind(first >> 4)
        except ValueError:
            raise Malformed(f"no packet type {first >> 4}") from None
        if kind is not Kind.PUBLISH and first & 0x0F != FLAGS.get(kind, 0):
            raise Malformed(f"flags {first & 0x0F:X} of {kind.name}")
        return self._body(kind, first & 0x0F, Reader(body))

    def _body(self, kind: Kind, flags: int, reader: Reader) -> Packet:
        match kind:
            case Kind.PUBLISH:
                return self._publish(flags, reader)
            case Kind.CONNECT:
                return self._connect(reader)
            case Kind.CONNACK:
                return Connack(bool(reader.byte() & 1), reader.byte(), unpack(reader, self.version))
            case Kind.PUBACK:
                return Puback(reader.short(), 0 if reader.is_at_end else reader.byte())
            case Kind.SUBSCRIBE:
                return self._subscribe(reader)
            case Kind.SUBACK:
                number, _ = reader.short(), unpack(reader, self.version)
                return Suback(number, tuple(reader.rest()))
            case Kind.UNSUBSCRIBE:
                return self._unsubscribe(reader)
            case Kind.UNSUBACK:
                number, _ = reader.short(), unpack(reader, self.version)
                return Unsuback(number, tuple(reader.rest()))
            case Kind.PINGREQ:
                return Pingreq()
            case Kind.PINGRESP:
                return Pingresp()
        code = 0 if reader.is_at_end else reader.byte()
        return Disconnect(code, unpack(reader, self.version))

    def _publish(self, flags: int, reader: Reader) -> Publish:
        qos = flags >> 1 & 3
        if qos > 1:
            raise Malformed(f"QoS {qos}")
        topic = reader.text()
        number = reader.short() if qos else 0
        properties = unpack(reader, self.version)
        return Publish(topic, reader.rest(), qos, bool(flags & 1), bool(flags & 8), number, properties)

    def _connect(self, reader: Reader) -> Connect:
        if reader.text() != "MQTT":
            raise Malformed("no CONNECT of MQTT")
        version, flags, keep_alive = reader.byte(), reader.byte(), reader.short()
        if version not in (V311, V5):
            raise Malformed(f"protocol level {version}")
        self.version = version
        properties, client_id = unpack(reader, version), reader.text()
        will = None
        if flags & 1 << 2:
            of_will = unpack(reader, version)
            will = Publish(reader.text(), reader.binary(), flags >> 3 & 3, bool(flags & 1 << 5), properties=of_will)
        user = reader.text() if flags & 1 << 7 else None
        password = reader.binary() if flags & 1 << 6 else None
        return Connect(client_id, version, bool(flags & 2), keep_alive, will, user, password, properties)

    def _subscribe(self, reader: Reader) -> Subscribe:
        number, _ = reader.short(), unpack(reader, self.version)
        filters = []
        while not reader.is_at_end:
            topic, options = reader.text(), reader.byte()
            wish = Filter(topic, options & 3, bool(options & 4), bool(options & 8), options >> 4 & 3)
            filters.append(wish)
        if not filters:
            raise Malformed("SUBSCRIBE without a filter")
        return Subscribe(number, tuple(filters))

    def _unsubscribe(self, reader: Reader) -> Unsubscribe:
        number, _ = reader.short(), unpack(reader, self.version)
        topics = []
        while not reader.is_at_end:
            topics.append(reader.text())
        return Unsubscribe(number, tuple(topics))
