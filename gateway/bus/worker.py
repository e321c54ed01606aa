"""Serves one line: opens it, and lets its commands, keepalives and polls take turns.

What is sent is carried out, and finished, in `polls` and `command_frames`; what an answer means is put where it
belongs by `learning`, `links` and `trips`. They share the line as it is served (`station`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from gateway import site
from gateway.bus import promises
from gateway.bus.command_frames import CommandFrames
from gateway.bus.controls import FRAMES_IN_A_ROW, Broadcast
from gateway.bus.echo import LocalEcho
from gateway.bus.exchange import Exchanger
from gateway.bus.learning import Learning
from gateway.bus.line import SETTLE, Opener
from gateway.bus.link import Link
from gateway.bus.links import Links
from gateway.bus.polls import Polls
from gateway.bus.schedule import AHEAD, Job, NotBefore, Send
from gateway.bus.station import ServedLine, Station
from gateway.bus.trips import Trips
from gateway.clock import Clock
from gateway.control.composing import COMMAND
from gateway.control.drive_control import DriveControl
from gateway.errors import BadReply, LineDown, NoReply, Refused
from gateway.image import DriveImage, LinkState
from gateway.metrics import DriveStats, LineStats
from gateway.protocol.pdu import EVERY_DRIVE, WriteRam
from gateway.trace.record import Tap

log = logging.getLogger("gateway.bus")

REOPEN_FIRST = 0.5  # seconds; doubled up to the last
REOPEN_LAST = 10.0
IDLE_WAIT = 1.0  # seconds, when there is nothing to do at all


class LineWorker:
    """One request at a time on one line, for ever."""

    def __init__(
        self,
        line: site.Line,
        images: Mapping[str, DriveImage],
        stats: LineStats,
        drive_stats: Mapping[str, DriveStats],
        clock: Clock,
        opener: Opener,
        controls: Mapping[str, DriveControl] | None = None,
        count_stored: Callable[[str, int], None] | None = None,
        tap: Tap | None = None,
    ) -> None:
        self._line = line
        self._stats = stats
        self._clock = clock
        self._opener = opener
        self._tap = tap
        self._alarm = clock.alarm()
        self._opened_at = clock.now()
        self._is_rung = False  # since the next poll was chosen
        self._command_frames = 0  # sent in a row since the last poll
        served = ServedLine.of(line, images, stats, drive_stats, clock, controls or {})
        self._stations = served.stations
        self._controls = served.controls
        self._schedule = served.schedule
        self._links = Links(served)
        self._learning = learning = Learning(served, self._links, promises.predict(line, drive_stats))
        trips = Trips(served, learning)
        self._polls = Polls(served, self._links, learning, trips, count_stored)
        self._commands = CommandFrames(served, self._links, learning, trips)

    # ---- the port

    async def run(self) -> None:
        """Serve the line until cancelled; a lost port is opened again with back-off."""
        wait = REOPEN_FIRST
        try:
            while True:
                try:
                    await self._serve()
                except LineDown as error:
                    wait = REOPEN_FIRST if self._was_of_use else min(2 * wait, REOPEN_LAST)
                    self._down(str(error), wait)
                await self._alarm.wait_until(self._clock.now() + wait)
        finally:
            self._stats.is_up = False
            self._alarm.close()
            for station in self._stations.values():  # nobody reads any more: nothing is fresh
                station.image.set_link(LinkState.LINE_DOWN, "the gateway ends")

    def _down(self, reason: str, wait: float) -> None:
        if self._stats.is_up or not self._stats.errors["line_down"]:
            log.warning("line %s is down: %s; trying again every %.3g s and slower", self._line.name, reason, wait)
        self._stats.is_up = False
        self._stats.errors["line_down"] += 1
        self._controls.drop_broadcasts()
        for station in self._stations.values():
            self._links.line_lost(station, reason)

    @property
    def _was_of_use(self) -> bool:
        """Say whether a drive has answered since the port was opened; a server may accept, and close at once."""
        return any(station.stats.last_heard >= self._opened_at for station in self._stations.values())

    async def _serve(self) -> None:
        self._opened_at = self._clock.now()
        port = await self._opener(self._line, self._clock)
        try:
            await port.drain(SETTLE, 2 * SETTLE)
            self._stats.is_up = True
            self._stats.opened += 1
            self._stats.is_low_latency = port.is_low_latency
            log.info("line %s: %s is open, %d baud", self._line.name, self._line.port, self._line.baud)
            now = self._clock.now()
            for station in self._stations.values():
                station.link = Link()
                station.is_left_alone = False  # what its control wants is looked at before the first frame
                station.image.set_link(station.link.state, "not heard yet")
                self._schedule.probe(station.drive.name, station.reader.identify(), now)
            echo = LocalEcho(self._line.local_echo, self._line.name)
            exchanger = Exchanger(
                port, self._line.timing, self._line.margin, self._clock, self._stats, echo, self._tap
            )
            while True:
                await self._step(exchanger)
        finally:
            port.close()

    # ---- whose turn it is

    async def _step(self, exchanger: Exchanger) -> None:
        """Do the next thing: an exchange, or waiting for the next one's time."""
        now = self._clock.now()
        controls = self._controls
        controls.tick(now)
        for name, control in controls.controls.items():
            self._follow(self._stations[name], control, now)
        if (broadcast := controls.next_broadcast(now)) is not None:
            await self._tell_all(exchanger, broadcast)
        elif (commanded := controls.next_stop(now)) is not None:
            await self._commands.carry(exchanger, commanded)
        elif not controls.keepalive.lets_through(now) and (due := controls.next_due(now)) is not None:
            await self._keep_alive(exchanger, self._stations[due], now)
        elif (is_owed := self._owes_poll(now)) or (commanded := controls.next_command(now)) is None:
            self._command_frames = 0
            await self._poll(exchanger, now, is_owed=is_owed)
        else:
            self._command_frames += 1
            controls.keepalive.let_through(now)
            await self._commands.carry(exchanger, commanded)

    def _follow(self, station: Station, control: DriveControl, now: float) -> None:
        """Do for a drive what its control wants: leave it alone, begin anew, or send it nothing but a stop."""
        name = station.drive.name
        if control.is_quiet and not station.is_left_alone:
            self._links.begin_anew(station, control.loss.quiet_until, f"left alone: {control.reason}")
        elif control.state.needs_set_up:
            start_up = station.drive.model.times.start_up if control.resets.is_deaf else 0.0
            control.state.needs_set_up = control.resets.is_deaf = False
            self._links.begin_anew(station, now + start_up, control.reason)
        station.is_left_alone = control.is_quiet
        if control.is_exclusive:
            self._schedule.suspend(name)
        else:
            self._schedule.resume(name)

    def _owes_poll(self, now: float) -> bool:
        """Say whether a poll goes before the next command: whoever commands without end does not end the polling."""
        return self._command_frames >= FRAMES_IN_A_ROW and self._schedule.has_overdue(now)

    async def _tell_all(self, exchanger: Exchanger, broadcast: Broadcast) -> None:
        """Send a broadcast; whatever comes of it, every drive is read back by itself."""
        slowest = max(station.processing for station in self._stations.values())
        try:
            await exchanger.exchange(broadcast.codec, broadcast.request, slowest)
        except (NoReply, BadReply, Refused):
            self._stats.errors["bad_reply"] += 1
        for station in self._stations.values():
            if station.reader.is_on_trial:
                self._learning.stopped(station, self._clock.now(), COMMAND)

    async def _poll(self, exchanger: Exchanger, now: float, *, is_owed: bool = False) -> None:
        """Do what the schedule says: a poll, a probe, or waiting; instead of waiting, what is due for an F803.

        A poll that is owed goes before a command that comes within the gap.
        """
        wake = self._controls.next_time()
        found = self._schedule.next(now)
        if not isinstance(found, Send) and (due := self._controls.next_due(now)) is not None:
            await self._keep_alive(exchanger, self._stations[due], now)
            return
        match found:
            case Send(job):
                self._is_rung = False
                babble = await exchanger.ready()
                if not self._is_rung or is_owed:  # else a command came within the gap: it goes first
                    self._controls.keepalive.let_through(now)
                    await self._polls.exchange(exchanger, job, now, babble)
            case NotBefore(when):
                await self._alarm.wait_until(min(when, wake))
            case None:
                await self._alarm.wait_until(min(now + IDLE_WAIT, wake))

    async def _keep_alive(self, exchanger: Exchanger, station: Station, now: float) -> None:
        """Talk to a drive whose F803 would run out: about its command, a poll that is due, else about its status."""
        name = station.drive.name
        if (commanded := self._controls.next_of(name, now)) is not None:
            await self._commands.carry(exchanger, commanded)
            return
        is_held = now < station.quiet_until or not station.reader.is_set_up
        poll = None if is_held else self._schedule.most_urgent(name, now)
        if poll is not None and station.planner.cost(poll.work.request) <= station.turn:
            await self._polls.exchange(exchanger, poll, now)
            return
        work = station.reader.identify() if is_held else station.reader.glance()
        job = Job(name, work, None, now, AHEAD)
        self._schedule.add(job)
        await self._polls.exchange(exchanger, job, now)

    @property
    def is_settled(self) -> bool:
        """Say whether no exchange is being tried: whatever a trial wrote is as it was."""
        return not any(station.reader.is_on_trial for station in self._stations.values())

    # ---- its bell

    def ring(self) -> None:
        """Look again at what is to be done: a command has come."""
        self._is_rung = True
        self._alarm.ring()

    def announce(self, word: int) -> bool:
        """Have a command word broadcast ahead of everything, in every protocol of the line; say whether one can."""
        is_any = False
        for drive in self._line.drives:
            request = WriteRam(EVERY_DRIVE, drive.model.registers[COMMAND].address, word)
            is_any |= self._controls.announce(drive.codec, request)
        self.ring()
        return is_any
