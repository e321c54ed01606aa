"""Connects to a serial server in the event loop, by raw TCP or RFC 2217; nothing here holds up anything else."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
import threading
from typing import Any

from gateway import site
from gateway.bus.rfc2217 import ComPort, Settings
from gateway.config import server_address
from gateway.errors import LineDown

CONNECT_TIMEOUT = 5.0  # seconds for a serial server to accept
SETTINGS_TIMEOUT = 3.0  # seconds to agree on baud rate and parity
READ_SIZE = 4096  # bytes
ADVICE = "is the serial server on, and line.port right?"

KEEPALIVE = {  # a server that was switched off is noticed after some 10 s, not after hours
    "TCP_KEEPIDLE": 5,  # seconds
    "TCP_KEEPINTVL": 2,  # seconds
    "TCP_KEEPCNT": 3,
    "TCP_USER_TIMEOUT": 10_000,  # milliseconds that a request may be without a sign of the server
}

Address = tuple[socket.AddressFamily, tuple[Any, ...]]


async def connect(line: site.Line, stop_bits: int) -> tuple[socket.socket, ComPort | None]:
    """Return a connection, and where it speaks RFC 2217, that side of it, ready; LineDown says what is wrong."""
    connection = await _connected(line)
    if not line.port.startswith("rfc2217://"):
        return connection, None
    com_port = ComPort(Settings(line.baud, line.parity, stop_bits))
    try:
        async with asyncio.timeout(SETTINGS_TIMEOUT):
            await _agree(connection, com_port)
    except TimeoutError:
        connection.close()
        raise LineDown(f"{line.port}: the serial server connects, but {com_port.lacking}") from None
    except OSError as error:
        connection.close()
        raise LineDown(f"{line.port}: {error.strerror or error}") from error
    except BaseException:
        connection.close()
        raise
    if com_port.problem:
        connection.close()
        raise LineDown(f"{line.port}: the serial server connects, but {com_port.problem}")
    return connection, com_port


async def _agree(connection: socket.socket, com_port: ComPort) -> None:
    """Exchange options and settings until the server has taken all, or will not; what the line says is let go."""
    loop = asyncio.get_running_loop()
    while True:
        if out := com_port.outgoing():
            await loop.sock_sendall(connection, out)
        if com_port.is_ready or com_port.problem:
            return
        if not (data := await loop.sock_recv(connection, READ_SIZE)):
            raise ConnectionResetError("it closes the connection at once; has it another client?")
        com_port.feed(data)


async def _connected(line: site.Line) -> socket.socket:
    """Connect to the first of the server's addresses that accepts; they share the time."""
    found = server_address(line.port)
    assert found is not None, line.port  # noqa: S101 - the caller asked before
    error: Exception = LineDown("no address")
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT):
            addresses = await _addresses(*found)
    except (OSError, UnicodeError) as unknown:
        raise LineDown(f"{line.port}: {str(unknown) or 'the name is not found in time'}; {ADVICE}") from unknown
    for address in addresses:
        try:
            async with asyncio.timeout(CONNECT_TIMEOUT / len(addresses)):
                return await _connection(address)
        except TimeoutError:
            error = TimeoutError("it does not accept a connection; serial servers accept one client only")
        except OSError as refusal:
            error = refusal
    raise LineDown(f"{line.port}: {error}; {ADVICE}") from error


async def _connection(address: Address) -> socket.socket:
    family, where = address
    connection = socket.socket(family, socket.SOCK_STREAM)
    try:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE.items():
            if (option := getattr(socket, name, None)) is not None:  # not on every system
                connection.setsockopt(socket.IPPROTO_TCP, option, value)
        await asyncio.get_running_loop().sock_connect(connection, where)
    except BaseException:
        connection.close()
        raise
    return connection


async def _addresses(host: str, port: int) -> list[Address]:
    """Look a name up; in a thread that nobody waits for at the end, since the resolver cannot be interrupted."""
    if is_numeric(host):
        return _look_up(host, port, socket.AI_NUMERICHOST)
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[list[Address]] = loop.create_future()

    def tell(found: list[Address] | OSError | UnicodeError) -> None:
        if answer.done():
            return
        if isinstance(found, list):
            answer.set_result(found)
        else:
            answer.set_exception(found)

    def look_up() -> None:
        found: list[Address] | OSError | UnicodeError
        try:
            found = _look_up(host, port)
        except (OSError, UnicodeError) as error:
            found = error
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(tell, found)

    threading.Thread(target=look_up, name=f"look up {host}", daemon=True).start()
    return await answer


def _look_up(host: str, port: int, flags: int = 0) -> list[Address]:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=flags)
    return [(family, where) for family, _, _, _, where in found]


def is_numeric(host: str) -> bool:
    """Say whether a host is an address already."""
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(host.partition("%")[0])
        return True
    return False


def is_on_this_machine(connection: socket.socket) -> bool:
    """Say whether the other end is on this machine, where a simulator may stand for a serial server."""
    if connection.family not in (socket.AF_INET, socket.AF_INET6):
        return False
    with contextlib.suppress(OSError):  # it has gone again
        return ipaddress.ip_address(str(connection.getpeername()[0]).partition("%")[0]).is_loopback
    return False
