"""Asks a running gateway for its frames, over the socket that it serves; the port of the line stays the gateway's."""

from __future__ import annotations

import contextlib
import json
import select
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.errors import GatewayError
from gateway.trace.frames import Frame
from gateway.trace.server import FOLLOW, PATIENCE, RING, VERSION

READ_SIZE = 65_536  # bytes


@dataclass(frozen=True, slots=True)
class Lost:
    """Frames that the gateway did not send, since they were not read fast enough."""

    count: int


class Seen:
    """A connection to a running gateway, whose lines have the names `lines`; GatewayError says why there is none.

    `seconds` bounds how long it is followed.
    """

    def __init__(self, paths: Sequence[Path], *, is_followed: bool, seconds: float | None = None) -> None:
        self._socket = _connected(paths)
        self._seconds = seconds
        self._is_followed = is_followed
        self._buffer = b""
        try:
            self._socket.settimeout(PATIENCE)
            self._socket.sendall(json.dumps({"do": FOLLOW if is_followed else RING}).encode() + b"\n")
            hello = next(self._tables(time.monotonic() + PATIENCE), {"error": "it says nothing"})
        except OSError as error:
            raise GatewayError(f"the gateway does not answer: {error}") from error
        if "error" in hello:
            raise GatewayError(f"the gateway shows no frames: {hello['error']}")
        if hello.get("trace") != VERSION:
            raise GatewayError("the gateway is of another version than this command")
        self.gateway = str(hello["gateway"])
        self.lines = [str(name) for name in hello["lines"]]

    def frames(self) -> Iterator[Frame | Lost]:
        """Yield what the gateway shows, until all is shown, the time is over, or a gateway that is followed ends.

        GatewayError where the latest frames end before the gateway has said that these were all.
        """
        until = None if self._seconds is None else time.monotonic() + self._seconds
        for table in self._tables(until):
            if "over" in table:
                return
            if "lost" in table:
                yield Lost(int(table["lost"]))
            else:
                yield Frame.of_table(table)
        if not self._is_followed:
            raise GatewayError("the gateway ended the connection too soon: its latest frames are missing here")

    def _tables(self, until: float | None) -> Iterator[dict[str, Any]]:
        while True:
            while (end := self._buffer.find(b"\n")) >= 0:
                line, self._buffer = self._buffer[:end], self._buffer[end + 1 :]
                yield _table(line)
            left = None if until is None else max(0.0, until - time.monotonic())
            if not select.select([self._socket], [], [], left)[0]:
                return
            try:
                data = self._socket.recv(READ_SIZE)
            except ConnectionResetError:
                return
            if not data:
                return
            self._buffer += data

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


def _table(line: bytes) -> dict[str, Any]:
    with contextlib.suppress(ValueError):
        table = json.loads(line)
        if isinstance(table, dict):
            return table
    raise GatewayError("what serves there is no gateway")


def _connected(paths: Sequence[Path]) -> socket.socket:
    """Return a connection to the first path that a gateway serves; GatewayError says why there is none."""
    reasons = []
    for path in dict.fromkeys(paths):
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.connect(str(path))
        except OSError as error:
            connection.close()
            reasons.append(f"{path}: {_reason(error)}")
        else:
            return connection
    raise GatewayError("\n".join(("no gateway shows its frames; is it running, as this user?", *reasons)))


def _reason(error: OSError) -> str:
    if isinstance(error, ConnectionRefusedError):
        return "nobody serves it: the gateway that did was killed"
    if isinstance(error, PermissionError):
        return "permission denied: ask as the user of the gateway, or as root"
    return error.strerror or str(error)
