"""Says what became of a command, what happened to a drive, and who may command it. Pure."""

from __future__ import annotations

import json
from collections.abc import Mapping

from gateway.control.command import Result
from gateway.control.drive_control import DriveControl
from gateway.mqtt.payload import timestamp
from gateway.mqtt.topics import EVENT, RESULT

__all__ = ["EVENT", "RESULT", "event", "result", "standing"]


def result(outcome: Result, wall: float) -> str:
    """Return what is published of a result; the words are those that the drive has on the line."""
    command = outcome.command
    return json.dumps(
        {
            "id": command.id,
            "drive": command.drive,
            "command": str(command.verb),
            "source": str(command.source),
            "status": str(outcome.status),
            "reason": str(outcome.reason),
            "text": outcome.text,
            "raw": dict(outcome.raw),
            "read_back": dict(outcome.read_back),
            "time": timestamp(wall),
        }
    )


def event(kind: str, reason: str, wall: float, more: Mapping[str, object] | None = None) -> str:
    """Return what is published of an event; `more` is what goes with it, as the code of a trip."""
    return json.dumps({"event": kind, "reason": reason, **(more or {}), "time": timestamp(wall)}, ensure_ascii=False)


def standing(control: DriveControl | None) -> str:
    """Return who may command a drive, as it stands now; None stands for a drive that nobody may command."""
    if control is None:
        return json.dumps({"mode": "off", "standing": None, "reason": "", "owner": None})
    owner = control.lease.owner
    return json.dumps(
        {
            "mode": "leased" if control.settings.is_leased else "direct",
            "standing": control.standing.value,
            "reason": control.reason,
            "owner": None if owner is None else str(owner),
        }
    )
