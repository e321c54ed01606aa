"""Says a request and its reply in words: the drive by its name, registers by theirs, values in their units."""

from __future__ import annotations

from collections.abc import Mapping

from gateway import site
from gateway.drives.register import Register
from gateway.protocol.pdu import (
    Exchange,
    Exchanged,
    Group,
    Identify,
    Identity,
    Proportional,
    ReadBlock,
    ReadWords,
    Reply,
    Request,
    Target,
    Words,
    WriteBlock,
    WriteRam,
    WriteStored,
    Written,
)


class Meaning:
    """What numbers mean on one line, by the drives that are configured there."""

    def __init__(self, line: site.Line | None = None) -> None:
        drives = () if line is None else line.drives
        self._names = {drive.number: drive.name for drive in drives}
        self._registers: Mapping[int, Mapping[int, Register]] = {
            drive.number: {register.address: register for register in drive.model.registers.values()}
            for drive in drives
        }

    def of_request(self, request: Request) -> str:
        """Return a request in words: "pump-1 read FD00 output_frequency"."""
        who, number = self._target(request.number), request.number
        match request:
            case ReadWords(_, address, 1):
                return f"{who} read {self._label(number, address)}"
            case ReadWords(_, address, count):
                return f"{who} read {count} from {self._label(number, address)}"
            case ReadBlock(_, address, count):
                return f"{who} read block of {count}"
            case WriteRam(_, address, word):
                return f"{who} write {self._label(number, address)} = {word:04X}"
            case WriteStored(_, address, word):
                return f"{who} write stored {self._label(number, address)} = {word:04X}"
            case WriteBlock(_, _, words):
                return f"{who} write block {_hex(words)}"
            case Exchange(_, _, count, _, words):
                return f"{who} write block {_hex(words)}, read block of {count}"
            case Identify():
                return f"{who} identify"
            case Proportional(_, address, word):
                return f"{who} proportional {address:04X} = {word:04X}"
        return who

    def of_reply(self, request: Request, reply: Reply) -> str:
        """Return a reply in words: "pump-1 output_frequency 60.00 Hz"."""
        who = self._target(request.number)
        tripped = " (tripped)" if reply.is_tripped else ""
        match reply:
            case Words(words):
                said = _hex(words)
                if isinstance(request, ReadWords):
                    said = self._values(request.number, request.address, words)
            case Exchanged(words, failed):
                said = f"{_hex(words)}{_not_written(failed)}"
            case Written(failed):
                said = f"written{_not_written(failed)}"
            case Identity(vendor, device, version):
                said = f"{vendor} {device} {version}"
        return f"{who} {said}{tripped}"

    def _target(self, number: Target) -> str:
        if isinstance(number, Group):
            return str(number)
        if number is None:
            return "drive"
        return self._names.get(number, f"number {number}")

    def _register(self, number: Target, address: int) -> Register | None:
        return self._registers.get(number, {}).get(address) if isinstance(number, int) else None

    def _label(self, number: Target, address: int) -> str:
        register = self._register(number, address)
        return f"{address:04X}" if register is None else f"{address:04X} {register.name}"

    def _values(self, number: Target, start: int, words: tuple[int, ...]) -> str:
        return ", ".join(self._value(number, address, word) for address, word in enumerate(words, start))

    def _value(self, number: Target, address: int, word: int) -> str:
        register = self._register(number, address)
        if register is None:
            return f"{word:04X}"
        if register.bits or register.enumeration is not None:
            return f"{register.name} {word:04X}"
        return f"{register.name} {register.format(word)} {register.unit}".rstrip()


def _hex(words: tuple[int, ...]) -> str:
    return " ".join(f"{word:04X}" for word in words)


def _not_written(failed: tuple[int, ...]) -> str:
    return f", not written: {', '.join(str(place + 1) for place in failed)}" if failed else ""
