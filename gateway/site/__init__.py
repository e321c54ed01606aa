"""The site: configuration and catalogue put together, checked, ready to be run."""

from __future__ import annotations

from gateway.site.building import build, load
from gateway.site.margins import SERIAL_MARGIN, usual_margin
from gateway.site.parts import Drive, DriveGroup, Line, Point, PollGroup, Site

__all__ = [
    "SERIAL_MARGIN",
    "Drive",
    "DriveGroup",
    "Line",
    "Point",
    "PollGroup",
    "Site",
    "build",
    "load",
    "usual_margin",
]
