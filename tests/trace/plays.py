"""Exchanges for tests, told as a line tells them."""

from __future__ import annotations

from gateway.protocol.pdu import ReadWords, Reply, Request, Words
from gateway.protocol.registry import PROTOCOLS
from gateway.trace.record import Hearing, Piece, Record, Verdict

READ = bytes.fromhex("01 03 FD 00 00 01 B5 A6")
ANSWER = bytes.fromhex("01 03 02 17 70 B6 50")
ASKED = ReadWords(1, 0xFD00)
GIVEN = Words((0x1770,))
MODBUS = PROTOCOLS["modbus-rtu"]


def hearing(*pieces: Piece, early: int = 0, ended: int | None = None) -> Hearing:
    """Return what was heard."""
    heard = Hearing()
    for when, data in pieces:
        heard.take(when, data)
    heard.early, heard.ended = early, ended
    return heard


def record(
    *pieces: Piece,
    verdict: Verdict = Verdict.ANSWERED,
    request: Request = ASKED,
    reply: Reply | None = None,
    note: str = "",
    early: int = 0,
    ended: int | None = None,
    begun: float = 10.0,
) -> Record:
    """Return one exchange, begun at 10 s; its request takes 5 ms and it is done 15 ms later."""
    heard = hearing(*pieces, early=early, ended=ended)
    frame = MODBUS.encode(request)
    return Record(MODBUS, request, frame, 0.0025, begun, begun + 0.005, begun + 0.02, heard, verdict, reply, note)


def answered(begun: float = 10.0) -> Record:
    """Return an exchange that went well."""
    return record((begun + 0.02, ANSWER), reply=GIVEN, begun=begun)
