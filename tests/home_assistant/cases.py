"""Drives of every kind, as Home Assistant is told of them: what its own code is to take, and has taken."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from gateway import site
from gateway.config import MqttSection
from gateway.image import Image
from gateway.mqtt.discovery import Discovery
from gateway.site import Site

ACCEPTED = Path(__file__).with_name("accepted.json")
WATCHED = {"communication_timeout": "1.5s", "timeout_action": "stop", "lease": "3s"}
TORQUE = {"values": ["torque"], "every": "1s"}
DRIVES: list[dict[str, Any]] = [
    {"name": "shown", "model": "vf-nc3"},
    {"name": "direct", "model": "vf-nc3", "control": "direct", "frequency": {"min": 5.5, "max": 50.0}, **WATCHED},
    {"name": "leased", "model": "vf-mb1", "control": "leased", **WATCHED},
    {"name": "as3", "model": "vf-as3"},
    {"name": "blind.1", "model": "vf-mb1", "control": "direct", "poll": [TORQUE], **WATCHED},
    {"name": "all-nc3", "model": "vf-nc3", "control": "direct", **WATCHED},
    {"name": "all-mb1", "model": "vf-mb1", "control": "direct", **WATCHED},
]  # fmt: skip
FORMS: dict[str, dict[str, Any]] = {
    "hall-3": {"publish": ["values", "state"]},
    "hall-4": {"publish": ["state"], "home_assistant": {"enabled": True, "heartbeat": True}},
}


@cache
def plant() -> Site:
    """Return a site with all drives; those called all-... are read as far as their models go."""
    models = site.build(_table(DRIVES), "test", Path()).catalogue
    drives = []
    for drive in DRIVES:
        model = models[drive["model"]]
        names = [*model.registers, *(derived.name for derived in model.derived)]
        polled = {"poll": [{"values": names, "every": "1h"}]} if drive["name"].startswith("all-") else {}
        drives.append(drive | polled)
    return site.build(_table(drives), "test", Path())


def _table(drives: list[dict[str, Any]]) -> dict[str, Any]:
    numbered = [{**drive, "number": number} for number, drive in enumerate(drives, 1)]
    return {"gateway": {"name": "g"}, "line": [{"name": "a", "port": "/dev/null", "drive": numbered}]}


def messages() -> dict[str, str]:
    """Return what Home Assistant is told, by topic."""
    found = {}
    for gateway, form in FORMS.items():
        table = {"url": "mqtt://localhost", "home_assistant": {"enabled": True}, **form}
        made = Discovery(MqttSection.model_validate(table), gateway, Image(plant().drives))
        made.owe_everything()
        while made.is_owing:
            topic, text = made.next()
            found[topic] = text
    return found


def digest(text: str) -> str:
    """Return what a message comes to, whatever the gateway's version."""
    document = json.loads(text)
    del document["origin"]["sw_version"]
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def digests() -> dict[str, str]:
    """Return what all messages come to, by topic."""
    return {topic: digest(text) for topic, text in messages().items()}
