"""What a connection is made of: a paho client that has said CONNECT, what it says of its end, and the settings."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from gateway.errors import GatewayError


class BrokerAway(GatewayError):
    """There is no connection: say why once, try again after a pause."""


class Terms(Protocol):
    """What a section of the configuration says of a connection: its table, its log, how much may wait, the QoS."""

    @property
    def table(self) -> str:
        """Return the name of the section."""
        ...

    @property
    def channel(self) -> str:
        """Return the channel of the log."""
        ...

    @property
    def queue(self) -> int:
        """Return how many messages may wait for the broker."""
        ...

    @property
    def qos(self) -> int:
        """Return the quality of service."""
        ...


class LastError(logging.Logger):
    """Keeps the last error that paho tells its logger: its callbacks do not say why a connection broke."""

    def __init__(self) -> None:
        super().__init__("paho")
        self.text = ""

    def log(self, level: int, msg: object, *args: object, **kwargs: Any) -> None:
        """Keep an error; pass over the rest."""
        if level >= logging.ERROR:
            self.text = (str(msg) % args).removeprefix("failed to receive on socket: ")


@dataclass(frozen=True, slots=True)
class Made:
    """A paho client that has sent its CONNECT, and what goes with it.

    `expiry` makes the properties of a message that the broker may forget after so many seconds, and `correlation`
    those of an answer; both make None where the protocol has no such thing: `is_5` says whether it has.
    `reason_name` names the reason code of a PUBACK. `reason` goes with the last DISCONNECT.
    """

    client: Any
    errors: LastError
    expiry: Callable[[int], Any]
    correlation: Callable[[bytes], Any]
    reason_name: Callable[[int], str]
    is_5: bool
    reason: Any = None


def close(client: Any) -> None:
    """Close a client's socket, if there is one, without a word to the broker."""
    sock = client.socket()
    if sock is not None:
        sock.close()
