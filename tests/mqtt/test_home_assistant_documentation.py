"""docs/home-assistant.md is true: its files load, its entities and settings are those of the code."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from gateway import site
from gateway.config import HomeAssistantSection, MqttSection
from gateway.image import Image
from gateway.mqtt import commands
from gateway.mqtt.discovery import Discovery
from gateway.mqtt.message import Beat, Message, Moment

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "home-assistant.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
FILES = [tomllib.loads(re.sub(r"^   ", "", text, flags=re.MULTILINE)) for text in BLOCKS]
VALUES = ["status", "output_frequency", "alarm", "trip_code"]


def entity_ids(**drive: Any) -> set[str]:
    """Return the entities of the documented drive."""
    watched = {"communication_timeout": "1.5s", "timeout_action": "stop", "lease": "3s"}
    poll = [{"values": VALUES, "every": "1s"}]
    made = {"name": "pump-1", "number": 1, "model": "vf-nc3", "poll": poll, **watched, **drive}
    table = {"gateway": {"name": "hall-3"}, "line": [{"name": "a", "port": "/dev/null", "drive": [made]}]}
    mqtt = {"url": "mqtt://localhost", "home_assistant": {"enabled": True, "heartbeat": True}}
    found = Discovery(MqttSection.model_validate(mqtt), "hall-3", Image(site.build(table, "test", Path()).drives))
    found.owe_everything()
    components = json.loads(found.next()[1])["components"]
    return {each["default_entity_id"] for each in components.values()}


def test_the_file_of_the_five_minutes_is_right() -> None:
    """As it stands there."""
    assert site.build(FILES[0], "page", Path()).drives[0].name == "pump-1"


def test_the_leased_drive_is_right() -> None:
    """Put into the first file."""
    leased = FILES[2]
    merged = {**FILES[0], "mqtt": {**FILES[0]["mqtt"], **leased["mqtt"]}}
    merged["line"] = [{**FILES[0]["line"][0], "drive": leased["line"]["drive"]}]
    assert site.build(merged, "page", Path()).drives[0].is_controlled


def test_every_setting_is_documented_with_its_default() -> None:
    """But for the one that turns it on."""
    shown = FILES[3]["mqtt"]["home_assistant"]
    assert HomeAssistantSection.model_validate(shown) == HomeAssistantSection(enabled=True)
    assert set(shown) == set(HomeAssistantSection.model_fields)


def test_every_documented_entity_is_told() -> None:
    """Of a drive that may be commanded in every way."""
    named = set(re.findall(r"`([a-z_]+\.pump_1_[a-z_0-9]+)`", PAGE))
    assert len(named) > 15
    assert named <= entity_ids(control="leased") | entity_ids(control="direct")


def test_the_documented_heartbeat_is_one_of_the_owner() -> None:
    """Under the name that the commands have."""
    payload = re.findall(r"payload: '(.*)'", PAGE)[0].replace("{{ now().timestamp() }}", "1772366400.5")
    topic = re.findall(r"topic: (\S+/heartbeat)", PAGE)[0]
    read = commands.read(Message("", payload.encode()), topic.split("/")[2:], Moment(0.0, 0.0, 1.0, 2.0))
    assert isinstance(read, Beat)
    assert (read.drive, read.source.name) == ("pump-1", HomeAssistantSection().source)


def test_the_example_offers_what_the_page_says() -> None:
    """One drive that is only shown, one that is commanded."""
    found = site.load(ROOT / "config" / "home-assistant.toml")
    assert [drive.is_controlled for drive in found.drives] == [False, True]
