"""Home Assistant's own code has taken what it is told, and what it is told is still that.

The first test runs everywhere, by what `accepted.json` remembers. The second is how it comes there: in the
environment that `make home-assistant` makes.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.home_assistant import cases
from tests.home_assistant.house import IS_THERE, WHY_NOT, HomeAssistant
from tests.mosquitto import Mosquitto

REMEDY = "not what Home Assistant has taken: make home-assistant ACCEPT=1"


def test_what_home_assistant_is_told_is_what_it_has_taken() -> None:
    """Message by message, for every model, mode and form."""
    taken = json.loads(cases.ACCEPTED.read_text(encoding="utf-8"))
    assert cases.digests() == taken["messages"], REMEDY


@pytest.mark.e2e
@pytest.mark.skipif(not IS_THERE, reason=WHY_NOT)
def test_home_assistant_takes_every_message_whole(tmp_path: Path) -> None:
    """Every component becomes an entity of its own, and nothing is complained of."""
    told = cases.messages()
    with Mosquitto() as broker, HomeAssistant(tmp_path / "home", broker.port) as home:
        for topic, text in told.items():
            arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-r", "-q", "1", "-t", topic, "-s"]
            subprocess.run(["mosquitto_pub", *arguments], input=text, text=True, check=True)
        components = [each for text in told.values() for each in json.loads(text)["components"].values()]
        wanted = sorted(each["unique_id"] for each in components)
        home.until(lambda: len(home.entities()) >= len(wanted), f"{len(wanted)} entities")
        found = home.look()
        assert sorted(each["unique_id"] for each in found["entities"].values()) == wanted
        assert len(found["devices"]) == len(told)
        assert home.complaints == []
        assert {error for each in components if (error := home.judge(each))} == set()
        assert "extra keys" in home.judge({**components[0], "unit": "Hz"})
    if os.environ.get("TOSVERT_ACCEPT"):
        taken = {"home_assistant": found["version"], "entities": len(wanted), "messages": cases.digests()}
        cases.ACCEPTED.write_text(json.dumps(taken, indent=1) + "\n", encoding="utf-8")
