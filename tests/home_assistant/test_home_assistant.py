"""The gateway and Home Assistant's own code, with a broker between them and a simulated drive behind."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.mqtt.events import KINDS
from gateway.sim.process import SimulatedLine
from tests.controlled import Stage, plant, telling, written
from tests.home_assistant.house import IS_THERE, WHY_NOT, HomeAssistant
from tests.mosquitto import Mosquitto
from tests.processes import gateway, until

pytestmark = [pytest.mark.e2e, pytest.mark.skipif(not IS_THERE, reason=WHY_NOT)]

DISCOVERED = "[mqtt.home_assistant]\nenabled = true\n"
DIRECT = """control = "direct"
sources = ["mqtt"]
communication_timeout = "3s"
timeout_action = "stop"
frequency = { min = 5.0, max = 60.0 }
"""
LEASED = DIRECT.replace("direct", "leased")
POLL = 'poll = [{ values = ["status", "output_frequency", "output_current"], every = "0.1s" }]'
MORE = """[[line.drive.poll]]
values = ["status", "output_frequency", "frequency_command", "output_current_amps", "alarm"]
every = "0.2s"
[[line.drive.poll]]
values = ["trip_code", "cumulative_operation_time", "acceleration_time_1"]
every = "1s"
"""
PAGE = (Path(__file__).parents[2] / "docs" / "home-assistant.md").read_text(encoding="utf-8")
AUTOMATION = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)[0]


def configured(path: Path, poll: str, publish: str) -> None:
    """Have the gateway read more of the drive, and publish in one form only, where that is asked for."""
    text = path.read_text(encoding="utf-8")
    assert POLL in text
    text = text.replace(POLL, "") + poll
    if publish:
        text = text.replace("[mqtt]\n", f'[mqtt]\npublish = ["{publish}"]\n')
    path.write_text(text, encoding="utf-8")


@contextlib.contextmanager
def at_work(
    line: SimulatedLine,
    broker: Mosquitto,
    folder: Path,
    control: str = DIRECT,
    *,
    poll: str = MORE,
    options: str = "",
    publish: str = "",
) -> Iterator[Stage]:
    """Run a gateway on a line that tells Home Assistant of its drive."""
    path, tcp, web = written(folder, line.port, broker.port, control, DISCOVERED + options)
    configured(path, poll, publish)
    told = folder / "told"
    with telling(broker.port, told), gateway(path, folder / "log") as process:
        stage = Stage(line, broker, process, told, tcp, web)
        until(stage.is_online, "a healthy gateway")
        yield stage


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Stage, HomeAssistant]]:
    """Run a drive that may be commanded without a lease, its gateway, and Home Assistant, which has found it."""
    folder = tmp_path_factory.mktemp("house")
    with (
        plant(folder) as (line, broker),
        at_work(line, broker, folder) as stage,
        HomeAssistant(folder / "home", broker.port) as home,
    ):
        home.until_state("binary_sensor.pump_1_link", "on")
        yield stage, home
        home.look()
        assert home.complaints == []


def sent(stage: Stage, topic: str) -> str:
    """Return what is retained on a topic."""
    arguments = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(stage.broker.port), "-t", topic, "-C", "1", "-W", "5"]
    return subprocess.run(arguments, capture_output=True, text=True, check=True).stdout


def test_every_component_becomes_an_entity_and_nothing_is_complained_of(house: tuple[Stage, HomeAssistant]) -> None:
    """One device with its maker and model; every entity under the id that it asks for."""
    stage, home = house
    told = json.loads(sent(stage, "homeassistant/device/tosvert-hall-3/pump-1/config"))
    wanted = {each["default_entity_id"]: each["unique_id"] for each in told["components"].values()}
    found = home.look()
    assert {entity: each["unique_id"] for entity, each in found["entities"].items()} == wanted
    assert [(each["name"], each["manufacturer"], each["model"]) for each in found["devices"]] == [
        ("pump-1", told["device"]["manufacturer"], "TOSVERT VF-nC3")
    ]
    assert home.complaints == []


def test_values_have_units_classes_and_precision(house: tuple[Stage, HomeAssistant]) -> None:
    """As Home Assistant shows them."""
    _, home = house
    home.until_state("sensor.pump_1_output_frequency", "0.00")
    entities = home.entities()
    frequency = entities["sensor.pump_1_output_frequency"]["attributes"]
    assert frequency["unit_of_measurement"] == "Hz"
    assert (frequency["device_class"], frequency["state_class"]) == ("frequency", "measurement")
    assert entities["sensor.pump_1_output_current_amps"]["attributes"]["device_class"] == "current"
    hours = entities["sensor.pump_1_cumulative_operation_time"]["attributes"]
    assert (hours["device_class"], hours["state_class"]) == ("duration", "total_increasing")
    assert entities["sensor.pump_1_trip_code"]["state"] == "nerr: No error"
    assert entities["sensor.pump_1_acceleration_time_1"]["category"] == "diagnostic"
    assert entities["event.pump_1_event"]["attributes"]["event_types"] == list(KINDS)
    assert entities["button.pump_1_coast"]["disabled"] == "integration"
    assert entities["number.pump_1_frequency_setpoint"]["attributes"] | {
        "min": 5.0, "max": 60.0, "step": 0.01, "mode": "box"
    } == entities["number.pump_1_frequency_setpoint"]["attributes"]  # fmt: skip


def test_it_arms_sets_runs_reverses_and_stops(house: tuple[Stage, HomeAssistant]) -> None:
    """What a person does; the drive is the judge."""
    stage, home = house
    home.until_state("sensor.pump_1_control", "disarmed")
    assert home.state("switch.pump_1_run") == "unavailable"
    home.call("button.press", "button.pump_1_arm")
    home.until_state("switch.pump_1_run", "off")
    home.call("number.set_value", "number.pump_1_frequency_setpoint", value=20.5)
    home.until_state("number.pump_1_frequency_setpoint", "20.5")
    home.call("switch.turn_on", "switch.pump_1_run")
    until(lambda: stage.drive["frequency"] == 20.5, "20.5 Hz")
    home.until_state("binary_sensor.pump_1_running", "on")
    home.until_state("select.pump_1_direction", "forward")
    home.call("select.select_option", "select.pump_1_direction", option="reverse")
    home.until_state("select.pump_1_direction", "reverse")
    home.call("select.select_option", "select.pump_1_acceleration", option="2")
    home.until_state("select.pump_1_acceleration", "2")
    home.call("button.press", "button.pump_1_stop")
    until(lambda: not stage.is_running, "a stop")
    home.until_state("switch.pump_1_run", "off")
    assert "error" in home.call("number.set_value", "number.pump_1_frequency_setpoint", value=60.5)
    assert home.complaints == []


def test_a_trip_is_seen_and_reset(house: tuple[Stage, HomeAssistant]) -> None:
    """As a state, in words, and as an event with its text."""
    stage, home = house
    stage.line.do({"do": "trip", "drive": 1, "code": 1})
    home.until_state("binary_sensor.pump_1_tripped", "on")
    home.until(lambda: (home.entities()["event.pump_1_event"]["attributes"].get("event_type")) == "trip", "an event")
    event = home.entities()["event.pump_1_event"]["attributes"]
    assert event["reason"] == home.state("sensor.pump_1_trip_code")
    assert home.state("switch.pump_1_run") == "unavailable"
    home.call("button.press", "button.pump_1_reset")
    home.until_state("binary_sensor.pump_1_tripped", "off")
    assert home.complaints == []


def test_entities_keep_their_ids_and_what_is_no_more_is_removed(tmp_path: Path) -> None:
    """Over restarts of both sides; a gateway that is killed leaves everything unavailable."""
    home = tmp_path / "home"
    with plant(tmp_path) as (line, broker):
        with at_work(line, broker, tmp_path) as stage, HomeAssistant(home, broker.port) as house:
            house.until_state("sensor.pump_1_output_frequency", "0.00")
            first = {entity: each["unique_id"] for entity, each in house.entities().items()}
            stage.process.kill()
            house.until_state("sensor.pump_1_output_frequency", "unavailable")
            house.until_state("button.pump_1_stop", "unavailable")
            with at_work(line, broker, tmp_path, poll=MORE.replace('"output_current_amps", ', "")):
                house.until_state("sensor.pump_1_output_frequency", "0.00")
                gone = {"sensor.pump_1_output_current_amps", "sensor.pump_1_output_current"}
                house.until(lambda: not gone & set(house.entities()), "the removal of what is not polled")
                second = {entity: each["unique_id"] for entity, each in house.entities().items()}
            assert house.complaints == []
        assert second == {entity: found for entity, found in first.items() if entity not in gone}
        with at_work(line, broker, tmp_path), HomeAssistant(home, broker.port) as house:
            house.until(lambda: gone <= set(house.entities()), "what is polled again")
            third = {entity: each["unique_id"] for entity, each in house.entities().items()}
            assert third == first
            assert house.complaints == []


def test_a_leased_drive_can_only_be_stopped(tmp_path: Path) -> None:
    """As long as no automation beats."""
    with (
        plant(tmp_path) as (line, broker),
        at_work(line, broker, tmp_path, LEASED) as stage,
        HomeAssistant(tmp_path / "home", broker.port) as house,
    ):
        house.until_state("sensor.pump_1_control", "disarmed")
        commanding = ("button", "switch", "select", "number")
        offered = {entity for entity in house.entities() if entity.startswith(commanding)}
        assert offered == {f"button.pump_1_{verb}" for verb in ("stop", "coast", "emergency_stop")}
        stage.do("take", "arm", '{"command": "run", "frequency": 20.0}')
        house.call("button.press", "button.pump_1_stop")
        until(lambda: not stage.is_running, "a stop")
        assert [each["source"] for each in stage.published("result") if each["command"] == "stop"] == [
            "mqtt home-assistant"
        ]
        assert house.complaints == []


def test_an_automation_keeps_a_lease_and_its_end_stops_the_motor(tmp_path: Path) -> None:
    """The one of the documentation, in Home Assistant's own automations."""
    home = tmp_path / "home"
    home.mkdir()
    (home / "automations.yaml").write_text(AUTOMATION, encoding="utf-8")
    with (
        plant(tmp_path) as (line, broker),
        at_work(line, broker, tmp_path, LEASED + 'lease = "3s"\n', options="heartbeat = true\n") as stage,
        HomeAssistant(home, broker.port) as house,
    ):
        house.until_state("sensor.pump_1_control", "disarmed")
        house.until_state("button.pump_1_arm", "unavailable")
        house.call("button.press", "button.pump_1_take")
        house.until_state("number.pump_1_frequency_setpoint", "unknown")
        house.call("button.press", "button.pump_1_arm")
        house.until_state("switch.pump_1_run", "off")
        house.call("number.set_value", "number.pump_1_frequency_setpoint", value=20)
        house.call("switch.turn_on", "switch.pump_1_run")
        until(lambda: stage.drive["frequency"] == 20.0, "20 Hz")
        began = stage.now
        until(lambda: stage.now > began + 6.0, "twice the lease")
        assert stage.is_running
        assert house.complaints == []
        house.kill()
        until(lambda: not stage.is_running, "the end of the lease")
        assert stage.until_event("lease_lost")


@pytest.mark.hazard("H19")
@pytest.mark.parametrize("publish", ["values", "state"])
def test_a_drive_that_falls_silent_becomes_unavailable_and_comes_back(tmp_path: Path, publish: str) -> None:
    """No number stays as if it were new, whether values have topics of their own or stand in the state."""
    with (
        plant(tmp_path) as (line, broker),
        at_work(line, broker, tmp_path, publish=publish) as stage,
        HomeAssistant(tmp_path / "home", broker.port) as house,
    ):
        stage.do("arm", '{"command": "run", "frequency": 20.0}')
        house.until_state("sensor.pump_1_output_frequency", "20.00" if publish == "values" else "20.0")
        house.until_state("binary_sensor.pump_1_running", "on")
        house.until_state("select.pump_1_direction", "forward")
        assert house.state("sensor.pump_1_trip_code") == "nerr: No error"
        line.unplug()
        house.until_state("binary_sensor.pump_1_link", "off")
        for entity in ("sensor.pump_1_output_frequency", "binary_sensor.pump_1_running", "sensor.pump_1_trip_code"):
            house.until_state(entity, "unavailable")
        assert house.state("button.pump_1_stop") != "unavailable"
        line.plug()
        house.until_state("binary_sensor.pump_1_link", "on")
        house.until_state("sensor.pump_1_trip_code", "nerr: No error")
        assert house.complaints == []
