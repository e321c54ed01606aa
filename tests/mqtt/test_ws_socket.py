"""The WebSocket that paho takes for a socket, over a pair of sockets: what goes out, what comes, how it ends."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest

from gateway.mqtt.ws_frames import BadWebSocket, Opcode, masked
from gateway.mqtt.ws_socket import LARGEST_BACKLOG, WebSocket
from tests.mqtt.test_ws_frames import of_server

SMALL = 4096  # bytes that the kernel holds


@pytest.fixture
def ends() -> Iterator[tuple[WebSocket, socket.socket]]:
    """Return our end, open, and the server's."""
    ours, theirs = socket.socketpair()
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SMALL)
    ours.setblocking(False)
    theirs.settimeout(5)
    yield WebSocket(ours), theirs
    ours.close()
    theirs.close()


def read_frame(server: socket.socket) -> tuple[int, bytes]:
    """Read one short masked frame as a server."""
    first, second = server.recv(2, socket.MSG_WAITALL)
    assert second & 0x80
    size = second & 0x7F
    if size == 126:
        size = int.from_bytes(server.recv(2, socket.MSG_WAITALL), "big")
    mask = server.recv(4, socket.MSG_WAITALL)
    return first & 0x0F, masked(server.recv(size, socket.MSG_WAITALL) if size else b"", mask)


def test_bytes_come_without_their_frames(ends: tuple[WebSocket, socket.socket]) -> None:
    """As many as are asked for; what is here already is told, since the socket tells nothing of it."""
    ours, server = ends
    with pytest.raises(BlockingIOError):
        ours.recv(1)
    server.sendall(of_server(2, b"ab") + of_server(2, b"cde"))
    assert (ours.recv(1), ours.pending()) == (b"a", 4)
    assert (ours.recv(10), ours.pending()) == (b"bcde", 0)
    server.close()
    assert ours.recv(1) == b""


def test_what_the_server_sent_with_its_answer_is_not_lost() -> None:
    """Behind the head of the handshake."""
    ours, server = socket.socketpair()
    with ours, server:
        assert WebSocket(ours, of_server(2, b"early")).recv(9) == b"early"


def test_pings_are_answered_with_a_mask_and_a_close_ends_it(ends: tuple[WebSocket, socket.socket]) -> None:
    """A server must close where a client's frame has no mask (RFC 6455 5.1)."""
    ours, server = ends
    server.sendall(of_server(9, b"there?") + of_server(10, b"") + of_server(2, b"x") + of_server(8, b"\x03\xe9"))
    assert ours.recv(9) == b"x"
    assert ours.recv(9) == b""
    assert read_frame(server) == (Opcode.PONG, b"there?")
    assert read_frame(server) == (Opcode.CLOSE, b"\x03\xe9")


@pytest.mark.hazard("H24")
def test_a_server_that_does_not_read_holds_back_one_packet_and_loses_none(
    ends: tuple[WebSocket, socket.socket],
) -> None:
    """What was taken is sent whole, in order, pongs between; what is not taken is said so at once."""
    ours, server = ends
    packets = [bytes((number,)) * 1000 for number in range(200)]
    taken = 0
    with contextlib.suppress(BlockingIOError):
        for packet in packets:
            assert ours.send(packet) == 1000
            taken += 1
    assert 0 < taken < 200
    assert not ours.push()
    server.sendall(of_server(9, b"p" * 100) * 1000)
    with pytest.raises(BlockingIOError):
        ours.recv(1)
    assert len(ours._unsent) < LARGEST_BACKLOG + 2000
    heard: list[bytes] = []
    while len(heard) < 200:
        with contextlib.suppress(BlockingIOError):
            ours.push()
            while taken < 200:
                ours.send(packets[taken])
                taken += 1
        opcode, payload = read_frame(server)
        if opcode == Opcode.BINARY:
            heard.append(payload)
        else:
            assert (opcode, payload) == (Opcode.PONG, b"p" * 100)
    assert heard == packets


def test_the_end_is_said(ends: tuple[WebSocket, socket.socket]) -> None:
    """By a close, where the socket takes one; a server that is gone does not matter."""
    ours, server = ends
    ours.close()
    assert read_frame(server) == (Opcode.CLOSE, b"\x03\xe8")
    again, gone = socket.socketpair()
    gone.close()
    WebSocket(again).close()
    assert again.fileno() == -1


@pytest.mark.parametrize(
    ("answer", "said"),
    [(b"HTTP/1.1 404 Not Found\r\n\r\n", "404"), (b"\x20\x02\0\0", "no HTTP"), (b"", "hung up")],
)
def test_a_server_that_opens_none_is_let_go_with_its_reason(answer: bytes, said: str) -> None:
    """The socket is closed as well."""
    ours, server = socket.socketpair()

    def serve() -> None:
        server.recv(4096)
        server.sendall(answer)
        server.close()

    thread = threading.Thread(target=serve)
    thread.start()
    with pytest.raises(BadWebSocket, match=said):
        WebSocket.opened(ours, "h", "/mqtt", 5.0)
    thread.join()
    assert ours.fileno() == -1


def test_a_server_that_says_nothing_is_not_waited_for() -> None:
    """Longer than the limit, however slowly it drips."""
    ours, server = socket.socketpair()
    with server:
        server.sendall(b"HTTP/1.1 101 ")
        with pytest.raises(TimeoutError):
            WebSocket.opened(ours, "h", "/mqtt", 0.02)
