"""What a drive and its values are said to be."""

from __future__ import annotations

import json
from typing import Any

from gateway.config import MqttSection
from gateway.image import Image
from gateway.mqtt.description import Description
from tests.mqtt import drives
from tests.mqtt.test_discovery import WATCHED, image

ROOT = "tosvert/hall-3/pump-1"


def described(found: Image, **settings: Any) -> dict[str, Any]:
    """Return the description of the first drive."""
    section = MqttSection.model_validate({"url": "mqtt://localhost", **settings})
    made: dict[str, Any] = json.loads(Description(found.drives[0], section, "hall-3").write())
    return made


def test_a_number_is_described_with_unit_scale_and_how_often_it_comes() -> None:
    """And where it stands."""
    filters = [{"values": ["output_frequency"], "deadband": 0.1, "min_interval": "1s"}]
    found = described(image(), filter=filters)["values"]["output_frequency"]
    assert found == {
        "title": "Output frequency",
        "kind": "monitor",
        "unit": "Hz",
        "decimals": 2,
        "scale": 0.01,
        "signed": False,
        "address": "FD00",
        "storage": "read_only",
        "poll": 0.2,
        "max_age": 1.0,
        "deadband": 0.1,
        "deadband_percent": 0.0,
        "min_interval": 1.0,
        "max_interval": 60.0,
        "topic": f"{ROOT}/output_frequency",
        "quality_topic": f"{ROOT}/output_frequency/quality",
        "state_key": "output_frequency",
    }


def test_codes_and_bits_are_described_in_words() -> None:
    """As their text topics say them."""
    values = described(drives.image())["values"]
    assert values["trip_code"]["texts"] == {"0": "no trip", "1": "OC1: overcurrent during acceleration"}
    assert values["status"]["bits"] == {"0": "running", "1": "reverse", "2": "tripped"}
    assert values["status"]["text_topic"] == f"{ROOT}/status_text"
    assert values["command"]["state_key"] == "command"
    assert values["command"]["topic"] == f"{ROOT}/command_value"


def test_a_derived_value_says_what_it_is_made_of() -> None:
    """Two registers, and where it has its unit from."""
    found = described(drives.image())["values"]["output_current"]
    assert (found["kind"], found["of"], found["base"]) == ("derived", "output_current_rate", "rated_current")
    assert (found["unit"], found["decimals"]) == ("A", 2)


def test_topics_and_keys_are_those_that_are_published() -> None:
    """By `publish`."""
    states = described(drives.image(), publish=["state"])["values"]["torque"]
    values = described(drives.image(), publish=["values"])["values"]["torque"]
    assert "topic" not in states
    assert "state_key" not in values


def test_what_control_permits_is_described() -> None:
    """For programs that offer it; nothing where nobody may command."""
    assert described(image())["control"] == {"mode": "off"}
    drive = {"control": "leased", "frequency": {"min": 5.0, "max": 50.0}, "on_loss": {"frequency": 10.0}, **WATCHED}
    found = described(image(drive))["control"]
    assert found["lease"] == 3.0
    assert found["on_loss"] == {"frequency": 10.0}
    assert found["frequency"] == {"min": 5.0, "max": 50.0, "step": 0.01, "unit": "Hz"}
    assert {"stop", "run", "take", "preset"} <= set(found["commands"])
    assert "speed" not in found["commands"]  # in min-1: refused where the limits are in Hz, and not in this model
    by_modbus = described(image({**drive, "sources": ["modbus-tcp"]}))["control"]
    assert by_modbus["sources"] == ["modbus-tcp"]
    assert "commands" not in by_modbus


def test_who_the_drive_is_comes_when_it_is_known() -> None:
    """The rest is known from the start."""
    found = image()
    section = MqttSection.model_validate({"url": "mqtt://localhost"})
    made = Description(found.drives[0], section, "hall-3")
    assert json.loads(made.write())["identity"] == {}
    found.drives[0].identity = {"device": "VFnC3"}
    assert json.loads(made.write())["identity"] == {"device": "VFnC3"}
    assert made.write() is made.write()
