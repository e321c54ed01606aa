"""The control of a simulated line: one JSON object a line in, one out, over a UNIX socket or from Python."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from gateway.sim.doing import Doing
from gateway.sim.doings import AnyDoing
from gateway.sim.installation import Installation, WrongRequest
from gateway.sim.loop import LineLoop
from gateway.sim.quantities import problems
from gateway.sim.questions import AnyQuestion

LONGEST_REQUEST = 65_536  # bytes of one line

AnyRequest = Annotated[AnyDoing | AnyQuestion, Field(discriminator="do")]
REQUEST: TypeAdapter[AnyRequest] = TypeAdapter(AnyRequest)


class Control:
    """Does what control requests ask of a running line."""

    def __init__(self, line: Installation, loop: LineLoop) -> None:
        self.line = line
        self._loop = loop

    def do(self, table: dict[str, Any]) -> dict[str, Any]:
        """Do one request; the answer has `ok`, and `result` or `error`."""
        try:
            request = REQUEST.validate_python(table)
            now = time.monotonic()
            if isinstance(request, Doing):
                return {"ok": True, "result": self.line.do(request, now)}
            return {"ok": True, "result": request.answer(self.line, self._loop, now)}
        except ValidationError as error:
            return {"ok": False, "error": "; ".join(problems(error, of_request=True))}
        except WrongRequest as error:
            return {"ok": False, "error": str(error)}

    def do_line(self, line: bytes) -> bytes:
        """Do one request that came as a line of JSON."""
        try:
            request = json.loads(line)
        except ValueError as error:
            return _line({"ok": False, "error": f"not JSON: {error}"})
        if not isinstance(request, dict):
            return _line({"ok": False, "error": "a JSON object is wanted"})
        return _line(self.do(request))


class ControlSocket:
    """The control behind a UNIX socket, served by the line's own loop."""

    def __init__(self, path: Path, control: Control, loop: LineLoop) -> None:
        self._path = path
        self._loop = loop
        self._control = control
        self._clients: dict[int, tuple[socket.socket, bytearray]] = {}
        _clear_the_way(path)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._listener.bind(str(path))
        except OSError:
            self._listener.close()
            raise
        path.chmod(0o600)
        self._listener.listen()
        self._listener.setblocking(False)
        loop.add_reader(self._listener.fileno(), self._accept)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            client, _ = self._listener.accept()
            client.settimeout(1.0)  # a client that does not read its answer is dropped
            self._clients[client.fileno()] = (client, bytearray())
            self._loop.add_reader(client.fileno(), lambda: self._serve(client))

    def _serve(self, client: socket.socket) -> None:
        buffer = self._clients[client.fileno()][1]
        try:
            data = client.recv(4096)
            buffer += data
            if not data or len(buffer) > LONGEST_REQUEST:
                self._drop(client)
                return
            while (end := buffer.find(b"\n")) >= 0:
                line = bytes(buffer[:end])
                del buffer[: end + 1]
                client.sendall(self._control.do_line(line))
        except OSError:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        self._loop.remove_reader(client.fileno())
        del self._clients[client.fileno()]
        client.close()

    def close(self) -> None:
        """End every connection and remove the socket."""
        for client, _ in list(self._clients.values()):
            self._drop(client)
        self._listener.close()
        with contextlib.suppress(FileNotFoundError):
            self._path.unlink()


def _clear_the_way(path: Path) -> None:
    """Remove a socket that a killed line left behind; OSError where a living one serves it."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
        else:
            raise FileExistsError(f"{path}: another simulated line is controlled by it")


def _line(answer: dict[str, Any]) -> bytes:
    return json.dumps(answer).encode() + b"\n"
