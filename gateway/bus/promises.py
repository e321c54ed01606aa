"""What is promised of the polls of a line: how late each is answered at the worst, and when all were done once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gateway import site
from gateway.bus import traffic
from gateway.bus.plan import plan_drive
from gateway.bus.response import Traffic
from gateway.bus.schedule import Schedule
from gateway.bus.station import Station
from gateway.bus.work import Work
from gateway.metrics import DriveStats, Responses


def predict(line: site.Line, drive_stats: Mapping[str, DriveStats]) -> float:
    """Reckon how late each poll is answered at the worst, as `check` does; return the share of all but polls."""
    plans = [plan_drive(drive, line, with_selectors=True) for drive in line.drives]
    worst = traffic.undisturbed(line, plans).worst
    disturbed = traffic.disturbed(line, plans).worst
    for plan in plans:
        for group, reads in plan.groups:
            if reads:
                responses = Responses(worst[group.period], disturbed[group.period])
                drive_stats[plan.drive.name].responses[group.period] = responses
    return traffic.beside(line, plans)


def turn(stations: Iterable[Station], schedule: Schedule[Work], beside: float) -> float:
    """Return in what time everything that is read as fast as possible is promised to be read once, in seconds.

    `beside` is the share of the line for all but polls.
    """
    polls = [
        stream
        for station in stations
        for stream in traffic.streams(station.planner, schedule.jobs(station.drive.name))
    ]
    return Traffic(polls, reserved=beside).turn
