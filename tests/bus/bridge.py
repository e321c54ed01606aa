"""Serial servers of other hands: a pty behind a TCP port, raw or with pyserial's own side of RFC 2217."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

from serial.rfc2217 import PortManager


@dataclass
class ServerPort:
    """The port that a PortManager sets: it takes what a real one would, and says what it was set to."""

    baudrate: int = 9600
    bytesize: int = 8
    parity: str = "N"
    stopbits: float = 1
    xonxoff: bool = False
    rtscts: bool = False
    break_condition: bool = False
    dtr: bool = True
    rts: bool = True
    cts: bool = False
    dsr: bool = False
    ri: bool = False
    cd: bool = False
    resets: list[str] = field(default_factory=list)

    def reset_input_buffer(self) -> None:
        """Take note that received bytes are thrown away."""
        self.resets.append("input")

    def reset_output_buffer(self) -> None:
        """Take note that waiting bytes are thrown away."""
        self.resets.append("output")


class Bridge:
    """One client at a time, whose bytes go to the pty, and the pty's to it."""

    def __init__(self, port: str, *, speaks_rfc2217: bool) -> None:
        self.settings = ServerPort()
        self.clients = 0
        self._speaks = speaks_rfc2217
        self._fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._fd)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry bytes until the client goes."""
        self.clients += 1
        loop = asyncio.get_running_loop()
        manager = PortManager(self.settings, writer) if self._speaks else None

        def from_line() -> None:
            data = os.read(self._fd, 4096)
            writer.write(b"".join(manager.escape(data)) if manager else data)

        loop.add_reader(self._fd, from_line)
        try:
            while data := await reader.read(4096):
                os.write(self._fd, b"".join(manager.filter(data)) if manager else data)
        finally:
            loop.remove_reader(self._fd)
            writer.close()

    def close(self) -> None:
        """Close the pty."""
        os.close(self._fd)


@contextlib.asynccontextmanager
async def bridged(port: str, *, speaks_rfc2217: bool = False) -> AsyncIterator[tuple[Bridge, str]]:
    """Serve a pty on loopback; yields the bridge, and host and port."""
    bridge = Bridge(port, speaks_rfc2217=speaks_rfc2217)
    server = await asyncio.start_server(bridge.serve, "127.0.0.1", 0)
    try:
        yield bridge, f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        bridge.close()
