"""What is wrong in fact in the MQTT section."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.errors import BadConfig


def wrong(mqtt: dict[str, Any], *drives: dict[str, Any]) -> str:
    """Return what is wrong with a configuration, "" where it is right."""
    made = [{"name": "pump-1", "number": 1, "model": "vf-nc3"}, *drives]
    table = {
        "gateway": {"name": "hall-3"},
        "mqtt": {"url": "mqtt://localhost", **mqtt},
        "line": [{"name": "a", "port": "/dev/null", "drive": made}],
    }
    try:
        site.build(table, "test", Path())
    except BadConfig as error:
        return str(error)
    return ""


def test_a_deadband_or_filter_for_what_nobody_has_is_refused() -> None:
    """With the nearest name."""
    assert "did you mean 'output_current'" in wrong({"deadband": {"output_curent": 1.0}})
    assert "did you mean 'torque'" in wrong({"filter": [{"values": ["torqe"], "min_interval": "1s"}]})
    assert "is called 'fan-*'" in wrong({"filter": [{"drives": ["fan-*"], "min_interval": "1s"}]})
    assert not wrong({"filter": [{"values": ["output_*"], "drives": ["pump-?"], "min_interval": "1s"}]})


def test_a_filter_that_says_nothing_or_contradicts_itself_is_refused() -> None:
    """Whatever it is for."""
    assert "it says nothing" in wrong({"filter": [{"values": ["torque"]}]})
    assert "is above max_interval" in wrong({"filter": [{"min_interval": "2s", "max_interval": "1s"}]})


def test_home_assistant_tells_drives_apart_by_names_without_dots() -> None:
    """Two that differ in that only are refused, where it is to discover them."""
    dotted = [{"name": "fan.1", "number": 2, "model": "vf-nc3"}, {"name": "fan_1", "number": 3, "model": "vf-nc3"}]
    assert "one to Home Assistant" in wrong({"home_assistant": {"enabled": True}}, *dotted)
    assert not wrong({}, *dotted)


@pytest.mark.hazard("H05")
def test_a_lease_that_an_automation_cannot_keep_is_refused() -> None:
    """It is started once a second at the most, and one beat may be lost."""
    drive = {"name": "fan-1", "number": 2, "model": "vf-nc3", "control": "leased", "communication_timeout": "1.5s"}
    beating = {"home_assistant": {"enabled": True, "heartbeat": True}}
    assert "is too short for it" in wrong(beating, drive | {"lease": "2s"})
    assert not wrong(beating, drive | {"lease": "3s"})
    assert not wrong({"home_assistant": {"enabled": True}}, drive | {"lease": "2s"})
    assert not wrong(beating, drive | {"lease": "2s", "sources": ["modbus-tcp"]})
