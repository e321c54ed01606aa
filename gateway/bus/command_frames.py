"""Frames of commands on one line: sent as a drive's control wants them, with its block where that takes less time."""

from __future__ import annotations

import logging
from dataclasses import replace

from gateway.bus.controls import Commanded
from gateway.bus.exchange import Answered, Exchanger
from gateway.bus.learning import Learning
from gateway.bus.link import Heard
from gateway.bus.links import Links
from gateway.bus.schedule import Job
from gateway.bus.station import ServedLine, Station
from gateway.bus.trips import Trips
from gateway.control.composing import COMMAND
from gateway.control.drive_control import DriveControl
from gateway.control.state import Errand
from gateway.errors import BadReply, NoReply, Refusal, Refused, TooLate
from gateway.image import LinkState
from gateway.protocol.pdu import Exchange, Exchanged, ReadWords, Words, WriteStored

log = logging.getLogger("gateway.bus")


class CommandFrames:
    """Carries out one frame of a command after another, and tells the drive's control what came of it."""

    def __init__(self, served: ServedLine, links: Links, learning: Learning, trips: Trips) -> None:
        self._served = served
        self._links = links
        self._learning = learning
        self._trips = trips
        self._clock = served.clock

    async def carry(self, exchanger: Exchanger, commanded: Commanded) -> None:
        """Carry out one frame of a command, or a look for it."""
        station, control = self._served.stations[commanded.drive], self._served.controls.controls[commanded.drive]
        errand = self._with_block(station, control, commanded.errand)
        request = errand.request
        control.errands.sending(errand)
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
            control.errands.on_too_late(errand, self._clock.now())
        except (NoReply, BadReply) as error:
            self._unanswered(station, control, errand, error)
        except Refused as refused:
            self._refused(station, control, errand, refused)
        else:
            self._carried(station, control, errand, answered)
        if station.reader.is_on_trial and not isinstance(request, ReadWords):
            written = errand.execution.write.register.name if errand.execution is not None else COMMAND
            self._learning.stopped(station, self._clock.now(), written)
        self._links.watch(station)

    def _with_block(self, station: Station, control: DriveControl, errand: Errand) -> Errand:
        """Let a command go with the read of the block where that takes less time than both by themselves."""
        execution, planner, now = errand.execution, station.planner, self._clock.now()
        found = control.state.carrying.carried(execution) if execution is not None else None
        if execution is None or found is None:
            return errand
        exchange, count = found
        alone = sum(planner.cost(write.request) for write in execution.ahead[:count])
        poll = self._served.block_poll(station)
        if poll is not None and poll.may_begin(now):
            alone += planner.cost(poll.work.request)
        if planner.cost(exchange) >= alone:
            return errand
        execution.batch = count
        return replace(errand, request=exchange)

    def _unanswered(self, station: Station, control: DriveControl, errand: Errand, error: NoReply | BadReply) -> None:
        """Take silence, or garbage; a drive that is no longer there is tried from time to time."""
        self._links.missed(station, error)
        self._links.hear(station, Heard.SILENCE, str(error))
        control.errands.on_silence(errand, str(error), self._clock.now())
        schedule, name = self._served.schedule, station.drive.name
        if station.link.state is LinkState.OFFLINE and not schedule.is_probed(name):
            station.forget()
            when = self._clock.now() + self._served.line.probe_every
            schedule.probe(name, station.reader.identify(), when)

    def _refused(self, station: Station, control: DriveControl, errand: Errand, refused: Refused) -> None:
        """Take a refusal of a command's frame; a wrong checksum says that it was damaged on its way."""
        now = self._clock.now()
        self._served.stats.errors["refused"] += 1
        station.stats.refusals += 1
        self._lives(station, now, is_good=False)
        self._trips.told(station, refused.is_tripped, now)
        if refused.reason in (Refusal.CHECKSUM, Refusal.OTHER):
            control.errands.on_silence(errand, str(refused), now)
        elif errand.execution is not None and isinstance(errand.request, Exchange):
            if control.state.carrying.was_refused(errand.execution, refused, now):
                log.warning("%s: commands go in frames of their own: %s", station.drive.name, refused)
                station.reader.give_up_exchange()
        else:
            control.errands.on_refused(errand, refused, now)

    def _carried(self, station: Station, control: DriveControl, errand: Errand, answered: Answered) -> None:
        """Take the answer to a command's frame: what was read back is seen at once."""
        reply, request = answered.reply, errand.request
        if reply is not None:
            station.stats.answers.observe(answered.done - answered.sent)
            self._lives(station, answered.done)
            self._trips.told(station, reply.is_tripped, answered.done)
            if isinstance(request, ReadWords) and isinstance(reply, Words):
                pairs = list(enumerate(reply.words, request.address))
                station.image.apply(pairs, answered.done, self._clock.wall())
        control.errands.on_reply(errand, reply, answered.done)
        if isinstance(reply, Exchanged):
            if reply.failed:
                log.warning("%s: commands go in frames of their own: not written by the exchange", station.drive.name)
                control.state.carrying.form = None
                station.reader.give_up_exchange()
            self._read_along(station, reply, answered.done)

    def _lives(self, station: Station, now: float, *, is_good: bool = True) -> None:
        """Take a sign of life: silences before it are no longer in a row; who is there, only reads can tell."""
        self._links.note(station, now, is_good=is_good)
        if station.link.state.is_connected:
            self._links.hear(station, Heard.REPLY)

    def _read_along(self, station: Station, reply: Exchanged, done: float) -> None:
        """Take the block that came with a command as the poll that was due, or as one more."""
        poll = self._served.block_poll(station)
        if poll is None or not station.link.state.is_connected:
            return
        job = poll if poll.may_begin(done) else Job(poll.drive, poll.work, None, done, done)
        if job is poll and job.period in station.stats.responses:
            asked_since = job.due if job.period else job.waits_since
            station.stats.responses[job.period].observe(done - asked_since)
        station.vain = 0
        words = Words(reply.words, reply.is_tripped)
        learnt = station.reader.on_reply(poll.work, words, done)
        self._learning.learn(station, job, learnt, done)
        self._trips.read(station, learnt.words, done, flag=reply.is_tripped)
