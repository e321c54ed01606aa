"""What the tables of docs/protocols.md say of speed: exchanges by the line's arithmetic, whoever the master is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.protocol.codec import Codec
from gateway.protocol.modbus_rtu import ModbusRtu
from gateway.protocol.pdu import Exchange, ReadBlock, ReadWords, Request, WriteRam
from gateway.protocol.timing import LineTiming
from gateway.protocol.toshiba_ascii import ToshibaAscii
from gateway.protocol.toshiba_binary import ToshibaBinary

FIVE = (0xFD01, 0xFD00, 0xFD03, 0xFD05, 0xFC91)  # status, frequency, current, voltage, alarm
BLOCK = ReadBlock(1, 0x1875, len(FIVE))
SINGLES = tuple(ReadWords(1, address) for address in FIVE)
SETPOINT = (WriteRam(1, 0xFA01, 6000), WriteRam(1, 0xFA00, 0xC400))
EXCHANGE = Exchange(1, 0x1875, len(FIVE), 0x1870, (0xC400, 6000))
ASCII, BINARY, RTU = ToshibaAscii(), ToshibaBinary(), ModbusRtu()


@dataclass(frozen=True, slots=True)
class Form:
    """A way to do something: its exchanges, in a protocol."""

    codec: Codec
    requests: tuple[Request, ...]


@dataclass(frozen=True, slots=True)
class Condition:
    """A baud rate, and the seconds that the drive takes for itself."""

    baud: int
    processing: float


CONDITIONS = tuple(Condition(baud, processing) for baud in (19200, 38400) for processing in (0.005, 0.015))

FORMS: Mapping[str, Form] = {
    "TOSHIBA binary, block (X/Y)": Form(BINARY, (BLOCK,)),
    "MODBUS-RTU, block (03H at 1875H)": Form(RTU, (BLOCK,)),
    "TOSHIBA binary, five single reads (R)": Form(BINARY, SINGLES),
    "MODBUS-RTU, five single reads (03H)": Form(RTU, SINGLES),
    "TOSHIBA ASCII, five single reads (R)": Form(ASCII, SINGLES),
}
CYCLES: Mapping[str, Form] = {
    "TOSHIBA binary, X/Y": Form(BINARY, (EXCHANGE,)),
    "MODBUS-RTU, 17H": Form(RTU, (EXCHANGE,)),
    "TOSHIBA binary, P + P + X/Y": Form(BINARY, (*SETPOINT, BLOCK)),
    "MODBUS-RTU, 06H + 06H + 03H": Form(RTU, (*SETPOINT, BLOCK)),
    "TOSHIBA ASCII, P + P + five times R": Form(ASCII, (*SETPOINT, *SINGLES)),
}


def spoken(form: Form, condition: Condition) -> str:
    """Return exchanges a second, and how often a second the whole is done, as the page has it: 43.5 / 43.5."""
    timing = LineTiming(condition.baud)
    sizes = [(len(form.codec.encode(request)), form.codec.answer_size(request)) for request in form.requests]
    whole = sum(timing.exchange(request, answer, condition.processing) for request, answer in sizes)
    return f"{len(sizes) / whole:.1f} / {1 / whole:.1f}"
