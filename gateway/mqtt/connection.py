"""One connection to the broker, driven by the event loop: how it begins, whether it lives, how it ends.

paho's own client is handed in, made elsewhere; `outgoing` is the way to the broker.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Sequence
from typing import Any

from gateway.metrics import MqttStats
from gateway.mqtt import reasons
from gateway.mqtt.made import BrokerAway, Made, Terms, close
from gateway.mqtt.outgoing import Outgoing
from gateway.mqtt.packets import FAILURE
from gateway.mqtt.receipts import Receipts
from gateway.mqtt.reception import Ears, Reception
from gateway.mqtt.socket_loop import SocketLoop

PILED_UP = 64  # messages that are written at once
ANSWER_LIMIT = 10.0  # seconds from CONNECT to CONNACK
LEAVE_LIMIT = 2.0  # seconds from the last words to the end
HIGHEST_QOS = 2  # where CONNACK says nothing else (MQTT 5 3.2.2.3.4)
NO_RECEIVE_MAXIMUM = 65_535  # messages of QoS 1 and 2 under way (MQTT 5 3.2.2.3.3)
CALLBACKS = (
    "on_connect",
    "on_disconnect",
    "on_publish",
    "on_message",
    "on_subscribe",
    "on_socket_close",
    "on_socket_register_write",
)
LOSSES = {  # what paho's names for the end of a connection mean
    "Unspecified error": "closed by the broker; if that repeats, another client may have the same client id",
    "Keep alive timeout": "the broker has not answered within the keep-alive",
}


class Connection:
    """One connection by a paho client that is thrown away with it, so that nothing of an old one is sent late.

    paho calls back from inside its own functions while it holds a lock that it needs for writing: callbacks
    only take notes here. An exception in one of them is raised by the next `wait`.
    """

    def __init__(self, made: Made, section: Terms, stats: MqttStats) -> None:
        self.lost: str | None = None
        self._client = made.client
        self._errors = made.errors
        self._last_reason = made.reason
        self._answer: Any = None
        self._table = section.table
        self._log = logging.getLogger(section.channel)
        self._was_refused = False
        self._reception = Reception(made.client, stats, section)
        self._reason_name = made.reason_name
        self._socket = SocketLoop(made.client, self._reception, self, is_5=made.is_5)
        self.outgoing = Outgoing(made, section, stats, self._socket.write_soon)
        self.receipts = Receipts(made.client, self.outgoing)
        self._news = asyncio.Event()
        self._wanted_room = 0
        self._error: Exception | None = None
        self._loop = asyncio.get_running_loop()
        self._attach()

    def _attach(self) -> None:
        client = self._client
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_socket_close = self._on_socket_close
        client.on_socket_register_write = _do_nothing  # it keeps paho from writing message by message
        if self.outgoing.is_pahos:
            client.on_publish = self._on_publish
        if not self._socket.attach():
            raise BrokerAway(reasons.of_silence(self._errors.text, self._table))
        self.flush()

    # ---- what paho tells

    def _on_connect(self, _client: Any, _data: Any, _flags: Any, code: Any, properties: Any) -> None:
        self._answer = code
        self.outgoing.largest = getattr(properties, "MaximumPacketSize", None)
        receive_maximum = getattr(properties, "ReceiveMaximum", NO_RECEIVE_MAXIMUM)
        self.outgoing.limit(receive_maximum, getattr(properties, "MaximumQoS", HIGHEST_QOS))
        self._news.set()

    def _on_disconnect(self, _client: Any, _data: Any, flags: Any, code: Any, _properties: Any) -> None:
        if flags.is_disconnect_packet_from_server:
            self.lose(reasons.of_code(code.value, code.getName(), self._table))
        else:
            self.lose(self._errors.text or LOSSES.get(code.getName(), code.getName()))

    def _on_publish(self, _client: Any, _data: Any, _mid: int, code: Any, _properties: Any) -> None:
        if code.is_failure:
            self._tell_refusal(code.value)

    def _tell_refusal(self, code: int) -> None:
        """Log that the broker acknowledges and does not want a message: once, since more will follow."""
        if not self._was_refused:
            self._was_refused = True
            why = reasons.of_code(code, self._reason_name(code), self._table)
            self._log.warning("the broker refuses messages: %s", why)

    def _on_socket_close(self, _client: Any, _data: Any, _sock: Any) -> None:
        self._socket.detach()

    # ---- what its socket tells

    def acknowledge(self, packet_id: int, code: int) -> bool:
        """Take a PUBACK; False where it is for paho."""
        if not self.outgoing.acknowledge(packet_id):
            return False
        if code >= FAILURE:
            self._tell_refusal(code)
        return True

    @property
    def has_unwritten(self) -> bool:
        """Say whether anything was sent since the last flush."""
        return self.outgoing.unwritten > 0

    # ---- what its user does

    def listen(self, subscriptions: Sequence[tuple[str, Any]], ears: Ears) -> None:
        """Subscribe, and hand every message that comes to `ears`."""
        self._reception.listen(subscriptions, ears)
        self.flush()

    def flush(self) -> None:
        """Write what was sent to the socket, now; what it does not take is written as soon as it does."""
        self.outgoing.push()
        self.outgoing.unwritten = 0
        is_all_written = self._socket.write()
        is_news = self.outgoing.count(is_all_written=is_all_written)
        is_news |= self.receipts.look()
        if is_news or (self._wanted_room and self.outgoing.room >= self._wanted_room):
            self._news.set()

    def flush_soon(self) -> None:
        """Write what was sent: now, or within a millisecond of the last time with what comes by then."""
        if self.outgoing.unwritten >= PILED_UP:
            self.flush()
        else:
            self._socket.write_in_turn()

    def tend(self) -> None:
        """Keep the connection alive, or find that it is not."""
        self._client.loop_misc()
        self.flush()

    def wake(self) -> None:
        """End the wait of its user."""
        self._news.set()

    def lose(self, reason: str) -> None:
        """Take that the connection has ended."""
        self.lost = reason
        self.outgoing.is_closed = True
        self._news.set()

    def fail(self, error: Exception) -> None:
        """Take an error that nobody expects; its user ends with it."""
        self._error = self._error or error
        self._news.set()

    async def wait(self, limit: float, room: int = 0) -> None:
        """Wait for the answer or the loss of the connection, for `wake`, for so much room, or so many seconds."""
        self._wanted_room = room
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(limit):
                await self._news.wait()
        self._news.clear()
        if self._error is not None:
            raise self._error

    async def accepted(self) -> None:
        """Wait until the broker takes the connection; BrokerAway says why it does not."""
        end = self._loop.time() + ANSWER_LIMIT
        while self._answer is None and self.lost is None:
            if self._loop.time() >= end:
                raise BrokerAway(reasons.of_silence(f"no answer within {ANSWER_LIMIT:.0f} s", self._table))
            await self.wait(end - self._loop.time())
        if self._answer is None:
            raise BrokerAway(reasons.of_silence(self._errors.text, self._table))
        if self._answer.is_failure:
            why = reasons.of_code(self._answer.value, self._answer.getName(), self._table)
            raise BrokerAway(f"refused: {why}")

    async def leave(self) -> None:
        """Wait until all is sent, then disconnect in order."""
        while not self.outgoing.is_empty and self.lost is None:
            await self.wait(LEAVE_LIMIT, room=self.outgoing.capacity)
        self.outgoing.push()
        self._client.disconnect(self._last_reason)
        while self.lost is None:
            self.flush()
            await self.wait(LEAVE_LIMIT)

    def abort(self) -> None:
        """Let go of the socket; where nobody has disconnected in order, the broker sends the will."""
        self._socket.detach()
        self.outgoing.abandon()
        for name in CALLBACKS:
            setattr(self._client, name, None)
        close(self._client)


def _do_nothing(_client: Any, _data: Any, _sock: Any) -> None:
    """Take note of nothing."""
