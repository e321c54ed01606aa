"""Serves one line: opens it, carries out what the schedule says, and finishes every request in one place."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace

from gateway import site
from gateway.bus import traffic
from gateway.bus.blocks import Planner
from gateway.bus.controls import Broadcast, Commanded, LineControls
from gateway.bus.echo import LocalEcho
from gateway.bus.exchange import Answered, Exchanger
from gateway.bus.keepalive import Keepalive
from gateway.bus.line import Line
from gateway.bus.link import Heard, Link
from gateway.bus.plan import plan_drive
from gateway.bus.reader import DriveReader, phases
from gateway.bus.refresh import turn, unkept, worst_case
from gateway.bus.response import Traffic
from gateway.bus.schedule import AHEAD, Job, NotBefore, Schedule, Send
from gateway.bus.work import Learnt, Task, Work
from gateway.clock import Clock
from gateway.control.composing import COMMAND
from gateway.control.drive_control import DriveControl
from gateway.control.state import Errand
from gateway.errors import BadReply, LineDown, NoReply, Refusal, Refused, TooLate
from gateway.image import DriveImage, LinkState
from gateway.metrics import DriveStats, LineStats, Responses
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Exchanged,
    ReadBlock,
    ReadWords,
    Request,
    Words,
    WriteRam,
    WriteStored,
)
from gateway.trace.record import Tap

log = logging.getLogger("gateway.bus")

REOPEN_FIRST = 0.5  # seconds; doubled up to the last
REOPEN_LAST = 10.0
SETTLE = 0.1  # seconds of silence after opening: half a frame of whoever spoke before is let go
LATE_AT_MOST = 0.4  # seconds after a time-out in which the old answer may still come, twice the margin at least
TRIP_AGAIN = 1.0  # seconds between two looks at a trip code that the status contradicts
IN_VAIN = 3  # polls without an answer in a row, from which on a drive is asked more seldom
COMMAND_FRAMES = 2  # in a row, a write and its read-back, behind which a poll that is overdue goes first
IDLE_WAIT = 1.0  # seconds, when there is nothing to do at all

LOST = (LinkState.OFFLINE, LinkState.STRANGER, LinkState.LINE_DOWN)

Opener = Callable[[site.Line, Clock], Awaitable[Line]]


class _Station:
    """One drive as this line serves it: its reader, its link, and where its values and counts go."""

    def __init__(
        self, drive: site.Drive, image: DriveImage, stats: DriveStats, planner: Planner, reader: DriveReader
    ) -> None:
        self.drive = drive
        self.image = image
        self.stats = stats
        self.planner = planner
        self.reader = reader
        self.link = Link()
        self.vain = 0  # polls without an answer in a row, whoever it says it is
        self.trip_looked = float("-inf")  # when the trip code was read anew because the status says otherwise
        self.trip_signs: dict[str, bool] = {}  # MODBUS-RTU: by FC90, and by the bit in FD01
        self.is_left_alone = False  # by its control, so that its own time-out acts
        self.quiet_until = float("-inf")  # nothing but identifications before: a late answer might be believed
        self.turn = 0.0  # seconds that a keepalive exchange may take, where it is commanded
        self.processing = drive.model.times.processing + drive.wait_time

    def processing_of(self, request: Request) -> float:
        """Return how long the drive may take for a request, in seconds: longer for a write to its EEPROM."""
        if isinstance(request, WriteStored):
            return self.drive.model.times.eeprom + self.drive.wait_time
        return self.processing


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
        self._tap = tap
        self._count_stored = count_stored
        self._is_rung = False  # since the next poll was chosen
        self._command_frames = 0  # sent in a row since the last poll
        self._opened_at = clock.now()
        self._line = line
        own = {drive.name: controls[drive.name] for drive in line.drives if controls and drive.name in controls}
        self._worst = worst_case(line)
        self._controls = LineControls(own, Keepalive(self._worst.lead if own else 0.0))
        self._stats = stats
        self._clock = clock
        self._opener = opener
        self._alarm = clock.alarm()
        self._schedule: Schedule[Work] = Schedule(line.silent_share, line.probe_every, line.probe_at_most)
        self._stations: dict[str, _Station] = {}
        self._beside = self._predict(drive_stats)
        shifts = phases(line.drives)
        for place, drive in enumerate(line.drives):
            processing = drive.model.times.processing + drive.wait_time
            planner = Planner(drive.number, drive.model, drive.codec, line.timing, processing)
            reader = DriveReader(drive, planner, place, len(line.drives), shifts[drive.name])
            self._stations[drive.name] = _Station(drive, images[drive.name], drive_stats[drive.name], planner, reader)
            if drive.name in own:
                self._stations[drive.name].turn = turn(line, drive)

    def _predict(self, drive_stats: Mapping[str, DriveStats]) -> float:
        """Reckon how late each poll is answered at the worst, as `check` does; return the share of all but polls."""
        plans = [plan_drive(drive, self._line, with_selectors=True) for drive in self._line.drives]
        worst = traffic.undisturbed(self._line, plans).worst
        disturbed = traffic.disturbed(self._line, plans).worst
        for plan in plans:
            for group, reads in plan.groups:
                if reads:
                    responses = Responses(worst[group.period], disturbed[group.period])
                    drive_stats[plan.drive.name].responses[group.period] = responses
        return traffic.beside(self._line, plans)

    @property
    def _slowest(self) -> float:
        """Return how long the slowest drive takes for a request, in seconds."""
        return max(station.processing for station in self._stations.values())

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
            station.reader.forget()
            station.trip_signs.clear()
            station.image.set_link(station.link.hear(Heard.LINE_LOST), reason)
            self._tell_control(station, reason)

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
            await self._carry(exchanger, commanded)
        elif not controls.keepalive.lets_through(now) and (due := controls.next_due(now)) is not None:
            await self._keep_alive(exchanger, self._stations[due], now)
        elif (is_owed := self._owes_poll(now)) or (commanded := controls.next_command(now)) is None:
            self._command_frames = 0
            await self._poll(exchanger, now, is_owed=is_owed)
        else:
            self._command_frames += 1
            controls.keepalive.let_through(now)
            await self._carry(exchanger, commanded)

    def _owes_poll(self, now: float) -> bool:
        """Say whether a poll goes before the next command: whoever commands without end does not end the polling."""
        return self._command_frames >= COMMAND_FRAMES and self._schedule.has_overdue(now)

    async def _tell_all(self, exchanger: Exchanger, broadcast: Broadcast) -> None:
        """Send a broadcast; whatever comes of it, every drive is read back by itself."""
        try:
            await exchanger.exchange(broadcast.codec, broadcast.request, self._slowest)
        except (NoReply, BadReply, Refused):
            self._stats.errors["bad_reply"] += 1

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
                    await self._exchange(exchanger, job, babble)
            case NotBefore(when):
                await self._alarm.wait_until(min(when, wake))
            case None:
                await self._alarm.wait_until(min(now + IDLE_WAIT, wake))

    async def _keep_alive(self, exchanger: Exchanger, station: _Station, now: float) -> None:
        """Talk to a drive whose F803 would run out: about its command, a poll that is due, else about its status."""
        name = station.drive.name
        if (commanded := self._controls.next_of(name, now)) is not None:
            await self._carry(exchanger, commanded)
            return
        is_held = now < station.quiet_until or not station.reader.is_set_up
        poll = None if is_held else self._schedule.most_urgent(name, now)
        if poll is not None and station.planner.cost(poll.work.request) <= station.turn:
            await self._exchange(exchanger, poll)
            return
        work = station.reader.identify() if is_held else station.reader.glance()
        job = Job(name, work, None, now, AHEAD)
        self._schedule.add(job)
        await self._exchange(exchanger, job)

    # ---- commands

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

    def _follow(self, station: _Station, control: DriveControl, now: float) -> None:
        """Do for a drive what its control wants: leave it alone, begin anew, or send it nothing but a stop."""
        name = station.drive.name
        if control.is_quiet and not station.is_left_alone:
            self._begin_anew(station, control.loss.quiet_until, f"left alone: {control.reason}")
        elif control.state.needs_set_up:
            start_up = station.drive.model.times.start_up if control.resets.is_deaf else 0.0
            control.state.needs_set_up = control.resets.is_deaf = False
            self._begin_anew(station, now + start_up, control.reason)
        station.is_left_alone = control.is_quiet
        if control.is_exclusive:
            self._schedule.suspend(name)
        else:
            self._schedule.resume(name)

    def _begin_anew(self, station: _Station, when: float, reason: str) -> None:
        """Send a drive nothing before that time, not even a read; then identify and observe it."""
        station.reader.forget()
        station.trip_signs.clear()
        station.link = Link(LinkState.OFFLINE)
        station.image.set_link(LinkState.OFFLINE, reason)
        self._tell_control(station, reason)
        self._schedule.probe(station.drive.name, station.reader.identify(), when)

    async def _carry(self, exchanger: Exchanger, commanded: Commanded) -> None:
        """Carry out one frame of a command, or a look for it."""
        station, control = self._stations[commanded.drive], self._controls.controls[commanded.drive]
        errand = self._with_block(station, control, commanded.errand)
        request = errand.request
        control.sending(errand)
        station.stats.exchanges += 1
        if isinstance(request, WriteStored):
            station.stats.eeprom_writes[request.address] += 1
        try:
            answered = await exchanger.exchange(
                station.drive.codec, request, station.processing_of(request), errand.not_after
            )
        except TooLate:
            station.stats.exchanges -= 1
            if isinstance(request, WriteStored):
                station.stats.eeprom_writes[request.address] -= 1
            control.on_too_late(errand, self._clock.now())
        except (NoReply, BadReply) as error:
            self._count(station, error)
            self._hear(station, Heard.SILENCE, str(error))
            control.on_silence(errand, str(error), self._clock.now())
            if station.link.state is LinkState.OFFLINE and not self._schedule.is_probed(station.drive.name):
                self._lost(station)
        except Refused as refused:
            self._carry_refused(station, control, errand, refused)
        else:
            self._carried(station, control, errand, answered)
        self._watch(station)

    def _with_block(self, station: _Station, control: DriveControl, errand: Errand) -> Errand:
        """Let a command go with the read of the block where that takes less time than both by themselves."""
        execution, planner, now = errand.execution, station.planner, self._clock.now()
        found = control.state.carrying.carried(execution) if execution is not None else None
        if execution is None or found is None:
            return errand
        exchange, count = found
        alone = sum(planner.cost(write.request) for write in execution.ahead[:count])
        poll = self._block_poll(station)
        if poll is not None and poll.may_begin(now):
            alone += planner.cost(poll.work.request)
        if planner.cost(exchange) >= alone:
            return errand
        execution.batch = count
        return replace(errand, request=exchange)

    def _block_poll(self, station: _Station) -> Job[Work] | None:
        """Return the poll of a drive's block."""
        jobs = self._schedule.jobs(station.drive.name)
        polls = (job for job in jobs if job.work.task is Task.POLL and isinstance(job.work.request, ReadBlock))
        return next(polls, None)

    def _read_along(self, station: _Station, reply: Exchanged, done: float) -> None:
        """Take the block that came with a command as the poll that was due, or as one more."""
        poll = self._block_poll(station)
        if poll is None or not station.link.state.is_connected:
            return
        job = poll if poll.may_begin(done) else Job(poll.drive, poll.work, None, done, done)
        words = Words(reply.words, reply.is_tripped)
        self._learn(station, job, station.reader.on_reply(poll.work, words, done), done)

    def _carry_refused(self, station: _Station, control: DriveControl, errand: Errand, refused: Refused) -> None:
        """Take a refusal of a command's frame; a wrong checksum says that it was damaged on its way."""
        now = self._clock.now()
        self._stats.errors["refused"] += 1
        station.stats.refusals += 1
        self._answered_command(station, now, is_good=False)
        self._trip(station, refused.is_tripped, now)
        if refused.reason in (Refusal.CHECKSUM, Refusal.OTHER):
            control.on_silence(errand, str(refused), now)
        elif errand.execution is not None and isinstance(errand.request, Exchange):
            control.state.carrying.was_refused(errand.execution, refused, now)
        else:
            control.on_refused(errand, refused)

    def _watch(self, station: _Station) -> None:
        """Watch over a drive's F803 as it is known now, and say so where it cannot be kept on this line."""
        timeout = self._controls.watch(station.drive.name)
        if timeout in (0.0, station.stats.communication_timeout):
            return
        station.stats.communication_timeout = timeout
        if trouble := unkept(self._line, self._worst, station.drive.name, timeout):
            log.warning("%s: its F803 may run out when much happens at once: %s", station.drive.name, trouble)

    def _carried(self, station: _Station, control: DriveControl, errand: Errand, answered: Answered) -> None:
        """Take the answer to a command's frame: what was read back is seen at once."""
        reply, request = answered.reply, errand.request
        if reply is not None:
            station.stats.answers.observe(answered.done - answered.sent)
            self._answered_command(station, answered.done)
            self._trip(station, reply.is_tripped, answered.done)
            if isinstance(request, ReadWords) and isinstance(reply, Words):
                pairs = list(enumerate(reply.words, request.address))
                station.image.apply(pairs, answered.done, self._clock.wall())
        control.on_reply(errand, reply, answered.done)
        if errand.execution is not None and isinstance(reply, Exchanged):
            self._read_along(station, reply, answered.done)

    def _answered_command(self, station: _Station, now: float, *, is_good: bool = True) -> None:
        """Take a sign of life: silences before it are no longer in a row; who is there, only reads can tell."""
        self._heard(station, now, is_good=is_good)
        if station.link.state.is_connected:
            self._hear(station, Heard.REPLY)

    def _lost(self, station: _Station) -> None:
        """Try a drive that is no longer there from time to time."""
        station.reader.forget()
        station.trip_signs.clear()
        when = self._clock.now() + self._line.probe_every
        self._schedule.probe(station.drive.name, station.reader.identify(), when)

    async def _exchange(self, exchanger: Exchanger, job: Job[Work], babble: BadReply | None = None) -> None:
        """Carry out one exchange; whatever comes of it is finished here and nowhere else.

        `babble` is why the line is not free for it: then nothing is sent, nor waited for a second time.
        """
        station = self._stations[job.drive]
        started = self._clock.now()
        station.stats.exchanges += 1
        asked_since = job.due if job.period else job.waits_since
        request = job.work.request
        if isinstance(request, WriteStored):
            station.stats.eeprom_writes[request.address] += 1
            if self._count_stored is not None:
                self._count_stored(job.drive, request.address)
        try:
            if babble is not None:
                raise babble
            answered = await exchanger.exchange(station.drive.codec, request, station.processing_of(request))
        except (NoReply, BadReply) as error:
            self._unanswered(station, job, error, started)
        except Refused as refused:
            self._refused(station, job, refused, started)
        else:
            if job.work.task is Task.POLL and job.period is not None and job.period in station.stats.responses:
                station.stats.responses[job.period].observe(answered.done - asked_since)
            self._answered(station, job, answered)

    def _refused(self, station: _Station, job: Job[Work], refused: Refused, started: float) -> None:
        """Take a refusal; one for a wrong checksum says that the request was damaged on its way."""
        if refused.reason is Refusal.CHECKSUM:
            self._unanswered(station, job, BadReply(str(refused)), started)
            return
        now = self._clock.now()
        station.stats.refusals += 1
        self._stats.errors["refused"] += 1
        self._heard(station, now, is_good=False)
        self._learn(station, job, station.reader.on_refused(job.work, refused, now))
        if station.link.state.is_connected:
            self._trip(station, refused.is_tripped, now)

    def _answered(self, station: _Station, job: Job[Work], answered: Answered) -> None:
        station.stats.answers.observe(answered.done - answered.sent)
        self._heard(station, answered.done)
        if job.work.task is not Task.IDENTIFY:
            station.vain = 0
        if answered.reply is not None:
            learnt = station.reader.on_reply(job.work, answered.reply, answered.done)
            self._learn(station, job, learnt, answered.done)
            if not learnt.stranger:
                flag = answered.reply.is_tripped
                station.trip_signs.update(station.drive.model.trip_signs(learnt.words))
                signs = station.trip_signs.values()
                told = any(signs) if signs and flag is None else flag
                self._trip(station, told, answered.done)
                self._settle_trip(station, answered.done)

    def _trip(self, station: _Station, is_tripped: bool | None, now: float) -> None:
        """Take what an answer said of a trip; at each change the trip code and the status are read at once."""
        if (control := self._controls.controls.get(station.drive.name)) is not None:
            control.on_trip(is_tripped)
        if is_tripped is None or is_tripped is station.image.is_tripped:
            return
        if is_tripped:
            log.warning("%s is tripped", station.drive.name)
        elif station.image.is_tripped is not None:
            log.info("%s is no longer tripped", station.drive.name)
        station.image.set_tripped(is_tripped)
        if station.reader.is_set_up:
            self._add(station.drive.name, station.reader.on_trip(), now)

    def _settle_trip(self, station: _Station, now: float) -> None:
        """Have trip code and status read again where they differ: one of them is old."""
        signs, name = station.trip_signs, station.drive.name
        if len(set(signs.values())) < 2 or not station.reader.is_set_up:
            return
        if now >= station.trip_looked + TRIP_AGAIN:  # where they go on to disagree, not without end
            station.trip_looked = now
            self._add(name, station.reader.on_trip(), now)

    def _heard(self, station: _Station, now: float, *, is_good: bool = True) -> None:
        """Take note of an answer; nothing says that one with an error starts the drive's F803 anew."""
        stats = station.stats
        if stats.last_heard > 0:
            gap = now - stats.last_heard
            stats.longest_gap = max(stats.longest_gap, gap)
            if stats.communication_timeout > 0:
                stats.least_margin = min(stats.least_margin, stats.communication_timeout - gap)
        stats.last_heard = now
        if is_good:
            self._controls.keepalive.heard(station.drive.name, now)

    def _learn(self, station: _Station, job: Job[Work], learnt: Learnt, done: float | None = None) -> None:
        """Put what an answer brought where it belongs: link, image, schedule, log."""
        now = self._clock.now() if done is None else done
        reader, name = station.reader, station.drive.name
        self._tell(name, learnt)
        self._schedule.done(job, now)
        if learnt.stranger:
            self._hear(station, Heard.STRANGER, learnt.stranger)
            self._ask_again(station, job, now)
            return
        self._hear(station, Heard.REPLY)
        if learnt.is_ready:
            station.image.identity = reader.described
            station.image.bases = {
                base.name: base.decode(reader.facts[base.name])
                for base in station.drive.bases
                if base.name in reader.facts
            }
            self._hear(station, Heard.READY)
        if learnt.words:
            station.image.apply(learnt.words, now, self._clock.wall())
        station.image.set_reset_needed(reader.is_reset_needed)
        if learnt.jobs is not None:
            self._set_jobs(station, learnt.jobs)
        else:
            self._follow_up(station, job, now)
        self._add(name, learnt, now)
        if now < station.quiet_until:
            self._schedule.hold(name, station.quiet_until)

    def _tell(self, drive: str, learnt: Learnt) -> None:
        for note in learnt.notes:
            log.info("%s: %s", drive, note)
        for warning in learnt.warnings:
            log.warning("%s: %s", drive, warning)

    def _add(self, drive: str, learnt: Learnt, now: float) -> None:
        """Plan what is to be done at once."""
        for work in learnt.once:
            self._schedule.add(Job(drive, work, None, now, now))

    def _ask_again(self, station: _Station, job: Job[Work], started: float) -> None:
        """Try a drive that is not there, or is another one, from time to time, ever more seldom."""
        name, now = station.drive.name, self._clock.now()
        if self._schedule.is_probed(name):
            self._schedule.in_vain(job, started, now)
            job.work = station.reader.identify()
        else:
            self._schedule.probe(name, station.reader.identify(), now + self._line.probe_every)

    def _follow_up(self, station: _Station, job: Job[Work], now: float) -> None:
        if (later := station.reader.follow_up(job.work, now)) is not None:
            self._schedule.add(later)

    def _set_jobs(self, station: _Station, jobs: list[Job[Work]]) -> None:
        """Do these for a drive from now on, and nothing else; its commands may go with its block, or no longer."""
        self._schedule.set_jobs(station.drive.name, jobs)
        self._schedule.turn = self._turn()
        if (control := self._controls.controls.get(station.drive.name)) is not None:
            control.state.carrying.offer(station.reader.exchange())

    def _turn(self) -> float:
        """Return in what time everything that is read as fast as possible is promised to be read once."""
        polls = [
            stream
            for name, station in self._stations.items()
            for stream in traffic.streams(station.planner, self._schedule.jobs(name))
        ]
        return Traffic(polls, reserved=self._beside).turn

    def _hear(self, station: _Station, heard: Heard, reason: str = "") -> None:
        before = station.link.state
        state = station.link.hear(heard)
        if state is not before:
            is_trouble = state in (LinkState.OFFLINE, LinkState.STRANGER)
            level = logging.WARNING if is_trouble else logging.INFO
            log.log(level, "%s is %s%s", station.drive.name, state.word, f": {reason}" if reason else "")
        station.image.set_link(state, reason)
        self._tell_control(station, reason, is_reply=heard is Heard.REPLY)

    def _tell_control(self, station: _Station, reason: str, *, is_reply: bool = False) -> None:
        """Let the drive's control know whether it may be commanded, how it is set, and whether it is tripped."""
        control = self._controls.controls.get(station.drive.name)
        if control is None:
            return
        state, now = station.link.state, self._clock.now()
        if state.is_connected and station.reader.is_set_up:
            facts = station.reader.facts
            model = station.drive.model
            found = [(model.registers[name].address, word) for name, word in facts.items()]
            control.on_online(facts, model.trip_signs(found), now)
        elif state in LOST:
            control.on_offline(reason, now)
        elif is_reply and not station.reader.is_doubtful:
            control.on_heard(now)
        self._watch(station)

    def _count(self, station: _Station, error: NoReply | BadReply) -> None:
        """Count an exchange that came to nothing."""
        self._controls.keepalive.missed(station.drive.name)
        is_silence = isinstance(error, NoReply)
        self._stats.errors["no_reply" if is_silence else "bad_reply"] += 1
        if is_silence:
            station.stats.timeouts += 1
        else:
            station.stats.bad_replies += 1

    def _pause(self, station: _Station, cost: float) -> float:
        """Return how long a drive is left alone that did not answer, in seconds: at first as a late answer may take.

        One that says who it is and answers nothing else would cost a time-out each time: the longer that goes on, the
        longer the pause, until all such drives together keep to the share of silent ones.
        """
        late = max(LATE_AT_MOST, 2 * self._line.margin)
        such = sum(other.vain >= IN_VAIN for other in self._stations.values())
        longest = max(late, such * cost / self._line.silent_share)
        return min(longest, late * 2.0 ** max(0, station.vain - IN_VAIN + 1))

    def _unanswered(self, station: _Station, job: Job[Work], error: NoReply | BadReply, started: float) -> None:
        """Count silence or garbage, and decide how the drive is tried next.

        The next request differs in form from the one without an answer (an identification), so that a late
        answer to the old one cannot be taken for its answer; and the drive is asked nothing else for a while.
        """
        now = self._clock.now()
        self._count(station, error)
        name = station.drive.name
        self._hear(station, Heard.SILENCE, str(error))
        is_lost = station.link.state in LOST
        if self._schedule.is_probed(name):
            self._ask_again(station, job, started)
        elif is_lost:
            station.reader.forget()
            station.trip_signs.clear()
            self._ask_again(station, job, started)
        else:
            station.vain += job.work.task is not Task.IDENTIFY
            station.quiet_until = now + self._pause(station, now - started)
            self._schedule.done(job, now)
            learnt = station.reader.on_silence(job.work, now)
            self._tell(name, learnt)
            if learnt.jobs is not None:
                self._set_jobs(station, learnt.jobs)
            else:
                self._follow_up(station, job, now)
            self._schedule.hold(name, station.quiet_until)
            self._schedule.add(Job(name, station.reader.identify(), None, now, AHEAD))
