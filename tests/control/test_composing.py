"""What typed commands come to in FA00, FA01 and their like: set, cleared, and left as the drive has them (7.1)."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from gateway.control.command import Channel, Command, Reason, Source, Verb
from gateway.control.composing import NotComposable, compose
from gateway.drives.catalogue import load

NC3 = load()["vf-nc3"]
MB1 = load()["vf-mb1"]
SOURCE = Source(Channel.MQTT)


def command(verb: Verb, value: str | None = None, **more: Any) -> Command:
    """Return a command of one source."""
    return Command("d1", verb, SOURCE, 0.0, 1.0, value=None if value is None else Decimal(value), **more)


def words(asked: Command, known: dict[str, int] | None = None, model: Any = NC3) -> dict[str, int]:
    """Return what is written, by register, in its order."""
    return {step.register.name: step.word for step in compose(asked, model, known or {})}


@pytest.mark.parametrize(
    ("asked", "before", "word"),
    [
        (command(Verb.RUN), 0x0000, 0x8400),
        (command(Verb.RUN, is_reverse=True), 0x0000, 0x8600),
        (command(Verb.RUN), 0xC600, 0xC400),  # forward again: bit 9 is cleared, bit 14 stays
        (command(Verb.RUN), 0x8010, 0x8410),  # motor 2 stays chosen
        (command(Verb.RUN), 0x980F, 0x8400),  # neither coast, emergency stop nor a preset speed survives
        (command(Verb.STOP), 0xC400, 0xC000),
        (command(Verb.STOP), 0x0000, 0x8000),  # a drive that its panel runs is stopped as well
        (command(Verb.STOP), 0xC640, 0xC240),  # direction and acceleration pattern are no motion
        (command(Verb.COAST), 0xC400, 0xC800),
        (command(Verb.EMERGENCY_STOP), 0xC400, 0xD000),
        (command(Verb.RESET), 0xC400, 0xE000),  # never with a run bit (SAFETY.md H09)
        (command(Verb.JOG), 0x8000, 0x8500),
        (command(Verb.PRESET, "5"), 0xC400, 0xC405),
        (command(Verb.PRESET, "0"), 0xC40F, 0xC400),
        (command(Verb.ACCELERATION, "2"), 0xC400, 0xC440),
        (command(Verb.ACCELERATION, "1"), 0xC440, 0xC400),
        (command(Verb.RELEASE_PRIORITY), 0xC410, 0x0010),
    ],
)
def test_the_command_word_is_composed_and_preserved(asked: Command, before: int, word: int) -> None:
    """By the bits of E6581657 7.1."""
    assert words(asked, {"command": before}) == {"command": word}


@pytest.mark.hazard("H10")
def test_the_frequency_goes_before_the_run_bit() -> None:
    """As one unit, with priority for the frequency from the line."""
    steps = words(command(Verb.RUN, "60"), {"command": 0})
    assert list(steps.items()) == [("frequency_command", 6000), ("command", 0xC400)]


def test_run_without_a_frequency_uses_the_one_that_was_set_before() -> None:
    """Else the drive would run at whatever its panel says."""
    assert words(command(Verb.RUN), {"command": 0, "frequency_command": 3000}) == {"command": 0xC400}


def test_a_setpoint_for_a_running_drive_takes_effect() -> None:
    """Where it runs by command, but its frequency comes from elsewhere, bit 14 is set as well."""
    assert words(command(Verb.FREQUENCY, "30"), {"command": 0x8400}) == {"frequency_command": 3000, "command": 0xC400}
    assert words(command(Verb.FREQUENCY, "30"), {"command": 0xC400}) == {"frequency_command": 3000}
    assert words(command(Verb.FREQUENCY, "30"), {"command": 0x0000}) == {"frequency_command": 3000}


@pytest.mark.parametrize(
    ("asked", "register", "word"),
    [
        (command(Verb.SPEED, "1800"), "motor_speed_command", 0x0708),  # as the manual's example has it
        (command(Verb.ANALOG, "100"), "analog_output", 1000),  # in 0.1 %
        (command(Verb.TERMINALS, "1"), "terminal_output", 1),
    ],
)
def test_other_values_have_registers_of_their_own(asked: Command, register: str, word: int) -> None:
    """FA13, FA51, FA50 of a VF-MB1."""
    assert words(asked, {"command": 0}, MB1)[register] == word


def test_raw_words_have_the_command_word_last() -> None:
    """So that the motor starts with the frequency that came with it."""
    asked = command(Verb.WORDS, address=0xFA00, words=(0xC400, 3000))
    assert list(words(asked)) == ["frequency_command", "command"]


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        (command(Verb.SPEED, "1800"), Reason.NOT_IN_MODEL),  # a VF-nC3 has no FA13
        (command(Verb.FREQUENCY), Reason.MALFORMED),
        (command(Verb.FREQUENCY, "-1"), Reason.RANGE),
        (command(Verb.FREQUENCY, "30.001"), Reason.RANGE),
        (command(Verb.PRESET, "16"), Reason.RANGE),
        (command(Verb.PRESET, "1.5"), Reason.RANGE),
        (command(Verb.ACCELERATION, "3"), Reason.RANGE),
        (command(Verb.SET, "1", name="nothing"), Reason.NOT_IN_MODEL),
        (command(Verb.WORDS, address=0xFA02, words=(1,)), Reason.NOT_IN_MODEL),
    ],
)
@pytest.mark.hazard("H31")
def test_what_cannot_be_is_refused_and_never_clamped(asked: Command, reason: Reason) -> None:
    """With a word for programs."""
    with pytest.raises(NotComposable) as refused:
        compose(asked, NC3, {"command": 0})
    assert refused.value.reason is reason


def test_every_verb_that_writes_is_composed() -> None:
    """For the model that has all of it."""
    values = {Verb.PRESET: "1", Verb.ACCELERATION: "1"}
    for verb in set(Verb) - {Verb.ARM, Verb.TAKE, Verb.RELEASE, Verb.WORDS}:
        asked = command(verb, values.get(verb, "1"), name="frequency_command")
        assert compose(asked, MB1, {"command": 0}), verb


def test_the_catalogue_is_where_it_is_said_to_be() -> None:
    """The bits are read from the model's file, not known here."""
    text = (Path(__file__).parents[2] / "gateway" / "drives" / "data" / "vf_nc3.toml").read_text()
    assert '14 = "frequency_priority"' in text
