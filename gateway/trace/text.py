"""Frames as lines of text: for a terminal, for a packet's comment, and for the log."""

from __future__ import annotations

from datetime import UTC, datetime

from gateway.trace.frames import Frame, Way
from gateway.trace.record import Record, Told, Unasked, Verdict

PLAIN = (Verdict.ANSWERED,)  # goes without saying of an answer


def time_of(seconds: float) -> str:
    """Return UTC seconds as text, to the microsecond."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def bytes_of(frame: Frame) -> str:
    """Return a frame's bytes: as text where they are TOSHIBA ASCII, else in hexadecimal."""
    body = frame.data.removesuffix(b"\r")
    if frame.protocol == "toshiba-ascii" and body.startswith(b"(") and body.isascii() and body.decode().isprintable():
        return body.decode()
    return frame.data.hex(" ").upper()


def remark(frame: Frame) -> str:
    """Return what a frame is, its times and its verdict: "pump-1 read FD00, gap 2.01 ms: answered"."""
    times = []
    if frame.gap is not None:
        times.append(f"gap {1000 * frame.gap:.2f} ms")
    if frame.after is not None:
        times.append(f"{1000 * frame.after:.2f} ms after the request")
    said = ", ".join(part for part in (frame.meaning, *times) if part)
    if frame.way is Way.ANSWER and frame.verdict in PLAIN:
        return said
    verdict = f"{frame.verdict.value}: {frame.note}" if frame.note else frame.verdict.value
    return f"{said}: {verdict}" if said else verdict


def line_of(frame: Frame) -> str:
    """Return a frame as a line for a terminal; control characters in it are none."""
    return f"{time_of(frame.end)} {frame.line} {frame.way.value} {bytes_of(frame)}  {remark(frame)}"


def pieces_of(line: str, told: Told) -> list[str]:
    """Return what was on the wire piece by piece, in hexadecimal, times from the beginning of the request."""
    if isinstance(told, Unasked):
        return [f"{line} rx {told.data.hex(' ').upper()} between two exchanges"]
    return [f"{line} tx {told.frame.hex(' ').upper()}", *_received(line, told)]


def _received(line: str, told: Record) -> list[str]:
    return [
        f"{line} rx {data.hex(' ').upper()} at {1000 * (when - told.begun):.2f} ms"
        for when, data in told.heard.pieces
    ]
