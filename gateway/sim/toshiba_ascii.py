"""The TOSHIBA protocol in ASCII from the drive's side: a request frame to an answer frame, or silence (E6581657 4).

Written from the manual alone and apart from the gateway's codec, so that the two can judge each other.
"""

from __future__ import annotations

import re

from gateway.sim.memory import Denial, Denied
from gateway.sim.registers import Registers
from gateway.sim.toshiba import CODES, ERROR, READ, WRITE_RAM, WRITE_STORED, checksum, letter

START = b"("
ANY = "*"  # stands for each digit of an inverter number (4.4)
HIGHEST_NUMBER = 99
DIGITS = 4  # of a word

# Digits are those of the manual's examples: upper case. A letter stands where the command is, known or not.
FORM = re.compile(
    rb"""\(
    (?P<number>[0-9*]{2})?
    (?P<command>[A-Za-z])
    (?P<address>[0-9A-F]{4})
    (?P<data>[0-9A-F]*)
    (?:&(?P<sum>[0-9A-F]{2}))?
    (?P<stop>\))?
    \r""",
    re.VERBOSE,
)

Request = re.Match[bytes]


def is_whole(frame: bytes) -> bool:
    """Say whether a frame has the form of a request, and its checksum, if there is one, is right."""
    request = _request(frame)
    return request is not None and _is_sum_right(request)


def answer(frame: bytes, number: int, registers: Registers) -> bytes | None:
    """Do what a frame asks, and return the answer; None where the drive keeps silent.

    Silence: a format error, another number, a group that another drive speaks for (4.1.1, 4.3, 4.4).
    """
    request = _request(frame)
    if request is None or not _is_for(request, number):
        return None
    is_tripped = registers.is_tripped  # as the frame came: the emergency stop is answered in upper case (4.2)
    try:
        word = _act(request, registers)
        body = letter(request["command"], is_tripped=is_tripped) + request["address"] + _digits(word)
    except Denied as denied:
        body = letter(ERROR, is_tripped=is_tripped) + _digits(CODES[denied.denial])
    return _framed(request, number, body) if _answers(request, number) else None


def _request(frame: bytes) -> Request | None:
    """Return a request that has the right form. A read has no data: digits stand in the place of the stop code."""
    request = FORM.fullmatch(frame)
    if request is None or (request["command"] == READ and request["data"]):
        return None
    return request


def _is_sum_right(request: Request) -> bool:
    """Check the sum from the start code to "&"; without one there is nothing to check."""
    if request["sum"] is None:
        return True
    return checksum(request.string[: request.start("sum")]) == int(request["sum"], 16)


def _is_for(request: Request, number: int) -> bool:
    """Say whether the drive is meant; a request without a number is for whoever hears it."""
    if request["number"] is None:
        return True
    if number > HIGHEST_NUMBER:
        return False
    own = f"{number:02d}"
    return all(digit in (ANY, mine) for digit, mine in zip(request["number"].decode(), own, strict=True))


def _answers(request: Request, number: int) -> bool:
    """Say whether the drive is the one that answers: with 0 in the place of each asterisk (4.4)."""
    asked: bytes | None = request["number"]
    return asked is None or asked.replace(ANY.encode(), b"0") == f"{number:02d}".encode()


def _act(request: Request, registers: Registers) -> int:
    """Do what is asked and return the word of the answer."""
    if not _is_sum_right(request):
        raise Denied(Denial.CHECKSUM)
    address, data = int(request["address"], 16), request["data"]
    if request["command"] == READ:
        return registers.read(address)
    write = {WRITE_STORED: registers.write_stored, WRITE_RAM: registers.write_ram}.get(request["command"])
    if write is None:
        raise Denied(Denial.COMMAND)
    if len(data) > DIGITS:
        raise Denied(Denial.RANGE)
    word = int(data or b"0", 16)
    write(address, word)
    return word


def _digits(word: int) -> bytes:
    return f"{word:04X}".encode()


def _framed(request: Request, number: int, body: bytes) -> bytes:
    """Return an answer that has the number, the checksum and the stop code if the request had them."""
    own = b"" if request["number"] is None else f"{number:02d}".encode()
    frame = START + own + body
    if request["sum"] is not None:
        frame += b"&"
        frame += f"{checksum(frame):02X}".encode()
    return frame + (request["stop"] or b"") + b"\r"
