"""VF-AS3: what the summary states, per connector, and nothing that is guessed."""

from __future__ import annotations

import pytest

from gateway.drives.catalogue import load
from gateway.drives.model import Model
from gateway.drives.register import Storage

STATED = {
    0xFD00: "output_frequency",
    0x0803: "communication_timeout",
    0x0805: "communication_wait_time",
    0x0806: "master_slave",
    0x0810: "frequency_points",
    0x0811: "point_1_setting",
    0x0812: "point_1_frequency",
    0x0813: "point_2_setting",
    0x0814: "point_2_frequency",
    0x0823: "communication_timeout_2",
    0x0825: "communication_wait_time_2",
    0x0826: "master_slave_2",
    0x0829: "protocol_2",
}


@pytest.fixture(scope="module")
def as3() -> Model:
    """Return the built-in model."""
    return load()["vf-as3"]


def test_only_what_the_summary_states_is_there(as3: Model) -> None:
    """Nothing is taken over from the other models."""
    assert {r.address: r.name for r in as3.registers.values()} == STATED
    assert as3.capacities == as3.read_selectors == as3.write_selectors == {}
    assert as3.series_code is None
    assert as3.derived == ()


def test_each_connector_has_parameters_of_its_own(as3: Model) -> None:
    """F80x are those of connector 1, F82x those of connector 2; the first is the default."""
    found = {
        c.name: {role: as3.registers[name].address for role, name in c.parameters.items()} for c in as3.connectors
    }
    assert found == {
        "connector_1": {"timeout": 0x0803, "wait_time": 0x0805, "master_slave": 0x0806},
        "connector_2": {"timeout": 0x0823, "wait_time": 0x0825, "master_slave": 0x0826, "protocol": 0x0829},
    }
    assert as3.connector() is as3.connector("connector_1")
    assert as3.connector("connector_3") is None


def test_the_example_of_the_summary_decodes(as3: Model) -> None:
    """1770H read from FD00 are 60.00 Hz."""
    assert as3.registers["output_frequency"].format(0x1770) == "60.00"
    assert as3.registers["output_frequency"].unit == "Hz"


@pytest.mark.parametrize("connector", ["", "_2"])
def test_times_have_the_ranges_of_the_summary(as3: Model, connector: str) -> None:
    """The time-out reaches to 100.0 s and is off by default, the waiting time to 2.00 s."""
    timeout = as3.registers[f"communication_timeout{connector}"]
    wait = as3.registers[f"communication_wait_time{connector}"]
    assert (timeout.format(timeout.minimum or 0), timeout.format(timeout.maximum or 0)) == ("0.0", "100.0")
    assert (wait.format(wait.minimum or 0), wait.format(wait.maximum or 0)) == ("0.00", "2.00")
    assert (timeout.initial, wait.initial) == (0, 0)
    assert (timeout.unit, wait.unit) == ("s", "s")


def test_a_master_sends_one_of_four_values(as3: Model) -> None:
    """F806 and F826: 0-2 are slaves, 3-6 masters."""
    for name in ("master_slave", "master_slave_2"):
        enumeration = as3.registers[name].enumeration
        assert enumeration is not None
        assert sorted(enumeration.texts) == [0, 1, 2, 3, 4, 5, 6]
        assert (as3.registers[name].minimum, as3.registers[name].maximum) == (0, 6)
        assert as3.registers[name].text(5) == "Master, sends the torque command"


def test_proportional_speed_is_converted_in_one_of_two_ways(as3: Model) -> None:
    """F810: 0 without correction, 1 by two points."""
    points = as3.registers["frequency_points"]
    assert (points.minimum, points.maximum) == (0, 1)
    assert (points.text(0), points.text(1)) == ("Without correction", "By two points")


@pytest.mark.hazard("H08")
def test_a_write_of_unknown_storage_counts_as_one_to_the_eeprom(as3: Model) -> None:
    """The summary does not say where writes go: the careful reading is that they wear the EEPROM."""
    assert {r.storage for r in as3.registers.values() if r.is_writable} == {Storage.EEPROM}


@pytest.mark.parametrize(
    "name", ["point_1_setting", "point_1_frequency", "point_2_setting", "point_2_frequency", "protocol_2"]
)
def test_what_has_no_known_counts_is_read_only_and_without_unit(as3: Model, name: str) -> None:
    """A value whose counts are not stated claims no unit, and cannot be written."""
    assert as3.registers[name].unit == ""
    assert not as3.registers[name].is_writable


def test_no_indirect_block_is_used_without_knowing_its_address(as3: Model) -> None:
    """The summary gives no address and no selectors, so only direct blocks of up to 8 words are there."""
    assert as3.blocks.indirect_read_maximum == as3.blocks.indirect_write_words == 0
    assert not as3.blocks.has_exchange
    assert as3.blocks.direct_read_maximum == 8
    assert as3.blocks.direct_ranges == ()


def test_it_is_known_by_its_identification(as3: Model) -> None:
    """The summary names VFAS3-2037P as an answer to 2BH."""
    assert "VFAS3-2037P".startswith(as3.identity)
    assert as3.profile == ((("output_frequency",), "200ms"),)
