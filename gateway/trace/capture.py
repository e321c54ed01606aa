"""Frames as a capture file: one interface a line, one packet a frame, with its times and its verdict as a comment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gateway import __version__
from gateway.trace import packets, pcapng
from gateway.trace.frames import Frame, Way
from gateway.trace.text import remark

APPLICATION = f"tosvert-gateway {__version__}"


class Capture:
    """Makes the bytes of one capture file, of lines that are known when it begins."""

    def __init__(self, lines: Sequence[str]) -> None:
        self._places = {name: place for place, name in enumerate(lines)}

    def begin(self, comment: str = "") -> bytes:
        """Return what the file begins with."""
        names = (pcapng.interface(name, "RS485 line") for name in self._places)
        return pcapng.section(APPLICATION, comment) + b"".join(names)

    def packets(self, frames: Iterable[Frame]) -> bytes:
        """Return the packets of frames; one of a line that is not known is left out."""
        return b"".join(self._packet(frame) for frame in frames if frame.line in self._places)

    def _packet(self, frame: Frame) -> bytes:
        place, is_request = self._places[frame.line], frame.way is Way.REQUEST
        data = packets.packet(
            place, frame.protocol, frame.data, is_request=is_request, is_whole=frame.is_well_formed
        )
        flags = pcapng.OUTBOUND if is_request else pcapng.INBOUND
        if not frame.is_well_formed:
            flags |= pcapng.CRC_ERROR
        return pcapng.packet(place, frame.end, data, flags, remark(frame))
