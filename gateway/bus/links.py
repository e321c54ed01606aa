"""The links of a line to its drives: what is heard of them, counted, watched over, and told to their controls."""

from __future__ import annotations

import logging

from gateway.bus.link import Heard, Link
from gateway.bus.refresh import unkept
from gateway.bus.station import ServedLine, Station
from gateway.errors import BadReply, NoReply
from gateway.image import LinkState

log = logging.getLogger("gateway.bus")


class Links:
    """Takes what was heard of a drive, or was not."""

    def __init__(self, served: ServedLine) -> None:
        self._served = served
        self._keepalive = served.controls.keepalive
        self._clock = served.clock

    # ---- links

    def hear(self, station: Station, heard: Heard, reason: str = "") -> None:
        """Take what an exchange came to: the link may be another one then, and the drive's control is told."""
        before = station.link.state
        state = station.link.hear(heard)
        if state is not before:
            is_trouble = state in (LinkState.OFFLINE, LinkState.STRANGER)
            level = logging.WARNING if is_trouble else logging.INFO
            log.log(level, "%s is %s%s", station.drive.name, state.word, f": {reason}" if reason else "")
        if station.is_lost:
            station.is_tripped = None
        station.image.set_link(state, reason)
        self._tell_control(station, reason, is_reply=heard is Heard.REPLY)

    def line_lost(self, station: Station, reason: str) -> None:
        """Take that the port is gone: nothing that was read is fresh, and the drive has to be found anew."""
        station.forget()
        station.image.set_link(station.link.hear(Heard.LINE_LOST), reason)
        self._tell_control(station, reason)

    def begin_anew(self, station: Station, when: float, reason: str) -> None:
        """Send a drive nothing before that time, not even a read; then identify and observe it."""
        station.forget()
        station.link = Link(LinkState.OFFLINE)
        station.image.set_link(LinkState.OFFLINE, reason)
        self._tell_control(station, reason)
        self._served.schedule.probe(station.drive.name, station.reader.identify(), when)

    # ---- signs of life

    def note(self, station: Station, now: float, *, is_good: bool = True) -> None:
        """Take note of an answer; nothing says that one with an error starts the drive's F803 anew."""
        stats = station.stats
        if stats.last_heard > 0:
            gap = now - stats.last_heard
            stats.longest_gap = max(stats.longest_gap, gap)
            if stats.communication_timeout > 0:
                stats.least_margin = min(stats.least_margin, stats.communication_timeout - gap)
        stats.last_heard = now
        if is_good:
            self._keepalive.heard(station.drive.name, now)

    def missed(self, station: Station, error: NoReply | BadReply) -> None:
        """Count an exchange that came to nothing."""
        self._keepalive.missed(station.drive.name)
        is_silence = isinstance(error, NoReply)
        self._served.stats.errors["no_reply" if is_silence else "bad_reply"] += 1
        if is_silence:
            station.stats.timeouts += 1
        else:
            station.stats.bad_replies += 1

    # ---- its control

    def _tell_control(self, station: Station, reason: str, *, is_reply: bool = False) -> None:
        """Let the drive's control know whether it may be commanded, how it is set, and whether it is tripped."""
        control = self._served.control_of(station)
        if control is None:
            return
        state, now = station.link.state, self._clock.now()
        if state.is_connected and station.reader.is_set_up:
            facts = station.reader.facts
            model = station.drive.model
            found = [(model.registers[name].address, word) for name, word in facts.items()]
            control.presence.on_online(facts, model.trip_signs(found), now)
        elif station.is_lost:
            control.presence.on_offline(reason, now)
        elif is_reply and not station.reader.is_doubtful:
            control.presence.on_heard(now)
        self.watch(station)

    def watch(self, station: Station) -> None:
        """Watch over a drive's F803 as it is known now, and say so where it cannot be kept on this line."""
        served, name = self._served, station.drive.name
        timeout = served.controls.watch(name)
        if timeout in (0.0, station.stats.communication_timeout):
            return
        station.stats.communication_timeout = timeout
        if trouble := unkept(served.line, served.worst, name, timeout):
            log.warning("%s: its F803 may run out when much happens at once: %s", name, trouble)
