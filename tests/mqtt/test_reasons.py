"""What is said of a broker that refuses: with keys that there are."""

from __future__ import annotations

import re

import pytest

from gateway.config import MqttSection, SparkplugSection
from gateway.mqtt.reasons import HINTS, REMEDIES, of_code, of_error

KEY = re.compile(r"\b(mqtt|sparkplug)\.([a-z_]+)")
KEYS = {"mqtt": set(MqttSection.model_fields), "sparkplug": set(SparkplugSection.model_fields)}


@pytest.mark.parametrize("table", ["mqtt", "sparkplug"])
def test_every_remedy_names_keys_of_its_table(table: str) -> None:
    """A key that the section does not have helps nobody."""
    told = [of_code(code, "", table) for code in REMEDIES] + [of_error(needle, table) for needle, _ in HINTS]
    named = {found for text in told for found in KEY.findall(text)}
    assert {of for of, _ in named} == {table}
    assert {key for _, key in named} <= KEYS[table]
