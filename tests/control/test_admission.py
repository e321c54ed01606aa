"""Who may write what: sources, commands, registers, ranges, and the limits of configuration and drive."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.control.admission import Admission, NotAdmitted, Plan
from gateway.control.command import Channel, Command, Reason, Source, Verb
from gateway.control.settings import settings_of

PLC = Source(Channel.MODBUS_TCP, "10.0.0.7")
PANEL = Source(Channel.MQTT, "panel")
STRANGER = Source(Channel.MQTT, "stranger")
RIGHTS = [
    {"source": "modbus-tcp", "name": "10.0.0.*"},
    {"source": "mqtt", "name": "panel", "commands": ["frequency", "set"], "registers": ["frequency_*"], "max": 40},
]


def admission(**more: Any) -> Admission:
    """Return the admission of one VF-nC3."""
    drive = {"name": "d1", "number": 1, "model": "vf-nc3", "control": "leased", **more}
    table = {"gateway": {"name": "t"}, "line": [{"name": "a", "port": "/dev/null", "drive": [drive]}]}
    built = site.build(table, "test", Path()).drives[0]
    assert built.section is not None
    settings = settings_of(built.section)
    assert settings is not None
    return Admission(built, settings)


def plan(admitted: Admission, verb: Verb, source: Source, *, own: bool = True, **more: Any) -> Plan:
    """Check and plan one command."""
    value = more.pop("value", None)
    known = more.pop("known", {"command": 0})
    number = None if value is None else Decimal(value)
    command = Command("d1", verb, source, 0.0, 1.0, value=number, **more)
    admitted.check_right(command)
    return admitted.plan(command, known, is_own=own)


def refusal(admitted: Admission, verb: Verb, source: Source, **more: Any) -> Reason:
    """Return why a command is refused."""
    with pytest.raises(NotAdmitted) as refused:
        plan(admitted, verb, source, **more)
    return refused.value.reason


@pytest.mark.hazard("H37")
def test_a_channel_that_is_not_a_source_may_not_even_stop() -> None:
    """Whatever a broker's own rules let through."""
    admitted = admission(sources=["modbus-tcp"])
    for verb in (Verb.STOP, Verb.EMERGENCY_STOP, Verb.FREQUENCY):
        assert refusal(admitted, verb, PANEL, value="1") is Reason.NOT_PERMITTED
    assert plan(admitted, Verb.STOP, PLC).is_stop


@pytest.mark.hazard("H28", "H37")
def test_rights_are_by_source_command_register_and_range() -> None:
    """What no right covers is refused; stopping needs none."""
    admitted = admission(right=RIGHTS)
    assert plan(admitted, Verb.FREQUENCY, PANEL, value="40")
    assert refusal(admitted, Verb.FREQUENCY, PANEL, value="40.01") is Reason.NOT_PERMITTED
    assert refusal(admitted, Verb.RUN, PANEL) is Reason.NOT_PERMITTED
    assert refusal(admitted, Verb.SET, PANEL, name="terminal_output", value="1") is Reason.NOT_PERMITTED
    assert refusal(admitted, Verb.FREQUENCY, STRANGER, value="1") is Reason.NOT_PERMITTED
    assert plan(admitted, Verb.STOP, STRANGER).is_stop
    assert plan(admitted, Verb.RUN, PLC, value="50").is_motion


@pytest.mark.hazard("H31")
def test_a_frequency_outside_the_configured_range_is_refused_in_every_form() -> None:
    """As a typed command, with a run command, by name, and raw."""
    admitted = admission(frequency={"min": 5.0, "max": 40.0})
    for verb, more in (
        (Verb.FREQUENCY, {"value": "40.01"}),
        (Verb.FREQUENCY, {"value": "4.99"}),
        (Verb.RUN, {"value": "50"}),
        (Verb.SET, {"name": "frequency_command", "value": "50"}),
        (Verb.WORDS, {"address": 0xFA01, "words": (5000,)}),
    ):
        assert refusal(admitted, verb, PLC, **more) is Reason.RANGE
    assert plan(admitted, Verb.FREQUENCY, PLC, value="40")


@pytest.mark.hazard("H07", "H28")
@pytest.mark.parametrize("address", [0x0800, 0x0801, 0x0802, 0x0829, 0x0007])
def test_what_cuts_the_line_to_a_drive_is_never_written(address: int) -> None:
    """F800-F802, F829, typ; not even with `allow_stored`. What the catalogue does not have is not written anyway."""
    reason = refusal(admission(allow_stored=True), Verb.WORDS, PLC, address=address, words=(1,))
    assert reason is (Reason.NOT_IN_MODEL if address == 0x0007 else Reason.FORBIDDEN)


@pytest.mark.hazard("H22")
def test_several_words_are_all_checked_before_the_first_is_sent() -> None:
    """A good one in front of a bad one is not written either."""
    admitted = admission(frequency={"max": 40.0})
    reason = refusal(admitted, Verb.WORDS, PLC, address=0xFA00, words=(0xC400, 5000))
    assert reason is Reason.RANGE


@pytest.mark.hazard("H04")
@pytest.mark.parametrize(
    ("word", "own", "written"),
    [
        (0x8000, False, 0x8000),
        (0xC000, False, 0xC000),
        (0x9000, False, 0x9000),
        (0x0000, False, 0x8000),  # the priority is kept: the terminals might start the motor
        (0x4000, False, 0xC000),
        (0x8C00, False, 0x8800),  # coasts, and does not run when the coast bit goes
        (0x1400, False, 0x9000),  # emergency stop wins
        (0xB000, False, 0x9000),  # a reset is for the owner
        (0x0000, True, 0x0000),
        (0x8C00, True, 0x8C00),
        (0x1400, True, 0x1400),
        (0xB400, True, 0x9400),  # of an emergency stop and a reset, the emergency stop
    ],
)
def test_a_raw_command_word_without_motion_is_a_stop(word: int, *, own: bool, written: int) -> None:
    """The owner's is written as it is, another one's so that it can only stop."""
    for more in ({"address": 0xFA00, "words": (word,)}, {"name": "command", "value": str(word)}):
        verb = Verb.WORDS if "words" in more else Verb.SET
        made = plan(admission(), verb, PLC, own=own, **more)
        assert made.is_stop
        assert not made.is_motion
        assert not made.is_reset
        assert [write.word for write in made.writes] == [written]


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("word", [0x8400, 0x8100, 0xA000])
def test_a_raw_command_word_that_runs_or_resets_is_no_stop(word: int, *, own: bool) -> None:
    """A reset with a coast bit is its owner's reset, too."""
    made = plan(admission(), Verb.WORDS, PLC, own=own, address=0xFA00, words=(word,))
    assert not made.is_stop
    assert made.is_motion is (word != 0xA000)
    assert made.is_reset is (word == 0xA000)
    made = plan(admission(), Verb.WORDS, PLC, address=0xFA00, words=(0xA800,))
    assert (made.is_stop, made.is_reset) == (False, True)


@pytest.mark.parametrize("word", [0xA400, 0xE400])
def test_a_reset_with_the_run_bit_is_a_wrong_value(word: int) -> None:
    """Not a wrong register."""
    assert refusal(admission(), Verb.WORDS, PLC, address=0xFA00, words=(word,)) is Reason.RANGE


def test_a_stop_within_a_block_goes_first() -> None:
    """FA00 and FA01 in one request: a PLC's usual way."""
    made = plan(admission(), Verb.WORDS, PLC, address=0xFA00, words=(0x8000, 0))
    assert made.is_stop
    assert [write.register.name for write in made.writes] == ["command", "frequency_command"]


@pytest.mark.hazard("H04", "H28")
@pytest.mark.parametrize("words", [(0x8000, 5500), (0x0000, 0), (0x8000, 9000), (0x9400, 1, 2)])
def test_a_stop_of_another_source_carries_nothing_behind_it(words: tuple[int, ...]) -> None:
    """FA00 alone is a stop for everybody; whatever else stands there is not even looked at."""
    made = plan(admission(), Verb.WORDS, PLC, own=False, address=0xFA00, words=words)
    assert made.is_stop
    assert [write.register.name for write in made.writes] == ["command"]
    assert made.beside[0] is Reason.NONE
    assert "left out" in made.beside[1]


@pytest.mark.hazard("H04", "H22")
@pytest.mark.parametrize(
    ("words", "reason"),
    [((0x8000, 5000), Reason.RANGE), ((0, 5000), Reason.RANGE), ((0x9000, 0, 0), Reason.NOT_IN_MODEL)],
)
def test_a_stop_of_the_owner_is_not_lost_by_what_stands_beside_it(words: tuple[int, ...], reason: Reason) -> None:
    """It alone is written, and then what is wrong is told."""
    made = plan(admission(frequency={"max": 40.0}), Verb.WORDS, PLC, address=0xFA00, words=words)
    assert made.is_stop
    assert [write.register.name for write in made.writes] == ["command"]
    assert made.beside[0] is reason
    assert made.beside[1].startswith("stopped; not written: ")


@pytest.mark.hazard("H04", "H28")
@pytest.mark.parametrize("own", [True, False])
def test_a_raw_stop_needs_no_right(*, own: bool) -> None:
    """Neither to the verb nor to the register; what stands beside it does. No source, no stop."""
    rights = [{"source": "mqtt", "name": "panel", "commands": ["words"], "registers": ["frequency_*"], "max": 40}]
    admitted = admission(right=rights)
    for source in (STRANGER, PANEL):
        made = plan(admitted, Verb.WORDS, source, own=own, address=0xFA00, words=(0x8000,))
        assert made.is_stop
        made = plan(admitted, Verb.SET, source, own=own, name="command", text="command_priority")
        assert made.is_stop
    made = plan(admitted, Verb.WORDS, STRANGER, own=own, address=0xFA00, words=(0x8000, 3000))
    assert [write.register.name for write in made.writes] == ["command"]
    made = plan(admitted, Verb.WORDS, PANEL, address=0xFA00, words=(0x8000, 5000))
    assert made.beside[0] is Reason.NOT_PERMITTED
    assert refusal(admitted, Verb.WORDS, STRANGER, own=own, address=0xFA00, words=(0x8400,)) is Reason.NOT_PERMITTED
    assert refusal(admitted, Verb.WORDS, PANEL, own=own, address=0xFA00, words=(0xA000,)) is Reason.NOT_PERMITTED
    made = plan(admitted, Verb.WORDS, PANEL, own=own, address=0xFA00, words=(0xA800,))
    assert (made.is_stop, made.is_reset, made.writes[0].word) == (True, False, 0x8800)
    no_source = admission(sources=["modbus-tcp"])
    assert refusal(no_source, Verb.WORDS, PANEL, address=0xFA00, words=(0x8000,)) is Reason.NOT_PERMITTED


@pytest.mark.hazard("H31")
def test_the_panels_frequency_is_limited_as_well() -> None:
    """FA03 is in Hz like FA01."""
    admitted = admission(frequency={"max": 10.0}, allow_stored=True)
    assert refusal(admitted, Verb.SET, PLC, name="panel_frequency", value="60") is Reason.RANGE


@pytest.mark.hazard("H18")
@pytest.mark.parametrize("value", ["1e30", "-1", "1e-30", "15.5"])
def test_an_absurd_number_is_refused_and_ends_nothing(value: str) -> None:
    """However large or small."""
    assert refusal(admission(), Verb.PRESET, PLC, value=value) is Reason.RANGE


@pytest.mark.hazard("H31")
def test_a_speed_is_judged_by_the_limits_in_hertz() -> None:
    """By F856: code 2 stands for 4 poles, so that 1800 min-1 are 60 Hz; where it is not known, nothing is guessed."""
    admitted = admission(model="vf-mb1", frequency={"min": 10, "max": 50})
    known = {"command": 0, "motor_poles": 2}
    assert plan(admitted, Verb.SPEED, PLC, value="1500", known=known).writes[0].word == 1500
    for value in ("1501", "299"):
        assert refusal(admitted, Verb.SPEED, PLC, value=value, known=known) is Reason.RANGE
    assert refusal(admitted, Verb.SPEED, PLC, value="1500") is Reason.NOT_PERMITTED


def test_a_run_after_a_speed_takes_its_frequency_from_the_line() -> None:
    """Bit 14 is set as after a frequency: else the panel's would count."""
    admitted = admission(model="vf-mb1")
    known = {"command": 0, "motor_speed_command": 1500}
    assert [write.word for write in plan(admitted, Verb.RUN, PLC, known=known).writes] == [0xC400]
