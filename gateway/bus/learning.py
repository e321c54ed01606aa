"""What answers mean to a drive: its link, its image, what is done for it from now on, and what is said of it."""

from __future__ import annotations

import logging

from gateway.bus import promises
from gateway.bus.link import Heard
from gateway.bus.links import Links
from gateway.bus.schedule import Job
from gateway.bus.station import ServedLine, Station
from gateway.bus.work import Learnt, Work

log = logging.getLogger("gateway.bus")


class Learning:
    """Puts what was learnt where it belongs; `beside` is the share of the line for all but polls."""

    def __init__(self, served: ServedLine, links: Links, beside: float) -> None:
        self._served = served
        self._links = links
        self._schedule = served.schedule
        self._clock = served.clock
        self._beside = beside

    def learn(self, station: Station, job: Job[Work], learnt: Learnt, done: float | None = None) -> None:
        """Put what an answer brought where it belongs: link, image, schedule, log."""
        now = self._clock.now() if done is None else done
        self._tell(station, learnt)
        self._schedule.done(job, now)
        if learnt.stranger:
            self._links.hear(station, Heard.STRANGER, learnt.stranger)
            self.ask_again(station, job, now)
            return
        self._links.hear(station, Heard.REPLY)
        if learnt.is_ready:
            self._ready(station)
        if learnt.words:
            station.image.apply(learnt.words, now, self._clock.wall())
        station.image.set_reset_needed(station.reader.is_reset_needed)
        self._go_on(station, job, learnt, now)
        self.add(station, learnt, now)
        if now < station.quiet_until:
            self._schedule.hold(station.drive.name, station.quiet_until)

    def stopped(self, station: Station, now: float, written: str) -> None:
        """Take that a stop has written a register of a drive whose exchange is tried: the trial is put right."""
        learnt = station.reader.on_stop(now, written)
        self._tell(station, learnt)
        if learnt.is_ready:
            self._ready(station)
        if learnt.jobs is not None:
            self._set_jobs(station, learnt.jobs)

    def unanswered(self, station: Station, job: Job[Work], now: float) -> None:
        """Go on with a drive that did not answer, and is not lost."""
        self._schedule.done(job, now)
        learnt = station.reader.on_silence(job.work, now)
        self._tell(station, learnt)
        self._go_on(station, job, learnt, now)

    def ask_again(self, station: Station, job: Job[Work], started: float) -> None:
        """Try a drive that is not there, or is another one, from time to time, ever more seldom."""
        name, now = station.drive.name, self._clock.now()
        if self._schedule.is_probed(name):
            self._schedule.in_vain(job, started, now)
            job.work = station.reader.identify()
        else:
            self._schedule.probe(name, station.reader.identify(), now + self._served.line.probe_every)

    def add(self, station: Station, learnt: Learnt, now: float) -> None:
        """Plan what is to be done at once."""
        for work in learnt.once:
            self._schedule.add(Job(station.drive.name, work, None, now, now))

    def _ready(self, station: Station) -> None:
        """Take that the drive is known well enough to be believed."""
        reader = station.reader
        station.image.identity = reader.described
        station.image.bases = {
            base.name: base.decode(reader.facts[base.name])
            for base in station.drive.bases
            if base.name in reader.facts
        }
        self._links.hear(station, Heard.READY)

    def _go_on(self, station: Station, job: Job[Work], learnt: Learnt, now: float) -> None:
        """Do other jobs from now on, or what follows this one."""
        if learnt.jobs is not None:
            self._set_jobs(station, learnt.jobs)
        elif (later := station.reader.jobs.follow_up(job.work, now)) is not None:
            self._schedule.add(later)

    def _set_jobs(self, station: Station, jobs: list[Job[Work]]) -> None:
        """Do these for a drive from now on, and nothing else; its commands may go with its block, or no longer."""
        self._schedule.set_jobs(station.drive.name, jobs)
        self._schedule.turn = promises.turn(self._served.stations.values(), self._schedule, self._beside)
        if (control := self._served.control_of(station)) is not None:
            control.state.carrying.form = station.reader.form

    def _tell(self, station: Station, learnt: Learnt) -> None:
        for note in learnt.notes:
            log.info("%s: %s", station.drive.name, note)
        for warning in learnt.warnings:
            log.warning("%s: %s", station.drive.name, warning)
