"""Trips of the drives of a line: any answer may tell of one; signs that contradict each other are read again."""

from __future__ import annotations

import logging

from gateway.bus.learning import Learning
from gateway.bus.station import ServedLine, Station

log = logging.getLogger("gateway.bus")

TRIP_AGAIN = 1.0  # seconds between two looks at a trip code that the status contradicts


class Trips:
    """Knows of each drive's trip, by what its answers say."""

    def __init__(self, served: ServedLine, learning: Learning) -> None:
        self._served = served
        self._learning = learning

    def read(self, station: Station, words: list[tuple[int, int]], now: float, *, flag: bool | None) -> None:
        """Take the words of an answer, and what its form said of a trip; None where it says nothing."""
        station.trip_signs.update(station.drive.model.trip_signs(words))
        signs = station.trip_signs.values()
        self.told(station, any(signs) if signs and flag is None else flag, now)
        self._settle(station, now)

    def told(self, station: Station, is_tripped: bool | None, now: float) -> None:
        """Take what an answer said of a trip; at each change the trip code and the status are read at once."""
        if (control := self._served.control_of(station)) is not None:
            control.presence.on_trip(is_tripped)
        if is_tripped is None:
            return
        before, station.is_tripped = station.is_tripped, is_tripped
        if is_tripped and not before:
            log.warning("%s is tripped", station.drive.name)
        elif before and not is_tripped:
            log.info("%s is no longer tripped", station.drive.name)
        if is_tripped is station.image.is_tripped or not station.link.state.is_connected:
            return  # of one that is being set up, or is another drive, nothing is published yet
        station.image.set_tripped(is_tripped)
        if station.reader.is_set_up:
            self._learning.add(station, station.reader.jobs.on_trip(), now)

    def _settle(self, station: Station, now: float) -> None:
        """Have trip code and status read again where they differ: one of them is old."""
        if len(set(station.trip_signs.values())) < 2 or not station.reader.is_set_up:
            return
        if now >= station.trip_looked + TRIP_AGAIN:  # where they go on to disagree, not without end
            station.trip_looked = now
            self._learning.add(station, station.reader.jobs.on_trip(), now)
