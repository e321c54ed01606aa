"""Topic names."""

from __future__ import annotations

from gateway.config import Config, MqttSection
from gateway.image import DriveImage
from gateway.mqtt import topics
from gateway.site import Line, Site
from tests.mqtt import drives
from tests.mqtt.doors import DIRECT, LEASED, small_site

ROOT = "tosvert/hall-3/pump-1"


def of_pump() -> topics.DriveTopics:
    """Return the topics of a drive."""
    return topics.of_drive("tosvert", "hall-3", DriveImage(drives.drive()))


def site(**mqtt: object) -> Site:
    """Return a site with one drive and these MQTT settings."""
    table = {
        "gateway": {"name": "hall-3"},
        "mqtt": {"url": "mqtt://localhost", **mqtt},
        "line": [{"name": "a", "port": "/dev/ttyUSB0", "drive": [{"name": "pump-1", "number": 1, "model": "test"}]}],
    }
    line = Line("a", "/dev/ttyUSB0", 19200, "even", 0.05, 0.05, 1.0, 30.0, (drives.drive(),))
    return Site(Config.model_validate(table), (line,), {})


def overview(**mqtt: object) -> list[str]:
    """Return the overview of a site with these MQTT settings."""
    section = MqttSection.model_validate({"url": "mqtt://localhost", **mqtt})
    return topics.overview(section, site(**mqtt))


def test_a_drive_has_the_documented_topics() -> None:
    """Base, gateway, drive, and then what it is about."""
    pump = of_pump()
    assert topics.status("tosvert", "hall-3") == "tosvert/hall-3/status"
    assert pump.availability == f"{ROOT}/availability"
    assert pump.state == f"{ROOT}/state"
    assert pump.values["output_frequency"].value == f"{ROOT}/output_frequency"
    assert pump.values["output_frequency"].quality == f"{ROOT}/output_frequency/quality"


def test_bit_fields_and_codes_have_words_besides() -> None:
    """A plain number has none."""
    values = of_pump().values
    assert values["status"].text == f"{ROOT}/status_text"
    assert values["trip_code"].text == f"{ROOT}/trip_code_text"
    assert values["output_frequency"].text is None
    assert values["output_current"].text is None


def test_the_read_back_of_a_command_is_not_published_where_commands_come_in() -> None:
    """A register may be called like a topic that has another use."""
    assert of_pump().values["command"].value == f"{ROOT}/command_value"


def test_no_two_things_share_a_topic() -> None:
    """Every topic of a drive is its own."""
    pump = of_pump()
    every = [pump.availability, pump.tripped, pump.reset_needed, pump.state]
    for value in pump.values.values():
        every += [topic for topic in (value.value, value.text, value.quality) if topic is not None]
    assert len(set(every)) == len(every)
    assert not {f"{ROOT}/{name}" for name in topics.RESERVED - topics.PUBLISHED} & set(every)


def test_the_overview_lists_what_is_published() -> None:
    """Both forms by default, one by choice."""
    levels = ("availability", "tripped", "reset_needed", "control", "description", "event", "state")
    standing = [f"{ROOT}/{name}" for name in levels]
    assert overview()[:8] == ["tosvert/hall-3/status", *standing]
    assert f"{ROOT}/status_text" in overview()
    assert overview(publish=["state"]) == ["tosvert/hall-3/status", *standing, f"{ROOT}/history/#"]
    assert f"{ROOT}/history/#" not in overview(store={"enabled": False})
    assert f"{ROOT}/state" not in overview(publish=["values"])
    assert f"{ROOT}/torque/quality" in overview(publish=["values"])


def test_what_is_taken_and_answered_is_listed_where_drives_may_be_commanded() -> None:
    """Of each drive and of its line; not for a broker from which nothing is taken."""
    built = small_site()
    root = "tosvert/hall-3"
    levels = ("command", "set/+", "heartbeat")
    wanted = [f"{root}/{drive}/{level}" for drive in (LEASED, DIRECT) for level in levels]
    plant = MqttSection.model_validate({"url": "mqtt://localhost"})
    assert topics.taken(plant, built) == [*wanted, f"{root}/line/a/command"]
    cloud = MqttSection.model_validate({"url": "mqtt://localhost", "commands": False})
    assert topics.taken(cloud, built) == []
    for section in (plant, cloud):
        results = [topic for topic in topics.overview(section, built) if topic.endswith("/result")]
        assert results == [f"{root}/{LEASED}/result", f"{root}/{DIRECT}/result"]


def test_the_base_may_have_several_levels() -> None:
    """As sites with one broker for many plants want it."""
    assert overview(base="acme/plant-2")[0] == "acme/plant-2/hall-3/status"
