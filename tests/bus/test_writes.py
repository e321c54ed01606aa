"""What a write comes to: the request, what it does, or why it is refused."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.control.writes import (
    NOTHING,
    Allowed,
    BadCommand,
    PlannedWrite,
    Verdict,
    Why,
    judge,
    limited_by,
    plan_write,
)
from gateway.drives.catalogue import load
from gateway.drives.model import Model
from gateway.drives.register import Storage
from gateway.protocol.pdu import EVERY_DRIVE, WriteRam, WriteStored
from gateway.protocol.registry import PROTOCOLS
from tests.drives.files import written

MODELS = load()
MB1 = MODELS["vf-mb1"]
TOSHIBA = ("toshiba-ascii", "toshiba-binary")
STORED = Allowed(stored=True)
EVERYTHING = Allowed(stored=True, keys=True)

LIMITED = """
extend = "vf-mb1"
[[register]]
name = "maximum_frequency"
address = 0x0011
kind = "parameter"
title = "Maximum frequency (FH)"
unit = "Hz"
scale = "0.1"
source = "instruction manual"
[[register]]
name = "frequency_command"
replaces = true
address = 0xFA01
kind = "command"
unit = "Hz"
scale = "0.01"
maximum_from = "maximum_frequency"
access = "rw"
storage = "ram"
source = "8.1"
[[register]]
name = "standard_setting"
address = 0x0007
kind = "parameter"
title = "Back to what was shipped (typ)"
access = "rw"
storage = "eeprom"
source = "instruction manual"
"""


def plan(
    name: str, word: int, protocol: str = "toshiba-binary", allowed: Allowed = NOTHING, model: Model = MB1
) -> PlannedWrite:
    """Plan a write to drive 1."""
    return plan_write(model, PROTOCOLS[protocol], 1, model.registers[name], word, allowed)


def refusal(name: str, word: int, protocol: str = "toshiba-binary", allowed: Allowed = NOTHING) -> tuple[Why, str]:
    """Return why a write is refused, and what is said of it."""
    with pytest.raises(BadCommand) as caught:
        plan(name, word, protocol, allowed)
    return caught.value.why, str(caught.value)


@pytest.mark.hazard("H08")
@pytest.mark.parametrize("protocol", TOSHIBA)
def test_toshiba_writes_a_stored_parameter_to_ram_unless_asked(protocol: str) -> None:
    """P by default, W where it is allowed; both are named."""
    ram = plan("acceleration_time_1", 50, protocol)
    assert ram.request == WriteRam(1, 0x0009, 50)
    assert (ram.used, ram.wears_eeprom) == ("P, RAM only: lost when the drive is reset", False)
    stored = plan("acceleration_time_1", 50, protocol, STORED)
    assert stored.request == WriteStored(1, 0x0009, 50)
    assert (stored.used, stored.wears_eeprom) == ("W, RAM and EEPROM: wears it", True)


@pytest.mark.hazard("H08")
def test_modbus_never_wears_the_eeprom_silently() -> None:
    """It has no write of a stored parameter to RAM: refused, or explicitly permitted."""
    why, said = refusal("acceleration_time_1", 50, "modbus-rtu")
    assert why is Why.STORED
    assert said.startswith("acceleration_time_1 (0009) is a stored parameter, and modbus-rtu can write it to the EEP")
    stored = plan("acceleration_time_1", 50, "modbus-rtu", STORED)
    assert stored.request == WriteStored(1, 0x0009, 50)
    assert stored.used == "06H, RAM and EEPROM: wears it"


@pytest.mark.parametrize("allowed", [NOTHING, STORED])
@pytest.mark.parametrize(("protocol", "command"), [("modbus-rtu", "06H"), *((name, "P") for name in TOSHIBA)])
def test_what_has_no_place_in_the_eeprom_goes_to_ram_whatever_is_allowed(
    protocol: str, command: str, allowed: Allowed
) -> None:
    """FA01 is RAM only in every protocol."""
    planned = plan("frequency_command", 3000, protocol, allowed)
    assert planned.request == WriteRam(1, 0xFA01, 3000)
    assert (planned.used, planned.wears_eeprom, planned.is_answered) == (f"{command}, RAM only", False, True)


def test_what_acts_after_a_reset_only_is_not_written_to_ram() -> None:
    """The reset that would put it in force brings the EEPROM's value back."""
    why, said = refusal("block_read_1", 2)
    assert why is Why.NO_EFFECT
    assert "acts after a reset only" in said
    assert plan("block_read_1", 2, allowed=STORED).wears_eeprom


def test_a_read_only_register_is_not_written() -> None:
    """By name and number."""
    assert refusal("output_frequency", 1) == (Why.READ_ONLY, "output_frequency (FD00) is read-only")


@pytest.mark.hazard("H07")
@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", ["baud_rate", "parity", "number", "protocol"])
def test_what_would_cut_the_line_is_never_written(name: str, protocol: str) -> None:
    """F800, F801, F802, F829: not even where everything is allowed."""
    why, said = refusal(name, 1, protocol, Allowed(stored=True, keys=True))
    assert why is Why.FORBIDDEN
    assert "is never written" in said


@pytest.mark.hazard("H07")
def test_a_file_of_the_user_opens_no_way_to_typ_or_to_the_number(tmp_path: Path) -> None:
    """By number for what the built-in models name; by role for a model of one's own."""
    model = load([written(tmp_path, LIMITED)])["vf-mb1"]
    bare = replace(model, cautions=MODELS["vf-as3"].cautions.__class__())
    for of, name in ((model, "standard_setting"), (bare, "number")):
        with pytest.raises(BadCommand, match="is never written") as caught:
            plan(name, 3, allowed=STORED, model=of)
        assert caught.value.why is Why.FORBIDDEN


def test_the_panels_keys_are_not_taken_away_unless_explicitly_allowed() -> None:
    """FA10 and FA11: the STOP key goes with them."""
    for name in ("panel_key_selection", "external_keys"):
        why, said = refusal(name, 1, allowed=STORED)
        assert why is Why.KEYS
        assert "the STOP key too" in said
        assert plan(name, 1, allowed=Allowed(keys=True)).request == WriteRam(1, MB1.registers[name].address, 1)


@pytest.mark.hazard("H31")
def test_what_is_out_of_range_is_refused_and_never_clamped() -> None:
    """The register's own range, and undefined bits."""
    assert refusal("communication_timeout", 1001) == (
        Why.RANGE,
        "communication_timeout (0803): 100.1 is outside 0.0 to 100.0 s",
    )
    why, said = refusal("command_2", 0x0001)
    assert (why, "sets undefined bits: 0001H" in said) == (Why.RANGE, True)


@pytest.mark.hazard("H31")
def test_what_another_register_limits_is_refused_beyond_it(tmp_path: Path) -> None:
    """FH in a scale of its own; not judged where it was not read."""
    model = load([written(tmp_path, LIMITED)])["vf-mb1"]
    frequency = model.registers["frequency_command"]
    assert [register.name for register in limited_by(model, frequency)] == ["maximum_frequency"]
    assert limited_by(MB1, MB1.registers["frequency_command"]) == ()
    bounds = {"maximum_frequency": 800}
    codec = PROTOCOLS["modbus-rtu"]
    assert plan_write(model, codec, 1, frequency, 8000, bounds=bounds).word == 8000
    with pytest.raises(BadCommand, match=r"80\.01 is beyond maximum_frequency \(0011\), 80\.0 Hz"):
        plan_write(model, codec, 1, frequency, 8001, bounds=bounds)
    assert plan_write(model, codec, 1, frequency, 8001).word == 8001


STARTING = [
    ("command", 0x8400),  # run
    ("command", 0x0100),  # jog
    ("command", 0xA000),  # a fault reset, for a run signal at the terminals is obeyed after it
    ("frequency_command", 1),
    ("motor_speed_command", 1),
    ("panel_frequency", 1),
    ("command_2", 0x0100),
    ("external_keys", 0x0001),
    ("external_keys", 0x0004),
    ("local_remote", 0),  # hands over to whoever commands from elsewhere
    ("local_remote", 1),
]
STOPPING = [
    ("command", 0),
    ("command", 0x8000),
    ("command", 0xC040),
    ("command", 0x1000),
    ("command", 0x0800),
    ("command", 0x8C00),  # coast and run: the output is off
    ("command", 0x9400),
    ("frequency_command", 0),
    ("motor_speed_command", 0),
    ("panel_frequency", 0),
    ("command_2", 0),
    ("command_2", 0x0080),
    ("external_keys", 0x0002),
]


@pytest.mark.hazard("H09")
def test_a_fault_reset_is_not_answered_and_goes_alone() -> None:
    """Bit 13 of FA00; with the run bit it is refused."""
    reset = plan("command", 0xA000)
    assert reset.request == WriteRam(1, 0xFA00, 0xA000, is_answered=False)
    assert not reset.is_answered
    assert refusal("command", 0xA400)[0] is Why.RANGE  # the value is wrong, not the register
    assert plan("command", 0x9000).is_answered


def test_what_may_start_a_motor_says_so() -> None:
    """FA00, FA01, FA13, FA20, keys; not the time-out, nor the display."""
    for name, word in STARTING:
        assert plan(name, word, allowed=EVERYTHING).may_start, (name, word)
    for name in ("communication_timeout", "led_number"):
        assert not plan(name, 1, allowed=EVERYTHING).may_start, name


def test_a_stop_starts_nothing() -> None:
    """Nobody shall be asked first: emergency stop, coast, run bit cleared, speed 0, the STOP key."""
    for name, word in STOPPING:
        assert not plan(name, word, allowed=EVERYTHING).may_start, (name, word)


def test_a_number_that_the_protocol_has_not_got_is_refused_before_anything_is_sent() -> None:
    """Binary ends at 63; a group has its frame."""
    with pytest.raises(BadCommand, match=r"frequency_command \(FA01\): .*number.* 64") as caught:
        plan_write(MB1, PROTOCOLS["toshiba-binary"], 64, MB1.registers["frequency_command"], 0)
    assert caught.value.why is Why.NO_FORM
    everybody = plan_write(MB1, PROTOCOLS["modbus-rtu"], EVERY_DRIVE, MB1.registers["frequency_command"], 0)
    assert everybody.request.number == EVERY_DRIVE


@given(st.data())
def test_every_plan_keeps_the_rules(data: st.DataObject) -> None:
    """Whatever is asked of whatever register: in range, writable, worn only by permission; never clamped."""
    model = data.draw(st.sampled_from(sorted(MODELS.values(), key=lambda model: model.name)))
    register = data.draw(st.sampled_from(sorted(model.registers.values(), key=lambda register: register.address)))
    codec = PROTOCOLS[data.draw(st.sampled_from(sorted(PROTOCOLS)))]
    allowed = Allowed(data.draw(st.booleans()), data.draw(st.booleans()))
    word = data.draw(st.integers(0, 0xFFFF))
    try:
        planned = plan_write(model, codec, 5, register, word, allowed)
    except BadCommand:
        return
    raw = register.scaling.raw(word)
    assert planned.request.word == planned.word == word
    assert register.is_writable
    assert register.address not in model.cautions.never
    assert register.minimum is None or raw >= register.minimum
    assert register.maximum is None or raw <= register.maximum
    assert word & ~register.mask == 0
    assert not planned.wears_eeprom or (allowed.stored and register.storage is Storage.EEPROM)
    assert allowed.keys or register.name not in model.cautions.keys
    assert codec.forms.has_ram_write or planned.wears_eeprom or register.storage is Storage.RAM
    assert codec.encode(planned.request)


def test_a_write_is_judged_by_what_reads_back() -> None:
    """Acknowledged or not; undefined bits do not count; silence is unknown, never failed."""
    write = plan("frequency_command", 3000)
    assert judge(write, 3000) is Verdict.DONE
    assert judge(write, 0) is Verdict.NOT_DONE
    assert judge(write, None) is Verdict.UNKNOWN
    assert judge(write, 0, is_refused=True) is Verdict.REFUSED
    assert judge(plan("command_2", 0x0080), 0x8080) is Verdict.DONE
    assert [verdict for verdict in Verdict if verdict.is_good] == [Verdict.DONE, Verdict.EQUAL]


def test_the_value_in_a_refusal_is_the_engineering_one() -> None:
    """As it was given."""
    assert str(Decimal("100.1")) in refusal("communication_timeout", 1001)[1]
