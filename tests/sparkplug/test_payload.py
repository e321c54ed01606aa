"""Payloads to bytes and back: exactly, and nothing else out of whatever bytes."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.sparkplug import payload, protobuf
from gateway.sparkplug.definition import Definition, Teller
from gateway.sparkplug.payload import DataType, Metric, Payload, Property, decode, encode
from gateway.sparkplug.protobuf import BadPayload
from tests import soak

INPUTS = 100_000 * soak.FACTOR
LONG = st.integers(0, 2**64 - 1)
OF_TYPES: dict[DataType, st.SearchStrategy[Any]] = {
    **{DataType(of): st.integers(-(2 ** (n - 1)), 2 ** (n - 1) - 1) for of, n in payload.BITS.items() if of},
    DataType.UINT8: st.integers(0, 2**8 - 1),
    DataType.UINT16: st.integers(0, 2**16 - 1),
    DataType.UINT32: st.integers(0, 2**32 - 1),
    DataType.UINT64: LONG,
    DataType.DATETIME: LONG,
    DataType.FLOAT: st.floats(width=32, allow_nan=False),
    DataType.DOUBLE: st.floats(allow_nan=False),
    DataType.BOOLEAN: st.booleans(),
    DataType.STRING: st.text(),
    DataType.TEXT: st.text(),
    DataType.UUID: st.text(),
}


@st.composite
def metrics(draw: st.DrawFn) -> Metric:
    """Draw any metric that can be sent."""
    datatype = draw(st.sampled_from(sorted(OF_TYPES)))
    return Metric(
        name=draw(st.text()),
        alias=draw(st.none() | LONG),
        timestamp=draw(st.none() | LONG),
        datatype=datatype,
        value=draw(st.none() | OF_TYPES[datatype]),
        is_historical=draw(st.booleans()),
    )


TOLD = (DataType.UINT16, DataType.INT32, DataType.DOUBLE, DataType.STRING)  # the types of what drives tell


@given(st.sampled_from(TOLD).flatmap(lambda of: st.tuples(st.just(of), OF_TYPES[of])), st.integers(1, 10**6), LONG)
def test_what_is_written_at_once_is_the_metric_that_is_told(typed: tuple[DataType, Any], alias: int, ms: int) -> None:
    """To the byte, of every type that a value of a drive may have."""
    datatype, value = typed
    definition = Definition("torque", alias, datatype)
    written = Teller(definition).told(value, ms)
    assert written.timestamp == ms
    assert written.raw == payload.encode_metric(definition.told(value, ms))


def single(value: object) -> object:
    """Return a number as 32 bits hold it."""
    return struct.unpack("<f", struct.pack("<f", value))[0] if isinstance(value, float) else value


@given(st.builds(Payload, st.none() | LONG, st.lists(metrics(), max_size=5).map(tuple), st.none() | LONG))
def test_whatever_is_sent_is_read_again(sent: Payload) -> None:
    """Of a float as many digits as tell it from all others."""
    read = decode(encode(sent))
    assert (read.timestamp, read.seq, len(read.metrics)) == (sent.timestamp, sent.seq, len(sent.metrics))
    for before, after in zip(sent.metrics, read.metrics, strict=True):
        if before.datatype is DataType.FLOAT:
            assert single(after.value) == before.value
        else:
            assert after == before


def test_every_type_is_drawn() -> None:
    """None is left out of the round trip."""
    assert set(OF_TYPES) == set(DataType)


def test_a_float_is_the_number_that_was_meant() -> None:
    """As a host writes 30.1 into a float of 32 bits, so it is read; the exact check of a register needs that."""
    read = payload.decode_metric(protobuf.single(12, 30.1))
    assert read.value == 30.1
    assert single(30.1) != 30.1


@pytest.mark.parametrize("value", [float("inf"), 3.4028234663852886e38, 1e-45, 0.0, -0.0])
def test_the_ends_of_a_float_are_read(value: float) -> None:
    """Also those that no shorter number stands for."""
    read = payload.decode_metric(protobuf.single(12, value)).value
    assert single(read) == single(value)


def test_a_null_has_no_value() -> None:
    """The specification forbids one, and one that comes with it is none."""
    assert protobuf.whole(7, True) in payload.encode_metric(Metric("a", 1, 1, DataType.INT32, None))
    assert payload.decode_metric(protobuf.whole(7, True) + protobuf.whole(10, 5)).value is None


def test_a_number_with_a_sign_is_read_in_the_bits_of_its_type() -> None:
    """Some write a negative Int16 in 16 bits, others in 32."""
    for raw in (0xFFFF, 0xFFFF_FFFF):
        assert payload.decode_metric(protobuf.whole(4, DataType.INT16) + protobuf.whole(10, raw)).value == -1


def test_keys_stand_before_values_in_a_set_of_properties() -> None:
    """Two lists of the same length, as the schema has them."""
    unit, quality = Property("engUnit", DataType.STRING, "Hz"), Property("Quality", DataType.INT32, 192)
    sent = payload.encode_metric(Metric(datatype=DataType.DOUBLE, value=1.0, properties=(unit, quality)))
    fields = {number: value for number, _, value in protobuf.fields(sent)}
    inside = list(protobuf.fields(fields[9]))  # type: ignore[arg-type]
    assert [(number, value) for number, _, value in inside if number == 1] == [(1, b"engUnit"), (1, b"Quality")]
    assert [number for number, _, _ in inside] == [1, 1, 2, 2]


WRONG = [
    (b"\x08", "byte 1: no whole number"),
    (b"\x08" + b"\xff" * 10, "byte 1: no whole number"),
    (b"\x08" + b"\xff" * 9 + b"\x02", "byte 1: no whole number"),
    (b"\x12\x05\x0a\x01", "field 2 has 5 bytes, 2 are left"),
    (b"\x09\x00", "field 1 has 8 bytes, 1 are left"),
    (b"\x0b", "wire type 3 of field 1 is not known"),
    (b"\x00\x00", "there is no field 0"),
    (b"\x0a\x01\x61", "timestamp has wire type 2"),
    (b"\x10\x01", "metrics has wire type 0"),
    (b"\x12\x03\x0a\x01\xff", "name: byte 0 is not UTF-8"),
    (b"\x12\x02\x60\x01", "a value has wire type 0"),
    (b"\x12\x00" * 257, "more than 256 metrics"),
    (b"\x2a" + b"\x00" * 20_000, "20001 bytes; at most 16384"),
]


@pytest.mark.parametrize(("message", "said"), WRONG)
def test_what_is_no_payload_is_refused_with_the_place(message: bytes, said: str) -> None:
    """Nothing is guessed."""
    with pytest.raises(BadPayload, match=said):
        decode(message)


def test_what_is_not_known_is_passed_over() -> None:
    """Extensions of others, templates and data sets have no meaning here, and do no harm."""
    metric = protobuf.text(1, "a") + protobuf.block(17, b"\x08\x01") + protobuf.block(200, b"x")
    read = decode(protobuf.block(2, metric) + protobuf.text(4, "uuid") + protobuf.whole(99, 1))
    assert read.metrics[0].name == "a"
    assert read.metrics[0].value == b"\x08\x01"


@pytest.mark.unmeasured
@pytest.mark.hazard("H17")
def test_whatever_bytes_come_they_are_read_or_refused() -> None:
    """Mutated payloads: nothing but a payload or BadPayload comes of them, and no more than they hold."""
    chance = random.Random(20260301)
    seeds = [
        encode(Payload(1_772_366_400_250, (Metric("Control/Run", 17, 5, DataType.BOOLEAN, True),))),
        encode(Payload(1_772_366_400_250, (Metric("Control/Command", 3, 5, DataType.STRING, "stop"),), 7)),
        encode(Payload(1, tuple(Metric("", n, n, DataType.DOUBLE, n / 3) for n in range(5)))),
        encode(Payload(1, (Metric("x", 1, 1, DataType.FLOAT, 30.1), Metric("y", 2, 2, DataType.INT64, -1)))),
        encode(Payload(1, (Metric("x", 1, 1, DataType.INT32, 5, False, (Property("a", DataType.STRING, "b"),)),))),
    ]
    read = 0
    for _ in range(INPUTS):
        message = bytearray(chance.choice(seeds))
        for _ in range(chance.randrange(1, 4)):
            at = chance.randrange(len(message) + 1)
            match chance.randrange(4):
                case 0 if at < len(message):
                    message[at] = chance.randrange(256)
                case 1:
                    del message[at : at + chance.randrange(1, 6)]
                case 2:
                    message[at:at] = chance.randbytes(chance.randrange(1, 6))
                case _:
                    message[at:at] = chance.choice(seeds)[: chance.randrange(20)]
        try:
            found = decode(bytes(message))
        except BadPayload:
            continue
        read += 1
        assert sum(len(metric.name) for metric in found.metrics) <= len(message)
    assert read > INPUTS // 20
