"""Lets others see the frames: a UNIX socket, read only, one JSON object a line, and no wait for a slow reader."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import socket
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.clock import Clock
from gateway.trace.frames import frames
from gateway.trace.meaning import Meaning
from gateway.trace.record import Told, cost
from gateway.trace.ring import Ring

log = logging.getLogger("gateway.trace")

VERSION = 1  # of what is said over the socket
MOST_CLIENTS = 8
LONGEST_REQUEST = 1024  # bytes
PATIENCE = 5.0  # seconds for a client to say what it wants, or to read the last that it is sent
LAST_WORDS = 0.5  # seconds that the end of the gateway waits for those who have not read everything
MOST_UNREAD = 262_144  # bytes that may wait for one client; further frames are lost to it, and counted
MOST_PENDING = 1000  # things told that wait to be sent
AT_ONCE = 2  # things told that are worked on before the lines are served again: half a millisecond

RING, FOLLOW = "ring", "follow"


@dataclass(slots=True, eq=False)
class _Follower:
    """A client that is told of every frame as it comes; `lost` counts those that it was too slow for."""

    writer: asyncio.StreamWriter
    lost: int = 0

    def send(self, lines: list[bytes]) -> None:
        """Send frames, or count them as lost."""
        if self.writer.is_closing():
            return
        if self.writer.transport.get_write_buffer_size() > MOST_UNREAD:
            self.lost += len(lines)
            return
        if self.lost:
            self.writer.write(_line({"lost": self.lost}))
            self.lost = 0
        self.writer.write(b"".join(lines))


class TraceServer:
    """The socket of a running gateway."""

    def __init__(self, path: Path, gateway: str, meanings: Mapping[str, Meaning], ring: Ring, clock: Clock) -> None:
        self._path = path
        self._hello = {"trace": VERSION, "gateway": gateway, "lines": list(meanings)}
        self._meanings = meanings
        self._ring = ring
        self._clock = clock
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.StreamWriter] = set()
        self._followers: set[_Follower] = set()
        self._pending: deque[tuple[str, Told]] = deque()

    async def start(self) -> None:
        """Serve. Where that cannot be, the gateway goes on without: the log says why."""
        try:
            listener = _bound(self._path)
            self._server = await asyncio.start_unix_server(self._serve, sock=listener, limit=LONGEST_REQUEST)
        except OSError as error:
            reason = error.strerror or str(error)
            log.warning("%s: %s; tosvert-gateway trace cannot ask this gateway (trace.socket)", self._path, reason)

    async def stop(self) -> None:
        """End every connection and remove the socket."""
        if self._server is None:
            return
        self._server.close()
        await asyncio.gather(*(_ended(writer, LAST_WORDS) for writer in self._clients))
        with contextlib.suppress(OSError):
            self._path.unlink()
        self._server = None

    def take(self, line: str, told: Told) -> None:
        """Have it sent to whoever follows, after what is being done."""
        if not self._followers:
            return
        if not self._pending:
            asyncio.get_running_loop().call_soon(self._send)
        if len(self._pending) < MOST_PENDING:
            self._pending.append((line, told))
        else:
            for follower in self._followers:
                follower.lost += cost(told)[0]

    def _send(self) -> None:
        batch = [self._pending.popleft() for _ in range(min(AT_ONCE, len(self._pending)))]
        lines = [text for line, told in batch for text in self._lines(line, told)]
        for follower in self._followers:
            follower.send(lines)
        if self._pending:
            asyncio.get_running_loop().call_soon(self._send)

    def _lines(self, line: str, told: Told) -> list[bytes]:
        offset = self._clock.wall() - self._clock.now()
        return [_line(frame.as_table()) for frame in frames(line, told, self._meanings[line], offset)]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients.add(writer)
        try:
            if len(self._clients) > MOST_CLIENTS:
                writer.write(_line({"error": f"{MOST_CLIENTS} others look already"}))
            else:
                await self._answer(reader, writer)
        except (OSError, ValueError, TimeoutError):
            pass  # it went, says what is no request, or does not read: it is dropped
        finally:
            try:
                await _ended(writer, PATIENCE)
            finally:
                self._clients.discard(writer)

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        request = json.loads(await asyncio.wait_for(reader.readline(), PATIENCE))
        wanted = request.get("do") if isinstance(request, dict) else None
        if wanted not in (RING, FOLLOW):
            writer.write(_line({"error": f'{{"do": "{RING}"}} or {{"do": "{FOLLOW}"}} is wanted'}))
            return
        writer.write(_line(self._hello))
        if wanted == RING:
            await self._send_ring(writer)
            return
        follower = _Follower(writer)
        self._followers.add(follower)
        try:
            while await reader.read(LONGEST_REQUEST):
                pass  # nothing more can be asked for
        finally:
            self._followers.discard(follower)

    async def _send_ring(self, writer: asyncio.StreamWriter) -> None:
        """Send what the ring holds now, piece by piece: the lines are served in between.

        A pager may stop reading for as long as its user reads: it keeps its place among the clients, as followers do.
        """
        told = self._ring.all()
        for start in range(0, len(told), AT_ONCE):
            for line, one in told[start : start + AT_ONCE]:
                writer.write(b"".join(self._lines(line, one)))
            await writer.drain()
            await asyncio.sleep(0)
        writer.transport.set_write_buffer_limits(high=0)  # wait until all of it is read
        writer.write(_line({"over": True}))
        await writer.drain()


async def _ended(writer: asyncio.StreamWriter, patience: float) -> None:
    """Close a connection when all is read that waits for its client; after `patience` seconds break it off."""
    writer.close()
    breaking_off = asyncio.get_running_loop().call_later(patience, writer.transport.abort)
    try:
        with contextlib.suppress(OSError):
            await writer.wait_closed()
    finally:
        breaking_off.cancel()


def _bound(path: Path) -> socket.socket:
    """Return a listening socket at a path, for its owner only; OSError where it cannot be."""
    if path.is_socket():
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()  # a gateway that was killed left it
            else:
                raise FileExistsError(17, "another gateway serves it")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        listener.bind(str(path))
        listener.listen(MOST_CLIENTS)
        listener.setblocking(False)
    except BaseException:
        listener.close()
        raise
    finally:
        os.umask(before)
    return listener


def _line(table: dict[str, Any]) -> bytes:
    return json.dumps(table, separators=(",", ":")).encode() + b"\n"
