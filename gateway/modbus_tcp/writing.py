"""Writes under a drive's own unit: a request becomes a command with its own numbers, the result the answer."""

from __future__ import annotations

from gateway.control.command import Command, Result, Source, Verb
from gateway.control.door import Door
from gateway.control.settings import ControlSettings
from gateway.image import Missing
from gateway.modbus_tcp.codes import CODE_FOR, ExceptionCode, exception_of
from gateway.modbus_tcp.read_back import CommandedUnit
from gateway.modbus_tcp.requests import Malformed, WriteRequest, parse
from gateway.modbus_tcp.session import Reply

ANSWER_AT_MOST = 0.9  # seconds that a client waits: the shortest usual time-out of clients is 1 s


def patience(settings: ControlSettings) -> float:
    """Return how long a client may wait for its answer, in seconds.

    Half a lease is left to a controller with one connection, to go on with its heartbeat.
    """
    return min(ANSWER_AT_MOST, settings.lease / 2)


class DriveWriter:
    """Carries writes under a drive's unit to the door; `unit` is what 17H reads from."""

    def __init__(self, drive: str, door: Door, unit: CommandedUnit) -> None:
        self._drive = drive
        self._door = door
        self._unit = unit

    def write(self, pdu: bytes, source: Source, reply: Reply) -> float:
        """Begin a request; its answer comes when the drive has answered, and was read back."""
        control = self._door.controls.get(self._drive)
        if control is None:
            reply(ExceptionCode.ILLEGAL_FUNCTION)
            return 0.0
        now = self._door.clock.now()
        try:
            request = parse(pdu)
        except Malformed:
            reply(ExceptionCode.ILLEGAL_DATA_VALUE)
            return 0.0
        command = Command(
            self._drive,
            Verb.WORDS,
            source,
            now,
            now + control.settings.command_timeout,
            address=request.address,
            words=request.words,
        )
        is_mapped = request.read is None or self._unit.read(*request.read, now) is not Missing.UNMAPPED
        if not is_mapped and not control.state.admission.is_stop(command):
            reply(ExceptionCode.ILLEGAL_DATA_ADDRESS)
            return 0.0
        self._door.submit(command, lambda result: reply(self._answer(request, result)))
        return patience(control.settings)

    def _answer(self, request: WriteRequest, result: Result) -> bytes | ExceptionCode:
        self._unit.learn(result)  # what 17H reads next
        code = exception_of(result, self._unit.link)
        if code is not None:
            return code
        if request.read is None:
            return request.answer()
        words = self._unit.read(*request.read, self._door.clock.now())
        return CODE_FOR[words] if isinstance(words, Missing) else request.answer(words)
