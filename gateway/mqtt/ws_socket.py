"""A WebSocket that looks like a socket: what is sent goes out as frames, what comes is handed on without them.

paho has one too; it loses packets when the socket is full, and answers pings so that servers must close.
"""

from __future__ import annotations

import secrets
import socket
import ssl
import time
from typing import Any

from gateway.mqtt.ws_frames import BadWebSocket, Control, Frames, Opcode, check, frame, parted, request

READ_AT_ONCE = 16 * 1024  # bytes
LARGEST_BACKLOG = 4096  # bytes of answers to pings for a server that does not read
BLOCKED = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)


class WebSocket:
    """A connected socket, with TLS or without, on which a WebSocket is open."""

    def __init__(self, sock: socket.socket, received: bytes = b"") -> None:
        self._sock = sock
        self._frames = Frames()
        self._ready = bytearray()
        self._unsent = bytearray()  # of the frames that the socket has not taken: one packet, and a few pongs
        self._is_over = False
        if received:
            self._take(received)

    @classmethod
    def opened(cls, sock: socket.socket, host: str, path: str, limit: float) -> WebSocket:
        """Ask for a WebSocket on a blocking socket, within so many seconds; OSError says why there is none."""
        key = secrets.token_bytes(16)
        end = time.monotonic() + limit
        try:
            sock.settimeout(limit)
            sock.sendall(request(host, path, key))
            received, found = b"", None
            while found is None:
                sock.settimeout(max(0.001, end - time.monotonic()))
                more = sock.recv(READ_AT_ONCE)
                if not more:
                    raise ConnectionResetError
                received += more
                found = parted(received)
            check(found[0], key)
        except (ConnectionResetError, BrokenPipeError) as error:
            sock.close()
            raise BadWebSocket("the other end hung up instead of opening a WebSocket") from error
        except BaseException:
            sock.close()
            raise
        return cls(sock, found[1])

    # ---- what paho calls

    def recv(self, size: int) -> bytes:
        """Return at most so many bytes of MQTT, b"" at the end; BlockingIOError where none have come."""
        if not self._ready and not self._is_over:
            self._read()
        if not self._ready:
            if self._is_over:
                return b""
            raise BlockingIOError
        found = bytes(self._ready[:size])
        del self._ready[:size]
        return found

    def send(self, data: bytes | bytearray) -> int:
        """Take all of it as a frame; BlockingIOError while the one before is not written."""
        if not self.push():
            raise BlockingIOError
        self._frame(Opcode.BINARY, bytes(data))
        self.push()
        return len(data)

    def close(self) -> None:
        """Close the socket, with what the kernel takes of a last word."""
        try:
            if not self._is_over and self.push():
                self._frame(Opcode.CLOSE, b"\x03\xe8")  # 1000: done
                self.push()
        except OSError:
            pass  # the other end is gone already
        finally:
            self._sock.close()

    def fileno(self) -> int:
        """Return the descriptor of the socket."""
        return self._sock.fileno()

    def pending(self) -> int:
        """Return how many bytes are here already, of which the socket tells nothing."""
        held = self._sock.pending() if isinstance(self._sock, ssl.SSLSocket) else 0
        return len(self._ready) + held

    def setblocking(self, flag: bool) -> None:
        """Let the socket wait, or not."""
        self._sock.setblocking(flag)

    def setsockopt(self, *option: Any) -> None:
        """Set an option of the socket."""
        self._sock.setsockopt(*option)

    # ---- frames

    def push(self) -> bool:
        """Write what is left of frames; say whether all of it is written."""
        while self._unsent:
            try:
                del self._unsent[: self._sock.send(self._unsent)]
            except BLOCKED:
                return False
        return True

    def _read(self) -> None:
        received = self._sock.recv(READ_AT_ONCE)
        if received:
            self._take(received)
        else:
            self._is_over = True

    def _take(self, received: bytes) -> None:
        found, controls = self._frames.feed(received)
        self._ready += found
        for control in controls:
            self._answer(control)

    def _answer(self, control: Control) -> None:
        """Answer a ping and a close with their own payload (RFC 6455 5.5); behind a close nothing counts."""
        if self._is_over or control.opcode is Opcode.PONG:
            return
        is_close = control.opcode is Opcode.CLOSE
        if len(self._unsent) < LARGEST_BACKLOG or is_close:
            self._frame(Opcode.CLOSE if is_close else Opcode.PONG, control.payload)
            self.push()
        self._is_over = is_close

    def _frame(self, opcode: Opcode, payload: bytes) -> None:
        self._unsent += frame(opcode, payload, secrets.token_bytes(4))
