"""A broker double without I/O: bytes in, bytes out, MQTT 3.1.1 and 5 as far as QoS 1.

tests/mqtt/test_broker_contract.py holds it to what Mosquitto does. Beyond that it can do what no broker should:
see `duplicates` and `is_hoarding`.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from random import Random
from typing import Protocol

from tests.simulation import packets
from tests.simulation.packet_codec import Decoder, encode
from tests.simulation.packet_parts import Malformed
from tests.simulation.packets import V5, V311, Filter, Packet, Properties, Publish

NEVER = float("inf")
TAKEN_OVER = 0x8E  # reason codes of DISCONNECT (5.0, 2.4)
PROTOCOL_ERROR = 0x82
KEEP_ALIVE_TIMEOUT = 0x8D
WITH_WILL = 0x04
NO_SUCH_SUBSCRIPTION = 0x11
NO_SUBSCRIBERS = 0x10
FOR_EVER = 0xFFFF_FFFF  # session expiry
QUEUE = 1000  # messages kept for a client that is away, or does not acknowledge
RECEIVE_MAXIMUM = 20  # QoS 1 messages under way to a client that does not say; Mosquitto's max_inflight_messages


@dataclass(frozen=True, slots=True)
class Message:
    """A message on its way through the broker. `tag` is for whoever published it from within the process."""

    topic: str
    payload: bytes
    qos: int = 0
    is_retained: bool = False
    expires: float = NEVER
    properties: Properties = field(default_factory=dict)
    sender: str = ""
    tag: object = None


class Outlet(Protocol):
    """The way to one client."""

    def send(self, data: bytes, message: Message | None) -> None:
        """Send bytes; `message` is what they carry, if they carry one."""

    def close(self) -> None:
        """Close behind them."""


Hear = Callable[[Message], None]


def matches(pattern: str, topic: str) -> bool:
    """Say whether a topic is one of a filter's (5.0, 4.7)."""
    wanted, levels = pattern.split("/"), topic.split("/")
    if topic.startswith("$") and wanted[0] in ("#", "+"):
        return False
    for place, level in enumerate(wanted):
        if level == "#":
            return True
        if place >= len(levels) or level not in ("+", levels[place]):
            return False
    return len(wanted) == len(levels)


@dataclass(slots=True)
class Session:
    """What the broker knows of one client, beyond its connection where it is to last."""

    client_id: str
    version: int = V5
    subscriptions: dict[str, Filter] = field(default_factory=dict)
    waiting: deque[tuple[Message, int, bool]] = field(default_factory=deque)  # with QoS and retain flag
    under_way: OrderedDict[int, Publish] = field(default_factory=OrderedDict)
    peer: Peer | None = None
    lasts: float = 0.0  # seconds beyond the connection
    ends: float = NEVER
    _numbers: int = 0

    def next_number(self) -> int:
        """Return a packet id that is free."""
        while True:
            self._numbers = self._numbers % 65_535 + 1
            if self._numbers not in self.under_way:
                return self._numbers


class Peer:
    """One connection: eats the client's bytes."""

    def __init__(self, broker: Broker, outlet: Outlet) -> None:
        self.session: Session | None = None
        self.will: Publish | None = None
        self.will_delay = 0.0
        self.receive_maximum = RECEIVE_MAXIMUM
        self.largest = NEVER  # bytes of a packet
        self.is_open = True
        self.outlet = outlet
        self._broker = broker
        self._decoder = Decoder()
        self._keep_alive = 0.0
        self._heard = broker.now()

    @property
    def version(self) -> int:
        """Return the protocol level that the client speaks."""
        return self._decoder.version

    @property
    def deadline(self) -> float:
        """Return when a silent client is given up."""
        return self._heard + 1.5 * self._keep_alive if self._keep_alive else NEVER

    def feed(self, data: bytes) -> None:
        """Take what the client has sent."""
        self._heard = self._broker.now()
        try:
            for packet in self._decoder.feed(data):
                if self.is_open:
                    self._take(packet)
        except Malformed:
            self.drop(PROTOCOL_ERROR)

    def _take(self, packet: Packet) -> None:
        session = self.session
        if session is None or isinstance(packet, packets.Connect):
            if session is not None or not isinstance(packet, packets.Connect):
                raise Malformed("CONNECT comes first, and once")
            self._keep_alive = float(packet.keep_alive)
            self._broker.connected(self, packet)
            return
        match packet:
            case Publish():
                self._broker.publish(_incoming(packet, session, self._broker.now()))
                if packet.qos:
                    self.tell(packets.Puback(packet.packet_id))
            case packets.Puback():
                self._broker.acknowledged(session, packet.packet_id)
            case packets.Subscribe():
                self._broker.subscribed(session, packet)
            case packets.Unsubscribe():
                known = [session.subscriptions.pop(topic, None) for topic in packet.topics]
                codes = tuple(NO_SUCH_SUBSCRIPTION if wish is None else 0 for wish in known)
                self.tell(packets.Unsuback(packet.packet_id, codes))
            case packets.Pingreq():
                self.tell(packets.Pingresp())
            case packets.Disconnect():
                self._disconnected(packet)
            case _:
                raise Malformed(f"a client does not send {type(packet).__name__}")

    def _disconnected(self, packet: packets.Disconnect) -> None:
        if packet.code != WITH_WILL:
            self.will = None
        if self.session is not None and "session_expiry" in packet.properties:
            self.session.lasts = packet.properties["session_expiry"]
        self.lost()
        self.outlet.close()

    def tell(self, packet: Packet, message: Message | None = None) -> None:
        """Send a packet, unless the client says that it is too large."""
        data = encode(packet, self.version)
        if len(data) <= self.largest:
            self.outlet.send(data, message)

    def drop(self, code: int) -> None:
        """End the connection for a reason; in 3.1.1 without a word."""
        if not self.is_open:
            return
        if self.version == V5 and self.session is not None:
            self.tell(packets.Disconnect(code))
        self.lost()
        self.outlet.close()

    def lost(self) -> None:
        """Take note that the connection is gone; where the client has not disconnected, its will is done."""
        if self.is_open:
            self.is_open = False
            self._broker.parted(self)


def _incoming(packet: Publish, session: Session, now: float) -> Message:
    known = dict(packet.properties)
    expiry = known.pop("message_expiry", None)
    expires = NEVER if expiry is None else now + expiry
    return Message(packet.topic, packet.payload, packet.qos, packet.is_retained, expires, known, session.client_id)


class Broker:
    """The broker. `now` is its clock; `tick` has to be called from time to time, `next_time` says when."""

    def __init__(self, now: Callable[[], float], chance: Random | None = None) -> None:
        self.now = now
        self.duplicates = 0.0  # probability that a message of QoS 1 is sent twice, though it was not lost
        self.is_hoarding = False  # keeps messages for clients that have asked for a clean session, too
        self.retained: dict[str, Message] = {}
        self.sessions: dict[str, Session] = {}
        self.peers: set[Peer] = set()
        self._listeners: list[tuple[str, Hear]] = []
        self._wills: list[tuple[float, str, Message]] = []
        self._chance = chance or Random(0)
        self._names = itertools.count(1)

    # ---- clients

    def accept(self, outlet: Outlet) -> Peer:
        """Take a connection."""
        peer = Peer(self, outlet)
        self.peers.add(peer)
        return peer

    def connected(self, peer: Peer, packet: packets.Connect) -> None:
        """Answer a CONNECT: whoever had that client id before has to go."""
        client_id = packet.client_id or f"auto-{next(self._names)}"
        before = self.sessions.get(client_id)
        if before is not None and before.peer is not None:
            before.peer.drop(TAKEN_OVER)
            before = self.sessions.get(client_id)
        self._wills = [entry for entry in self._wills if entry[1] != client_id]
        is_kept = before is not None and (not packet.is_clean or self.is_hoarding)
        session = before if before is not None and is_kept else Session(client_id)
        session.version, session.peer, session.ends = packet.version, peer, NEVER
        session.lasts = self._lasting(packet)
        self.sessions[client_id] = session
        peer.session, peer.will = session, packet.will
        peer.will_delay = packet.will.properties.get("will_delay", 0) if packet.will is not None else 0
        peer.receive_maximum = min(RECEIVE_MAXIMUM, packet.properties.get("receive_maximum", RECEIVE_MAXIMUM))
        peer.largest = packet.properties.get("maximum_packet_size", NEVER)
        assigned = {"assigned_client_id": client_id} if not packet.client_id else {}
        peer.tell(packets.Connack(is_kept and not packet.is_clean, 0, assigned))
        for number, sent in session.under_way.items():
            peer.tell(replace(sent, is_duplicate=True, packet_id=number))
        self._send_on(session)

    def _lasting(self, packet: packets.Connect) -> float:
        """Return for how many seconds the session outlives the connection."""
        if self.is_hoarding:
            return FOR_EVER
        if packet.version == V311:
            return 0.0 if packet.is_clean else FOR_EVER
        return float(packet.properties.get("session_expiry", 0))

    def parted(self, peer: Peer) -> None:
        """Take note that a connection is gone, and do its will."""
        self.peers.discard(peer)
        session = peer.session
        if session is None:
            return
        session.peer = None
        session.ends = NEVER if session.lasts >= FOR_EVER else self.now() + session.lasts
        if not session.lasts:
            self.sessions.pop(session.client_id, None)
        if peer.will is not None:
            will = _incoming(peer.will, session, self.now())
            delay = min(peer.will_delay, session.lasts)
            if delay:
                self._wills.append((self.now() + delay, session.client_id, will))
            else:
                self.publish(will)

    def subscribed(self, session: Session, packet: packets.Subscribe) -> None:
        """Grant what is asked for, and send what is kept, where that is wanted."""
        peer = session.peer
        if peer is None:
            return
        fresh = [wish for wish in packet.filters if wish.topic not in session.subscriptions]
        for wish in packet.filters:
            session.subscriptions[wish.topic] = replace(wish, qos=min(wish.qos, 1))
        peer.tell(packets.Suback(packet.packet_id, tuple(min(wish.qos, 1) for wish in packet.filters)))
        for wish in packet.filters:
            if wish.retain_handling == 0 or (wish.retain_handling == 1 and wish in fresh):
                for message in tuple(self.retained.values()):
                    if matches(wish.topic, message.topic) and message.expires > self.now():
                        self._send(session, message, min(message.qos, wish.qos, 1), is_retained=True)

    # ---- messages

    def listen(self, pattern: str, hear: Hear) -> None:
        """Hand every message of a filter to a listener of this process, from now on."""
        self._listeners.append((pattern, hear))

    def publish(self, message: Message) -> None:
        """Take a message: keep it where it is retained, and pass it on to everybody who wants it."""
        if message.is_retained and message.payload:
            self.retained[message.topic] = message
        elif message.is_retained:
            self.retained.pop(message.topic, None)
        for session in tuple(self.sessions.values()):
            wishes = [
                wish
                for wish in session.subscriptions.values()
                if matches(wish.topic, message.topic)
                and not (wish.is_no_local and message.sender == session.client_id)
            ]
            if wishes:
                qos = min(message.qos, max(wish.qos for wish in wishes))
                keeps = message.is_retained and any(wish.keeps_retain for wish in wishes)
                self._send(session, message, qos, is_retained=keeps)
        for pattern, hear in tuple(self._listeners):
            if matches(pattern, message.topic):
                hear(message)

    def _send(self, session: Session, message: Message, qos: int, *, is_retained: bool) -> None:
        """Send a message to a client, or keep it until it can be sent."""
        if qos:
            if len(session.waiting) < QUEUE:
                session.waiting.append((message, qos, is_retained))
            self._send_on(session)
        elif session.peer is not None:
            session.peer.tell(self._packet(session, message, 0, is_retained=is_retained), message)

    def _send_on(self, session: Session) -> None:
        """Send what waits, as far as the client takes it."""
        peer = session.peer
        while peer is not None and session.waiting and len(session.under_way) < peer.receive_maximum:
            message, qos, is_retained = session.waiting.popleft()
            if message.expires <= self.now():
                continue
            packet = replace(
                self._packet(session, message, qos, is_retained=is_retained), packet_id=session.next_number()
            )
            session.under_way[packet.packet_id] = packet
            peer.tell(packet, message)
            if self.duplicates and self._chance.random() < self.duplicates:
                peer.tell(replace(packet, is_duplicate=True), message)

    def _packet(self, session: Session, message: Message, qos: int, *, is_retained: bool) -> Publish:
        properties = dict(message.properties) if session.version == V5 else {}
        if message.expires != NEVER and session.version == V5:
            properties["message_expiry"] = max(1, round(message.expires - self.now()))
        return Publish(message.topic, message.payload, qos, is_retained, properties=properties)

    def acknowledged(self, session: Session, number: int) -> None:
        """Take note that a message has arrived; the next ones may go."""
        session.under_way.pop(number, None)
        self._send_on(session)

    # ---- time

    @property
    def next_time(self) -> float:
        """Return when `tick` has something to do."""
        times = [peer.deadline for peer in self.peers] + [when for when, _, _ in self._wills]
        times += [session.ends for session in self.sessions.values() if session.peer is None]
        return min(times, default=NEVER)

    def tick(self) -> None:
        """Give up silent clients, do delayed wills, end sessions whose time is over."""
        now = self.now()
        for peer in tuple(self.peers):
            if peer.deadline <= now:
                peer.drop(KEEP_ALIVE_TIMEOUT)
        due = [entry for entry in self._wills if entry[0] <= now]
        self._wills = [entry for entry in self._wills if entry[0] > now]
        for _, _, will in due:
            self.publish(will)
        for session in tuple(self.sessions.values()):
            if session.peer is None and session.ends <= now:
                del self.sessions[session.client_id]

    def restart(self, *, is_forgetful: bool) -> None:
        """End every connection, as a broker does that ends; sessions and kept messages are lost where it forgets."""
        for peer in tuple(self.peers):
            peer.will = None  # Mosquitto does no wills when it ends
            peer.lost()
            peer.outlet.close()
        if is_forgetful:
            self.sessions.clear()
            self.retained.clear()
