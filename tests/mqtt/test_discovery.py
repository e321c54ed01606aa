"""What Home Assistant is told: stable identities, what control permits, and what is no more taken back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import site
from gateway.config import MqttSection
from gateway.image import Image
from gateway.mqtt import entities
from gateway.mqtt.discovery import BIRTH_PAUSE, LARGEST, Discovery, known_components
from gateway.mqtt.message import Message
from gateway.site import Site

ROOT = "tosvert/hall-3/pump-1"
NODE = "homeassistant/device/tosvert-hall-3"
CONFIG = f"{NODE}/pump-1/config"
BIRTH = "homeassistant/status"
WATCHED = {"communication_timeout": "1.5s", "timeout_action": "stop", "lease": "3s"}
RUNS = {"command/run", "command/direction", "command/arm", "command/reset", "set/frequency", "set/acceleration"}


def image(*drives: Mapping[str, Any]) -> Image:
    """Return the image of a line with these drives; one that nobody may command by default."""
    made = [{"number": n + 1, "model": "vf-nc3", "name": f"pump-{n + 1}", **d} for n, d in enumerate(drives or ({},))]
    return Image(built(json.dumps(made)).drives)


@cache
def built(drives: str) -> Site:
    """Return the site with these drives."""
    line = {"name": "a", "port": "/dev/null", "drive": json.loads(drives)}
    return site.build({"gateway": {"name": "hall-3"}, "line": [line]}, "test", Path())


def discovery(*drives: Mapping[str, Any], publish: Sequence[str] = ("values", "state"), **options: Any) -> Discovery:
    """Return the discovery of a gateway."""
    table = {"url": "mqtt://localhost", "publish": list(publish), "home_assistant": {"enabled": True, **options}}
    return Discovery(MqttSection.model_validate(table), "hall-3", image(*drives))


def told(made: Discovery) -> list[tuple[str, str]]:
    """Return all that is owed."""
    sent = []
    while made.is_owing:
        sent.append(made.next())
    return sent


def components(*drives: Mapping[str, Any], **options: Any) -> dict[str, Any]:
    """Return the components of the first drive."""
    made = discovery(*drives, **options)
    made.owe_everything()
    found: dict[str, Any] = json.loads(dict(told(made))[CONFIG])["components"]
    return found


def kept(payload: str, topic: str = CONFIG) -> Message:
    """Return a message that the broker kept."""
    return Message(topic, payload.encode(), is_retained=True)


def test_a_drive_is_one_device_with_origin_and_availability() -> None:
    """One message, on a topic of this gateway and drive."""
    made = discovery()
    made.owe_everything()
    [(topic, text)] = told(made)
    document = json.loads(text)
    assert topic == CONFIG
    assert document["device"]["identifiers"] == [ROOT]
    assert document["device"]["model"] == "TOSVERT VF-nC3"
    assert document["origin"]["name"] == "tosvert-gateway"
    assert document["availability"] == [{"topic": "tosvert/hall-3/status"}, {"topic": f"{ROOT}/availability"}]
    assert document["availability_mode"] == "all"


def test_identities_are_unique_and_say_gateway_drive_and_register() -> None:
    """They are the same at every start, since they come from the configuration alone."""
    found = components({"control": "direct", **WATCHED})
    ids = [each["unique_id"] for each in found.values()]
    assert len(set(ids)) == len(ids)
    assert found["output_frequency"]["unique_id"] == f"{ROOT}/output_frequency"
    assert found["output_frequency"]["default_entity_id"] == "sensor.pump_1_output_frequency"
    assert len({each["default_entity_id"] for each in found.values()}) == len(ids)
    assert found == components({"control": "direct", **WATCHED})


def test_numbers_have_unit_class_and_precision() -> None:
    """By their unit; a count only grows."""
    found = components()
    frequency = found["output_frequency"]
    assert frequency["unit_of_measurement"] == "Hz"
    assert frequency["device_class"] == "frequency"
    assert frequency["state_class"] == "measurement"
    assert frequency["suggested_display_precision"] == 2
    assert found["cumulative_operation_time"]["state_class"] == "total_increasing"
    assert "device_class" not in found["output_current"]  # in per cent


@pytest.mark.hazard("H19")
def test_a_value_that_is_not_good_is_unavailable() -> None:
    """By its quality, or by the null of the state where the values have no topics."""
    for_value = components()["output_frequency"]["availability"]
    assert [each["topic"] for each in for_value] == ["tosvert/hall-3/status", f"{ROOT}/output_frequency/quality"]
    assert "value == 'good'" in for_value[1]["value_template"]
    of_state = components(publish=("state",))["output_frequency"]
    assert of_state["state_topic"] == f"{ROOT}/state"
    assert "is not none" in of_state["availability"][1]["value_template"]


def test_alarms_are_told_bit_by_bit_and_as_a_whole() -> None:
    """Each is a problem; undefined bits are none."""
    found = components()
    bits = {key: each for key, each in found.items() if key.startswith("alarm/")}
    assert len(bits) > 8
    assert all(each["device_class"] == "problem" for each in bits.values())
    assert "bitwise_and(1)" in bits["alarm/overcurrent"]["value_template"]
    assert found["alarm"]["platform"] == "binary_sensor"
    assert found["status/running"]["device_class"] == "running"


def commands(found: Mapping[str, Any]) -> set[str]:
    """Return the keys of what commands a drive."""
    return {key for key, each in found.items() if "command_topic" in each}


def test_a_drive_that_nobody_may_command_has_nothing_to_press() -> None:
    """Neither by mode nor by sources."""
    assert commands(components()) == set()
    assert commands(components({"control": "direct", "sources": ["modbus-tcp"], **WATCHED})) == set()


STOPS = {"command/stop", "command/coast", "command/emergency_stop"}


def test_a_drive_without_lease_can_be_run() -> None:
    """By a controller that sends no heartbeat."""
    assert commands(components({"control": "direct", **WATCHED})) == STOPS | RUNS


@pytest.mark.hazard("H05")
def test_of_a_leased_drive_only_the_stop_is_offered() -> None:
    """Home Assistant sends no heartbeat: what it started it could not keep running, nor would it be missed."""
    assert commands(components({"control": "leased", **WATCHED})) == STOPS
    found = components({"control": "leased", **WATCHED}, heartbeat=True)
    assert commands(found) == STOPS | RUNS | {"command/take", "command/release"}
    owned = "value_json.owner == 'mqtt home-assistant'"
    needing = [key for key in commands(found) - STOPS if owned in json.dumps(found[key]["availability"])]
    assert set(needing) == commands(found) - STOPS - {"command/take"}


def test_what_sets_a_motor_in_motion_is_unavailable_until_it_is_armed() -> None:
    """The stop is available as long as the gateway is."""
    found = components({"control": "direct", **WATCHED})
    for key in ("command/run", "command/direction"):
        assert "standing == 'armed'" in json.dumps(found[key]["availability"])
    assert found["command/stop"]["availability"] == [{"topic": "tosvert/hall-3/status"}]


def test_rights_narrow_what_is_offered() -> None:
    """By the name that Home Assistant's commands carry; stopping needs none."""
    right = {"source": "mqtt", "name": "home-*", "commands": ["frequency"], "min": 20, "max": 40}
    drive = {"control": "direct", "right": [right], "frequency": {"min": 0.0, "max": 50.0}, **WATCHED}
    found = components(drive)
    assert commands(found) == STOPS | {"set/frequency"}
    assert (found["set/frequency"]["min"], found["set/frequency"]["max"]) == (20.0, 40.0)
    assert commands(components(drive, source="hmi")) == STOPS


def test_a_setpoint_that_no_register_shows_is_not_made_up() -> None:
    """It is unknown rather than what was asked for last."""
    unseen = components({"control": "direct", **WATCHED})["set/frequency"]
    assert unseen["optimistic"] is False
    seen = {"values": ["frequency_command_value", "status"], "every": "1s"}
    shown = components({"control": "direct", "poll": [seen], **WATCHED})["set/frequency"]
    assert shown["state_topic"] == f"{ROOT}/frequency_command_value"


def test_without_a_status_there_is_a_button_to_run_and_no_switch() -> None:
    """A switch shows a state."""
    poll = [{"values": ["output_frequency"], "every": "1s"}]
    found = components({"control": "direct", "poll": poll, **WATCHED})
    assert found["command/run"]["platform"] == "button"
    assert "command/direction" not in found


def test_entities_that_are_no_more_are_taken_back_by_their_platform_first() -> None:
    """Then the device is told as it is."""
    before = components({"control": "direct", **WATCHED})
    made = discovery()
    made.owe_everything()
    made.hear(kept(json.dumps({"components": before})), 0.0)
    (_, first), (_, second) = told(made)
    removed = json.loads(first)["components"]
    assert removed["command/run"] == {"platform": "switch"}
    assert removed["output_frequency"] == before["output_frequency"]
    assert json.loads(second)["components"].keys() == removed.keys() - commands(before) - {"state/control"}


def test_an_entity_whose_platform_changes_is_taken_back_as_what_it_was() -> None:
    """A button becomes a switch."""
    made = discovery({"control": "direct", **WATCHED})
    made.hear(kept(json.dumps({"components": {"command/run": {"platform": "button"}}})), 0.0)
    (_, first), (_, second) = told(made)
    assert json.loads(first)["components"]["command/run"] == {"platform": "button"}
    assert json.loads(second)["components"]["command/run"]["platform"] == "switch"


def test_a_drive_that_is_no_more_is_taken_back_whole() -> None:
    """Of this gateway only: others are not subscribed."""
    made = discovery()
    made.hear(kept("{}", f"{NODE}/fan-9/config"), 0.0)
    assert told(made) == [(f"{NODE}/fan-9/config", "")]
    assert made.filters == [f"{NODE}/+/config", BIRTH]


def test_what_is_as_before_is_told_once() -> None:
    """Its own echo is no news, and neither is a removal that was done."""
    made = discovery()
    made.owe_everything()
    [(topic, text)] = told(made)
    made.hear(kept(text), 0.0)
    made.hear(Message(topic, text.encode()), 0.0)
    made.hear(kept("", f"{NODE}/fan-9/config"), 0.0)
    assert not made.is_owing


def test_a_birth_is_answered_with_everything_but_not_too_often() -> None:
    """A kept one is none: everything is told at a connect anyway."""
    made = discovery({}, {})
    made.hear(kept("online", BIRTH), 0.0)
    assert not made.is_owing
    assert made.hear(Message(BIRTH, b"online"), 1.0)
    assert len(told(made)) == 2
    assert not made.hear(Message(BIRTH, b"online"), 2.0)
    assert not made.hear(Message(BIRTH, b"offline"), 2.0)
    assert not made.is_owing
    assert made.look(1.0 + BIRTH_PAUSE)
    assert len(told(made)) == 2
    assert not made.look(60.0)


def test_who_the_drive_is_is_told_when_it_is_known() -> None:
    """Once, and again when another drive answers."""
    section = MqttSection.model_validate({"url": "mqtt://localhost", "home_assistant": {"enabled": True}})
    drives = image()
    made = Discovery(section, "hall-3", drives)
    made.owe_everything()
    told(made)
    made.notice(drives.drives[0])
    assert not made.is_owing
    drives.drives[0].identity = {"vendor": "TOSHIBA", "device": "VFnC3", "version": "V1", "type_form": "VFNC3-2007P"}
    made.notice(drives.drives[0])
    [(_, text)] = told(made)
    device = json.loads(text)["device"]
    assert (device["manufacturer"], device["model_id"], device["sw_version"]) == ("TOSHIBA", "VFNC3-2007P", "V1")


def test_a_message_stays_smaller_than_what_the_gateway_itself_takes() -> None:
    """Of too many values the first are told."""
    everything = list(image({"model": "vf-mb1"}).drives[0].drive.model.registers)
    made = discovery({"model": "vf-mb1", "poll": [{"values": everything, "every": "1h"}]})
    made.owe_everything()
    [(_, text)] = told(made)
    assert LARGEST / 2 < len(text.encode()) < 64 * 1024


STRANGE = [b'{"components": 1}', b'{"components": {"a": {}}}', b'{"components": {"a": []}}', b"[" * 9999]


@given(text=st.binary(max_size=200) | st.sampled_from(STRANGE))
def test_whatever_the_broker_kept_is_survived(text: bytes) -> None:
    """It may be anybody's."""
    made = discovery()
    made.hear(Message(CONFIG, text, is_retained=True), 0.0)
    assert all(topic == CONFIG for topic, _ in told(made))
    assert isinstance(known_components(text), dict)


@given(name=st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,20}", fullmatch=True))
def test_entity_ids_are_spelt_as_home_assistant_wants_them(name: str) -> None:
    """Small letters, digits and single underscores."""
    found = entities.slug(f"{name} Output frequency")
    assert found == found.strip("_")
    assert "__" not in found
    assert set(found) <= set("abcdefghijklmnopqrstuvwxyz0123456789_")
