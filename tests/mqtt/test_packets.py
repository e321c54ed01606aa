"""PUBLISH packets are those that paho writes; what is joined goes out as it would have."""

from __future__ import annotations

import io
from collections import deque
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from gateway.mqtt import packets
from gateway.mqtt.client import _Expiry
from gateway.mqtt.packets import TOGETHER, Batch, join, publish, publish_at_1, topic_bytes

TOPICS = st.text(st.characters(exclude_characters="+#\0", exclude_categories=["Cs"]), min_size=1, max_size=40)
PAYLOADS = st.one_of(st.binary(max_size=300), st.integers(0, 70_000).map(bytes))


class Client0(Client):
    """A client of paho that believes it is connected, and writes nothing."""

    def __init__(self, version: MQTTProtocolVersion) -> None:
        super().__init__(CallbackAPIVersion.VERSION2, protocol=version)
        self._sock: Any = io.BytesIO()
        self.on_socket_register_write = lambda *_: None

    def written(self, topic: str, payload: bytes, retain: bool, properties: Any, qos: int = 0) -> bytes:
        """Return the packet of a message; at QoS 1 its identifier is 1."""
        self._last_mid = self._inflight_messages = 0
        self._out_messages.clear()
        self.publish(topic, payload, qos, retain, properties)
        packet: bytes = bytes(self._out_packet.pop()["packet"])
        return packet


FIVE, THREE = Client0(MQTTProtocolVersion.MQTTv5), Client0(MQTTProtocolVersion.MQTTv311)


@given(topic=TOPICS, payload=PAYLOADS, retain=st.booleans(), expiry=st.sampled_from([0, 1, 7200]))
def test_a_packet_is_as_paho_writes_it(topic: str, payload: bytes, retain: bool, expiry: int) -> None:
    """Of any topic and any length, with and without properties, for both versions."""
    properties: Any = _Expiry(expiry) if expiry else None
    packed = properties.pack() if properties else b"\x00"
    named = topic_bytes(topic)
    assert publish(named, payload, packed, retain=retain) == FIVE.written(topic, payload, retain, properties)
    assert publish(named, payload, b"", retain=retain) == THREE.written(topic, payload, retain, None)
    five = publish_at_1(named, payload, packed, retain=retain)
    assert b"\x00\x01".join(five) == FIVE.written(topic, payload, retain, properties, 1)
    three = publish_at_1(named, payload, b"", retain=retain)
    assert b"\x00\x01".join(three) == THREE.written(topic, payload, retain, None, 1)


def test_a_topic_that_no_packet_holds_is_refused() -> None:
    """More than 65,535 bytes."""
    with pytest.raises(ValueError, match="65536 bytes"):
        topic_bytes("x" * 65_536)


def queued(
    content: bytes, command: int = packets.PUBLISH, qos: int = 0, info: Any = None, pos: int = 0
) -> dict[str, Any]:
    """Return a packet as paho has it in its queue."""
    size = len(content)
    known = {"command": command, "mid": 1, "qos": qos, "pos": pos, "packet": content, "info": info}
    return {**known, "to_process": size - pos}


def test_what_is_joined_goes_out_as_it_would_have() -> None:
    """In order; what is half written, and what ends the connection, stays as it is."""
    half, first, second = Batch(), Batch(), Batch()
    queue = deque(
        [
            queued(b"half written", info=half, pos=5),
            queued(b"one ", info=first),
            queued(b"at least once ", qos=1, info=object()),
            queued(b"ping ", command=0xC0),
            queued(b"two ", info=second),
            queued(b"bye", command=packets.DISCONNECT),
        ]
    )
    join(queue)
    assert [bytes(each["packet"]) for each in queue] == [b"half written", b"one at least once ping two ", b"bye"]
    assert [each["pos"] for each in queue] == [5, 0, 0]
    joined = queue[1]
    assert joined["to_process"] == len(joined["packet"])
    assert (joined["command"] & 0xF0, joined["qos"]) == (packets.PUBLISH, 0), "so that paho tells of it"
    joined["info"]._set_as_published()
    assert (half.is_written(), first.is_written(), second.is_written()) == (False, True, True)


@pytest.mark.hazard("H24")
def test_what_waits_for_a_slow_broker_is_not_joined_again_and_again() -> None:
    """A large piece stays as it is."""
    queue = deque([queued(bytes(TOGETHER - 10)), queued(bytes(20)), queued(bytes(30))])
    large = queue[0]
    join(queue)
    assert [len(each["packet"]) for each in queue] == [TOGETHER - 10, 50]
    assert queue[0] is large
    one = deque([queued(b"one")])
    join(one)
    assert len(one) == 1
