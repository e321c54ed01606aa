"""The parts that MQTT packets are made of: numbers, texts and properties, to bytes and back."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

from tests.simulation.packets import V5, Properties

NONE: Properties = {}


class Malformed(Exception):
    """Bytes that are no MQTT packet."""


def text(value: str | bytes) -> bytes:
    """Return text, or other bytes, behind its length."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack(">H", len(data)) + data


def varint(value: int) -> bytes:
    """Return a number, seven bits a byte, the low ones first."""
    data = bytearray()
    while True:
        value, low = divmod(value, 128)
        data.append(low | (0x80 if value else 0))
        if not value:
            return bytes(data)


class Reader:
    """Takes a packet's body apart; Malformed where it is too short."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def is_at_end(self) -> bool:
        return self._at >= len(self._data)

    def take(self, count: int) -> bytes:
        data = self._data[self._at : self._at + count]
        if len(data) != count:
            raise Malformed("too short")
        self._at += count
        return data

    def rest(self) -> bytes:
        return self.take(len(self._data) - self._at)

    def byte(self) -> int:
        return self.take(1)[0]

    def short(self) -> int:
        return int.from_bytes(self.take(2), "big")

    def long(self) -> int:
        return int.from_bytes(self.take(4), "big")

    def binary(self) -> bytes:
        return self.take(self.short())

    def text(self) -> str:
        try:
            return self.binary().decode()
        except UnicodeDecodeError as error:
            raise Malformed("no UTF-8") from error

    def varint(self) -> int:
        value = 0
        for place in range(4):
            byte = self.byte()
            value |= (byte & 0x7F) << 7 * place
            if byte < 0x80:
                return value
        raise Malformed("a variable byte integer is longer than four bytes")

    def pair(self) -> tuple[str, str]:
        return self.text(), self.text()


Writing = tuple[Callable[[Any], bytes], Callable[[Reader], Any]]
BYTE: Writing = (lambda value: bytes([value]), Reader.byte)
SHORT: Writing = (lambda value: struct.pack(">H", value), Reader.short)
LONG: Writing = (lambda value: struct.pack(">I", value), Reader.long)
TEXT: Writing = (text, Reader.text)
BINARY: Writing = (text, Reader.binary)
PAIR: Writing = (lambda value: text(value[0]) + text(value[1]), Reader.pair)
PROPERTIES: Mapping[int, tuple[str, Writing]] = {  # 5.0, 2.2.2.2
    0x01: ("payload_format", BYTE),
    0x02: ("message_expiry", LONG),
    0x03: ("content_type", TEXT),
    0x08: ("response_topic", TEXT),
    0x09: ("correlation", BINARY),
    0x0B: ("subscription_id", (varint, Reader.varint)),
    0x11: ("session_expiry", LONG),
    0x12: ("assigned_client_id", TEXT),
    0x13: ("server_keep_alive", SHORT),
    0x15: ("authentication_method", TEXT),
    0x16: ("authentication_data", BINARY),
    0x17: ("request_problem_information", BYTE),
    0x18: ("will_delay", LONG),
    0x19: ("request_response_information", BYTE),
    0x1A: ("response_information", TEXT),
    0x1C: ("server_reference", TEXT),
    0x1F: ("reason", TEXT),
    0x21: ("receive_maximum", SHORT),
    0x22: ("topic_alias_maximum", SHORT),
    0x23: ("topic_alias", SHORT),
    0x24: ("maximum_qos", BYTE),
    0x25: ("retain_available", BYTE),
    0x26: ("user_property", PAIR),
    0x27: ("maximum_packet_size", LONG),
    0x28: ("wildcards_available", BYTE),
    0x29: ("subscription_ids_available", BYTE),
    0x2A: ("shared_available", BYTE),
}
NUMBERS = {name: number for number, (name, _) in PROPERTIES.items()}


def pack(properties: Properties, version: int) -> bytes:
    """Return the properties of a packet; nothing in 3.1.1, which has none."""
    if version != V5:
        return b""
    parts = (bytes([NUMBERS[name]]) + PROPERTIES[NUMBERS[name]][1][0](value) for name, value in properties.items())
    data = b"".join(parts)
    return varint(len(data)) + data


def unpack(reader: Reader, version: int) -> Properties:
    """Take the properties of a packet, where it has any."""
    if version != V5 or reader.is_at_end:
        return NONE
    inner = Reader(reader.take(reader.varint()))
    found: dict[str, Any] = {}
    while not inner.is_at_end:
        number = inner.varint()
        if number not in PROPERTIES:
            raise Malformed(f"no property {number:02X}H")
        name, (_, read) = PROPERTIES[number]
        found[name] = read(inner)
    return found
