"""A site with one drive, and a clock that is set by hand."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway import site

TEXT = """
[gateway]
name = "hall-3"
[[line]]
name = "a"
port = "/dev/null"
[[line.drive]]
name = "pump-1"
number = 1
model = "vf-nc3"
"""
NOWHERE: dict[str, str] = {}  # an environment that names no folder


def configured(folder: Path = Path(), **trace: Any) -> site.Site:
    """Return the site, its file in that folder."""
    return site.build(tomllib.loads(TEXT) | {"trace": trace}, "gateway.toml", folder)


@dataclass
class SetClock:
    """A clock that stands where it is set."""

    time: float = 1000.0

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.time

    def wall(self) -> float:
        """Return UTC seconds."""
        return 1_772_357_400.0 + self.time

    def alarm(self) -> Any:
        """Make no timer: nobody waits here."""
        raise NotImplementedError
