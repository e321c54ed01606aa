"""The sections of the daemon itself: `[gateway]` with its log, `[web]`, `[store]` and `[trace]`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gateway.config.notation import Duration, Listen, TopicLevel, seconds
from gateway.config.section import Section


class LogSection(Section):
    """How the daemon logs."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["text", "json"] = "text"
    show: list[Literal["points", "frames", "bytes"]] = Field(
        [], description="shown in full at any level: values, frames in words, bytes on the wire"
    )


class GatewaySection(Section):
    """The gateway itself."""

    name: TopicLevel = Field(description="name of this gateway, a level of its topics")
    catalogue: list[str] = Field([], description="further catalogue files, relative to this file")
    log: LogSection = LogSection()
    loop: Literal["uvloop", "asyncio"] = "uvloop"


class WebSection(Section):
    """The web server: /healthz and /metrics."""

    listen: Listen = "127.0.0.1:8080"


class StoreSection(Section):
    """What outlives the process: EEPROM write counters and the audit of commands. Setpoints are never kept."""

    path: str | None = Field(
        None,
        min_length=1,
        description="SQLite file; by default state.sqlite in $STATE_DIRECTORY, else beside this file",
    )
    audit_rows: int = Field(100_000, ge=100, le=10_000_000, description="kept; the oldest go first")


class TraceSection(Section):
    """What is kept of the frames on the lines, and who may see them; see docs/trace.md."""

    frames: int = Field(2000, ge=0, le=100_000, description="latest frames in memory; 0: none are kept")
    serve: bool = Field(True, description="a UNIX socket for tosvert-gateway trace")
    socket: str | None = Field(
        None,
        min_length=1,
        description="its path; by default trace-<name>.sock in $RUNTIME_DIRECTORY, else beside this file",
    )
    on_fault: bool = Field(True, description="the latest frames are written to a file after a fault")
    directory: str | None = Field(
        None, min_length=1, description="of those files; by default traces in $STATE_DIRECTORY, else beside this file"
    )
    files: int = Field(10, ge=1, le=1000, description="kept there; the oldest go first")
    pause: Duration = Field(seconds("60s"), ge=0.1, le=86_400, description="between two of them at the least")
