"""The control of a simulated line: one JSON object a line in, one out, over a UNIX socket or from Python."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gateway.sim.drive import SimulatedDrive
from gateway.sim.faults import Fault, Kind
from gateway.sim.loop import LineLoop
from gateway.sim.settings import FaultSection, fault_of

LONGEST_REQUEST = 65_536  # bytes of one line


class WrongRequest(Exception):
    """A control request that cannot be done; the message says why."""


class Control:
    """Does what control requests ask of a running line."""

    def __init__(self, loop: LineLoop) -> None:
        self._loop = loop
        self._doings: dict[str, Callable[[dict[str, Any]], Any]] = {
            "stats": self._stats,
            "reset_stats": self._reset_stats,
            "state": self._state,
            "set": self._set,
            "force": self._force,
            "run": self._run,
            "trip": self._trip,
            "alarm": self._alarm,
            "power_cycle": self._power_cycle,
            "silence": self._silence,
            "fault": self._fault,
            "clear_faults": self._clear_faults,
            "babble": self._babble,
            "unplug": self._unplug,
            "plug": self._plug,
        }

    @property
    def requests(self) -> Sequence[str]:
        """Return what can be asked for."""
        return tuple(self._doings)

    def do(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do one request; the answer has `ok`, and `result` or `error`."""
        try:
            doing = self._doings.get(str(request.get("do")))
            if doing is None:
                raise WrongRequest(f"no such request; known: {', '.join(self.requests)}")
            return {"ok": True, "result": doing(request)}
        except WrongRequest as error:
            return {"ok": False, "error": str(error)}
        except KeyError as error:
            return {"ok": False, "error": f"missing or unknown: {error}"}
        except (ValueError, TypeError) as error:
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

    def _drive(self, request: dict[str, Any]) -> SimulatedDrive:
        """Return the drive of a request, by its number as it is now, ticked up to now."""
        number = request["drive"]
        for drive in self._loop.wire.drives:
            if drive.number == number:
                drive.tick(time.monotonic())
                return drive
        raise WrongRequest(f"no drive {number}; on the line: {[d.number for d in self._loop.wire.drives]}")

    def _stats(self, _request: dict[str, Any]) -> dict[str, Any]:
        return self._loop.statistics()

    def _reset_stats(self, _request: dict[str, Any]) -> None:
        self._loop.reset_statistics()

    def _state(self, request: dict[str, Any]) -> dict[str, Any]:
        drive = self._drive(request)
        condition, memory = drive.inverter.condition, drive.inverter.memory
        return {
            "number": drive.number,
            "model": drive.model.name,
            "frequency": condition.motor.frequency,
            "is_running": drive.inverter.is_running,
            "trip_code": int(condition.trip_code),
            "past_trips": list(condition.past_trips),
            "registers": {name: memory.word(name) for name in drive.model.registers},
            "eeprom_writes": {f"{address:04X}": count for address, count in memory.eeprom_writes.items()},
        }

    def _set(self, request: dict[str, Any]) -> None:
        self._drive(request).set_by_panel(str(request["register"]), int(request["value"]))

    def _force(self, request: dict[str, Any]) -> None:
        value = request.get("value")
        self._drive(request).force(str(request["register"]), None if value is None else int(value))

    def _run(self, request: dict[str, Any]) -> None:
        is_reverse = bool(request.get("reverse", False))
        self._drive(request).inverter.run_by_panel(float(request["frequency"]), is_reverse=is_reverse)

    def _trip(self, request: dict[str, Any]) -> None:
        self._drive(request).inverter.trip(int(request["code"]))

    def _alarm(self, request: dict[str, Any]) -> None:
        self._drive(request).inverter.condition.alarm = int(request["value"]) & 0xFFFF

    def _power_cycle(self, request: dict[str, Any]) -> None:
        drive = self._drive(request)
        drive.inverter.reset(time.monotonic(), off=float(request.get("seconds", 0.0)))

    def _silence(self, request: dict[str, Any]) -> None:
        drive = self._drive(request)
        self._loop.wire.faults.clear(drive.number, Kind.CUT)
        if request.get("on", True):
            self._loop.wire.faults.add(Fault(Kind.CUT, drive.number))

    def _fault(self, request: dict[str, Any]) -> None:
        keys = {key: value for key, value in request.items() if key not in ("do", "drive")}
        try:
            section = FaultSection.model_validate(keys)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise WrongRequest(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
        number = self._drive(request).number if "drive" in request else None
        self._loop.wire.faults.add(fault_of(section, number, time.monotonic()))

    def _clear_faults(self, request: dict[str, Any]) -> int:
        kind = Kind(request["kind"]) if "kind" in request else None
        return self._loop.wire.faults.clear(request.get("drive"), kind)

    def _babble(self, request: dict[str, Any]) -> None:
        self._loop.wire.babble(int(request.get("bytes", 5)), time.monotonic())

    def _unplug(self, _request: dict[str, Any]) -> None:
        self._loop.port.unplug()
        self._loop.wire.clear()

    def _plug(self, _request: dict[str, Any]) -> str:
        self._loop.port.plug()
        return self._loop.port.name


class ControlSocket:
    """The control behind a UNIX socket, served by the line's own loop."""

    def __init__(self, path: Path, loop: LineLoop) -> None:
        self._path = path
        self._loop = loop
        self._control = Control(loop)
        self._clients: dict[int, tuple[socket.socket, bytearray]] = {}
        _clear_the_way(path)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
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
