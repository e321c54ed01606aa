"""docs/sparkplug.md is true: its metrics are those of the code, its file loads, its assertions are shown by tests."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from gateway import config, site
from gateway.control.command import Command
from gateway.image import Image, LinkState
from gateway.mqtt import commands
from gateway.mqtt.message import Message, Moment
from gateway.sparkplug import drive_metrics, payload
from tests.mqtt.doors import LEASED, KeptDoor, StandingClock, nc3, small_site
from tests.sparkplug.rig import Plant

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "sparkplug.md").read_text(encoding="utf-8")
ASSERTIONS = re.findall(r"^\| `(tck-id-[A-Za-z0-9-]+)` \| `(\w+\.py)`: (\w+) \|$", PAGE, re.MULTILINE)


def test_every_assertion_is_shown_by_a_test_that_is_there() -> None:
    """Each once, in order."""
    ids = [assertion for assertion, _, _ in ASSERTIONS]
    assert len(ids) > 150
    assert ids == sorted(set(ids))
    for _, file, test in ASSERTIONS:
        source = (ROOT / "tests" / "sparkplug" / file).read_text(encoding="utf-8")
        assert re.search(rf"^(async )?def {test}\(", source, re.MULTILINE), (file, test)


def test_the_configuration_of_the_page_is_that_of_the_example() -> None:
    """Both load, and say the same of Sparkplug."""
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    shown = site.build(tomllib.loads(text), "page", Path()).config.sparkplug
    assert shown == site.load(ROOT / "config" / "sparkplug.toml").config.sparkplug


def test_every_metric_is_on_the_page() -> None:
    """Those of the node, of a drive, and those that can be written."""
    named = set(re.findall(r"`([A-Z][a-z][A-Za-z /<>]*|bdSeq)`", PAGE))
    door = KeptDoor.small(StandingClock())
    image = Image(small_site().drives)
    image.by_name[LEASED].set_link(LinkState.ONLINE)
    plant = Plant(image, door, commands=True)
    born = [name for sent in plant.live() for name in sent.names if name[0].isupper() or name == "bdSeq"]
    assert "Control/Run" in born
    for name in born:
        assert name.replace("Lines/a/", "Lines/<line>/") in named, name
    assert named - {name.replace("Lines/a/", "Lines/<line>/") for name in born} == {"Quality"}


def test_the_limits_of_the_page_are_those_of_the_code() -> None:
    """Sizes, and the age of commands."""
    assert f"{payload.LARGEST // 1024} KiB and {payload.MOST_METRICS} metrics" in PAGE
    age = config.SparkplugSection.model_fields["command_max_age"].default
    assert f"`command_max_age` ({age:g} s)" in PAGE


def test_the_commands_of_the_page_are_commands() -> None:
    """As words and as JSON."""
    moment = Moment(now=500.0, wall=0.0, good_for=1.0, max_age=2.0)
    shown = re.findall(r'`(\{"command"[^`]+\})`', PAGE)
    assert shown
    for text in shown:
        assert isinstance(commands.read(Message("", text.encode()), [LEASED, "command"], moment, nc3()), Command)


def test_buttons_say_what_mqtt_has() -> None:
    """Each is a command by itself."""
    moment = Moment(now=500.0, wall=0.0, good_for=1.0, max_age=2.0)
    for spelt in drive_metrics.BUTTONS.values():
        assert isinstance(commands.read(Message("", spelt), [LEASED, "command"], moment, nc3()), Command)
