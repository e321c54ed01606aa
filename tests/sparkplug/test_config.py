"""The names that become levels of topics, and what else can be wrong with the section."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from gateway import site
from gateway.errors import BadConfig
from gateway.sparkplug import topics
from gateway.sparkplug.node import Node
from tests.mqtt import drives
from tests.sparkplug.rig import Plant, section


@pytest.mark.parametrize("key", ["group_id", "edge_node_id", "primary_host"])
@pytest.mark.parametrize("name", ["", "a/b", "a+", "#", "a\0", "x" * 129])
def test_a_name_that_cannot_be_a_level_of_a_topic_is_refused(key: str, name: str) -> None:
    """Neither a level more nor a wildcard."""
    with pytest.raises(ValidationError):
        section(**{key: name})


@pytest.mark.parametrize("name", ["Plant 1", "Werk Süd", "a.b-c_d"])
def test_other_names_are_taken_as_they_are(name: str) -> None:
    """UTF-8, with spaces if need be."""
    node: Node = Plant(group_id=name, edge_node_id=name).node
    assert node.topics.of_node("NBIRTH") == f"spBv1.0/{name}/NBIRTH/{name}"


def table(**sparkplug: Any) -> dict[str, Any]:
    """Return a configuration with two drives."""
    drive = {"number": 1, "model": "vf-nc3"}
    line = {"name": "a", "port": "/dev/null", "drive": [{"name": "p", **drive}, {"name": "q", **drive, "number": 2}]}
    settings = {"url": "mqtt://h", "group_id": "g", **sparkplug}
    return {"gateway": {"name": "hall-3"}, "line": [line], "sparkplug": settings}


def test_drives_are_devices_with_names_of_their_own() -> None:
    """A name is taken once, and is a level of a topic."""
    built = site.build(table(), "test", Path())
    assert [drive.name for drive in built.drives] == ["p", "q"]
    for name in ("q", "a/b", "a+"):
        wrong = table()
        wrong["line"][0]["drive"][0]["name"] = name
        with pytest.raises(BadConfig):
            site.build(wrong, "test", Path())


def test_the_topics_of_a_site_are_listed() -> None:
    """What it publishes under, and what it listens to."""
    configured = table(primary_host="scada", commands=True)
    configured["line"][0]["drive"][1] |= {"control": "direct", "unwatched": True}
    built = site.build(configured, "test", Path())
    assert built.config.sparkplug is not None
    listed = topics.overview(built.config.sparkplug, built)
    assert listed == [
        "spBv1.0/g/NBIRTH/hall-3", "spBv1.0/g/NDATA/hall-3", "spBv1.0/g/NDEATH/hall-3", "spBv1.0/g/NCMD/hall-3",
        "spBv1.0/STATE/scada",
        "spBv1.0/g/DBIRTH/hall-3/p", "spBv1.0/g/DDATA/hall-3/p", "spBv1.0/g/DDEATH/hall-3/p",
        "spBv1.0/g/DBIRTH/hall-3/q", "spBv1.0/g/DDATA/hall-3/q", "spBv1.0/g/DDEATH/hall-3/q",
        "spBv1.0/g/DCMD/hall-3/q",
    ]  # fmt: skip


def test_a_deadband_for_a_value_that_no_drive_has_is_refused() -> None:
    """With the name that was meant."""
    with pytest.raises(BadConfig, match=r"sparkplug\.deadband: .*'output_curent'; did you mean 'output_current'"):
        site.build(table(deadband={"output_curent": 1.0}), "test", Path())


def test_commands_are_off_unless_they_are_asked_for() -> None:
    """Default deny."""
    assert not section().commands
    assert Plant(drives.image()).node.line_inputs == {}
