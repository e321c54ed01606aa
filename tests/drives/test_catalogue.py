"""The catalogue: the built-in models agree with themselves and each other, and a user's files are taken whole."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path

import pytest

from gateway.drives.catalogue import load
from gateway.drives.register import Kind, Storage
from gateway.errors import BadConfig
from tests.drives.files import EXTENSION, REGISTER, WHOLE_MODEL, written

MODELS = ["vf-as3", "vf-mb1", "vf-nc3"]


def test_the_three_models_are_built_in() -> None:
    """Nothing needs to be configured for them."""
    catalogue = load()
    assert sorted(catalogue) == MODELS
    assert all(model.name == name for name, model in catalogue.items())


@pytest.mark.parametrize("name", MODELS)
def test_names_and_numbers_are_unique(name: str) -> None:
    """A name leads to one number and a number to one name, and names are snake_case."""
    model = load()[name]
    assert all(key == register.name for key, register in model.registers.items())
    assert len({register.address for register in model.registers.values()}) == len(model.registers)
    assert all(re.fullmatch("[a-z][a-z0-9_]*", key) for key in model.registers)
    assert all(model.at(register.address) is register for register in model.registers.values())


@pytest.mark.parametrize("name", MODELS)
def test_ranges_initial_values_and_codes_agree(name: str) -> None:
    """Every initial value and every code lies in its register's range, and bits are named once each."""
    for register in load()[name].registers.values():
        low, high = register.scaling.limits
        low = low if register.minimum is None else register.minimum
        high = high if register.maximum is None else register.maximum
        assert low <= register.initial <= high, register.name
        assert len(set(register.bits.values())) == len(register.bits)
        codes = register.enumeration.texts if register.enumeration else {}
        assert all(low <= code <= high for code in codes), register.name


@pytest.mark.parametrize("name", MODELS)
def test_block_selectors_take_exactly_the_codes_of_their_table(name: str) -> None:
    """The range and the texts of F870-F879 agree with what the selectors mean."""
    model = load()[name]
    for connector in model.connectors:
        for names, selectors in (
            (connector.block_write, model.write_selectors),
            (connector.block_read, model.read_selectors),
        ):
            for register in (model.registers[n] for n in names):
                assert register.enumeration is not None
                assert sorted(register.enumeration.texts) == sorted(selectors) == [*range(len(selectors))]
                assert (register.minimum, register.maximum) == (0, len(selectors) - 1)
                assert register.takes_effect_after_reset


def test_a_name_means_the_same_in_every_model() -> None:
    """Where two models have a name, number, kind, sign, access and storage are the same.

    Units may differ: the power-on time counts hours in one and tens of hours in the other.
    """
    nc3, mb1, as3 = (load()[name].registers for name in ("vf-nc3", "vf-mb1", "vf-as3"))
    units_differ = {"cumulative_power_on_time", "acceleration_time_2", "deceleration_time_2"}
    shared = set(nc3) & set(mb1)
    assert len(shared) > 100
    for name in shared:
        assert nc3[name].address == mb1[name].address, name
        assert nc3[name].kind is mb1[name].kind, name
        if name not in units_differ:
            assert (nc3[name].unit, nc3[name].scaling) == (mb1[name].unit, mb1[name].scaling), name
            assert nc3[name].storage is mb1[name].storage, name
    for name in set(as3) & set(mb1):
        assert as3[name].address == mb1[name].address, name


@pytest.mark.parametrize("name", MODELS)
def test_a_read_only_register_has_no_storage_and_a_writable_one_has(name: str) -> None:
    """Access and storage agree for every entry; held values and monitors are read only."""
    for register in load()[name].registers.values():
        assert register.is_writable == (register.storage is not Storage.NONE), register.name
        if register.kind in (Kind.MONITOR, Kind.STATUS, Kind.TRIP_HELD):
            assert not register.is_writable, register.name
        assert (register.kind is Kind.TRIP_HELD) == (
            register.name.startswith("trip_") and register.name != "trip_code"
        )


def test_a_whole_model_is_taken_with_all_that_its_file_says(tmp_path: Path) -> None:
    """Every kind of table and key of the format arrives in the model."""
    model = load([written(tmp_path, WHOLE_MODEL)])["vf-x"]
    assert (model.title, model.identity, model.series_code) == ("A drive of the user's own", "VFX", 7)
    assert (model.times.processing, model.times.eeprom, model.times.start_up) == (0.02, 0.05, 1.0)
    assert (model.blocks.indirect_read_address, model.blocks.indirect_read_maximum) == (0x1875, 2)
    assert model.blocks.direct_ranges == ((0, 0x0999),)
    connector = model.connector("rs485")
    assert connector is not None
    assert connector.parameters == {"timeout": "communication_timeout"}
    assert (connector.block_write, connector.block_read) == (("selector_w",), ("selector_1", "selector_2"))
    assert (model.read_selectors, model.capacities) == ({0: "", 1: "speed"}, {3: "VFX-2007"})
    assert [(d.name, d.of, d.base, d.unit, d.digits) for d in model.derived] == [
        ("speed_hz", "speed", "rated", "Hz", 1)
    ]
    assert model.profile == ((("speed", "speed_hz"), "1s"),)
    timeout = model.registers["communication_timeout"]
    assert (timeout.minimum, timeout.maximum, timeout.initial) == (1, 1000, 1)
    assert (timeout.is_writable, timeout.storage, timeout.writable_while_running) == (True, Storage.EEPROM, False)
    assert (timeout.takes_effect_after_reset, timeout.maximum_from) == (True, "rated")
    assert model.registers["speed"].decode(0xFFFF) == Decimal("-0.01")
    assert model.registers["trip_code"].text(24) == "err5: Time-out"
    assert model.registers["selector_1"].text(1) == "Speed"


def test_held_gives_the_register_of_the_value_at_a_trip(tmp_path: Path) -> None:
    """It has the unit, scale and sign of the value that it holds."""
    model = load([written(tmp_path, WHOLE_MODEL)])["vf-x"]
    held, speed = model.registers["trip_speed"], model.registers["speed"]
    assert (held.address, held.kind, held.title) == (0xFE00, Kind.TRIP_HELD, "Speed, held at a trip")
    assert (held.unit, held.scaling, held.source) == (speed.unit, speed.scaling, speed.source)


def test_a_file_extends_a_model_and_leaves_the_rest_as_it_was(tmp_path: Path) -> None:
    """Registers, codes, capacities, times and derived values are added; the profile is replaced."""
    before = load()["vf-nc3"]
    after = load([written(tmp_path, EXTENSION)])["vf-nc3"]
    added = {"maximum_frequency", "rated_torque", "last_but_not_least"}
    assert set(after.registers) - set(before.registers) == added
    kept = set(before.registers) - {"frequency_command"}
    kept -= {name for name in kept if name == "trip_code" or name.startswith("past_trip_")}
    assert all(after.registers[name] == before.registers[name] for name in kept)
    assert after.profile == ((("status", "maximum_frequency"), "500ms"),)
    assert (after.times.processing, after.times.eeprom) == (0.03, before.times.eeprom)
    assert after.capacities == {**before.capacities, 99: "VFnC3-9999P"}
    assert after.derived[:-1] == before.derived
    assert after.at(0x0011) is after.registers["maximum_frequency"]
    assert (after.identity, after.blocks, after.connectors) == (before.identity, before.blocks, before.connectors)


@pytest.mark.hazard("H07")
@pytest.mark.parametrize("name", MODELS)
def test_what_would_cut_the_line_to_a_drive_is_never_written(name: str) -> None:
    """F800-F802, F829 and typ; in a model that has them by its connector's roles too."""
    model = load()[name]
    assert model.cautions.never >= {0x0007, 0x0800, 0x0801, 0x0802, 0x0829}
    for connector in model.connectors:
        for role in ("baud_rate", "parity", "number", "protocol"):
            if role in connector.parameters:
                assert model.registers[connector.parameters[role]].address in model.cautions.never


def test_a_file_adds_to_the_cautions_of_a_model(tmp_path: Path) -> None:
    """What was to be careful of before still is."""
    text = 'extend = "vf-nc3"\n[cautions]\nnever = [0x0011]\nmay_start = ["free_notes"]\nsource = "x"'
    before, after = load()["vf-nc3"].cautions, load([written(tmp_path, text)])["vf-nc3"].cautions
    assert after.never == before.never | {0x0011}
    assert after.may_start == before.may_start | {"free_notes"}
    assert (after.keys, after.unanswered) == (before.keys, before.unanswered)


def test_codes_added_to_a_table_are_known_wherever_it_is_used(tmp_path: Path) -> None:
    """A new trip code is said by the trip code, by the past trips and by the file's own register."""
    registers = load([written(tmp_path, EXTENSION)])["vf-nc3"].registers
    for name in ("trip_code", "past_trip_4", "last_but_not_least"):
        assert registers[name].text(99) == "e-99: A new one"
        assert registers[name].text(24) == "err5: Communication time-out error"


def test_a_replaced_register_stands_in_for_the_built_in_one(tmp_path: Path) -> None:
    """The setpoint gets its upper limit from a register that the file adds."""
    replaced = load([written(tmp_path, EXTENSION)])["vf-nc3"].registers["frequency_command"]
    assert replaced.maximum_from == "maximum_frequency"
    assert load()["vf-nc3"].registers["frequency_command"].maximum_from == ""


def test_files_build_on_those_before_them(tmp_path: Path) -> None:
    """A second file extends the model that the first one gave."""
    first = written(tmp_path, WHOLE_MODEL, "first.toml")
    second = written(tmp_path, 'extend = "vf-x"' + REGISTER, "second.toml")
    assert load([first, second])["vf-x"].registers["extra"].address == 0x0777
    with pytest.raises(BadConfig, match=r"second\.toml: extend: no model 'vf-x'; known: vf-as3, vf-mb1, vf-nc3"):
        load([second, first])


def test_the_example_of_the_documentation_loads(tmp_path: Path) -> None:
    """docs/catalogue.md shows files that work: one that extends a model, and a whole model."""
    page = Path(__file__).parents[2] / "docs" / "catalogue.md"
    examples = re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    extending = [text for text in examples if text.startswith("extend")]
    whole = [text for text in examples if text.startswith("[model]")]
    assert extending
    assert whole
    files = [written(tmp_path, text, f"{i}.toml") for i, text in enumerate(extending + whole)]
    assert len(load(files)) == len(MODELS) + len(whole)
