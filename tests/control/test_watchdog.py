"""The drive's own time-out: what it has to be so that the drive stops, and what is written for that."""

from __future__ import annotations

from typing import Any

import pytest

from gateway.config import DriveSection
from gateway.control import watchdog
from gateway.control.settings import ControlSettings, settings_of
from gateway.drives import catalogue
from gateway.drives.model import Model

MODELS = catalogue.load()
NC3, MB1, AS3 = MODELS["vf-nc3"], MODELS["vf-mb1"], MODELS["vf-as3"]
SET = {"communication_timeout": 15, "timeout_action": 2, "timeout_detection": 1}

both_models = pytest.mark.parametrize("model", [NC3, MB1], ids=["vf-nc3", "vf-mb1"])


def section(**more: Any) -> DriveSection:
    """Return a commanded drive."""
    return DriveSection.model_validate({"name": "p", "number": 1, "model": "vf-nc3", "control": "leased", **more})


def settings(**more: Any) -> ControlSettings:
    """Return its control."""
    found = settings_of(section(**more))
    assert found is not None
    return found


@pytest.mark.hazard("H06")
@both_models
def test_a_drive_as_shipped_would_go_on_running(model: Model) -> None:
    """F803 = 0.0, F804 = 0, F808 = 1 (E6581657 6.3, VF-MB1 manual 7.3)."""
    shipped = {register.name: register.initial for register in watchdog.registers(model).values()}
    assert shipped == {"communication_timeout": 0, "timeout_action": 0, "timeout_detection": 1}
    assert watchdog.missing(model, shipped).startswith("F803 is 0.0: ")


@pytest.mark.hazard("H06")
@both_models
@pytest.mark.parametrize("action", [1, 2])
@pytest.mark.parametrize("detection", [0, 1, 2])
def test_a_drive_that_trips_would_stop_whenever_its_timer_counts(model: Model, action: int, detection: int) -> None:
    """A motor that runs by FA00 runs in communication mode: every F808 of the manuals watches over it."""
    for tenths in (1, 1000):
        facts = {"communication_timeout": tenths, "timeout_action": action, "timeout_detection": detection}
        assert watchdog.missing(model, facts) == ""


@pytest.mark.hazard("H06")
@both_models
@pytest.mark.parametrize(
    ("name", "word", "said"),
    [
        ("communication_timeout", 0, "F803 is 0.0: "),
        ("communication_timeout", 1001, "F803 is 100.1: "),
        ("timeout_action", 0, "F804 is 0: "),
        ("timeout_action", 3, "F804 is 3: "),
        ("timeout_detection", 3, "F808 is 3: "),
    ],
)
def test_any_other_word_is_no_protection(model: Model, name: str, word: int, said: str) -> None:
    """Off, alarm only, and whatever no manual tells of."""
    assert watchdog.missing(model, SET | {name: word}).startswith(said)


@pytest.mark.hazard("H06")
def test_what_could_not_be_read_is_no_protection() -> None:
    """But F808, which a drive may not have."""
    for name in ("communication_timeout", "timeout_action"):
        unread = {key: word for key, word in SET.items() if key != name}
        assert "could not be read" in watchdog.missing(NC3, unread)
    assert watchdog.missing(NC3, {"communication_timeout": 15, "timeout_action": 1}) == ""


@pytest.mark.hazard("H06")
def test_of_two_connectors_nobody_knows_which_time_out_counts() -> None:
    """F803 of the one is not refreshed through the other, nor the other way round: VF-AS3."""
    said = watchdog.missing(AS3, SET)
    assert "2 connectors" in said
    assert "(F803, F823)" in said
    asked = section(model="vf-as3", communication_timeout="1s")
    assert dict(watchdog.contradictions(asked, AS3)) == {"communication_timeout": said}
    assert not list(watchdog.contradictions(section(model="vf-as3"), AS3))


@pytest.mark.hazard("H06")
def test_only_what_reads_otherwise_is_written_and_the_time_last() -> None:
    """F803 arms the timer: the action comes before it."""
    wanted = settings(communication_timeout="700ms", timeout_action="coast", timeout_detection="always")
    written = [(register.address, word) for register, word in watchdog.wanted(wanted, NC3, SET)]
    assert written == [(0x0804, 1), (0x0808, 0), (0x0803, 7)]
    now = {"communication_timeout": 7, "timeout_action": 1, "timeout_detection": 0}
    assert not list(watchdog.wanted(wanted, NC3, now))


def test_every_time_in_steps_of_a_tenth_can_be_had() -> None:
    """Whatever it is written in; nothing between."""
    for tenths in range(1, 1001):
        for text in (f"{tenths * 100}ms", f"{tenths // 10}.{tenths % 10}s"):
            assert not list(watchdog.contradictions(section(communication_timeout=text), NC3)), text
    ((key, said),) = watchdog.contradictions(section(communication_timeout="750ms"), NC3)
    assert (key, said) == ("communication_timeout", "F803: 0.75 is not a multiple of 0.1 s")


@pytest.mark.hazard("H05")
def test_a_drive_is_left_to_its_time_out_only_where_that_is_set() -> None:
    """The drive's own F803 may be 0: on_loss = "quiesce" needs a configured one."""
    assert not list(watchdog.contradictions(section(on_loss="quiesce", communication_timeout="1s"), NC3))
    ((key, _),) = watchdog.contradictions(section(on_loss="quiesce"), NC3)
    assert key == "on_loss"


def test_the_shorter_of_what_is_read_and_what_was_to_be_written_is_reckoned_with() -> None:
    """A write without an answer may have been done."""
    asked, silent = settings(communication_timeout="1s"), settings()
    assert watchdog.shortest(asked, NC3, {"communication_timeout": 0}) == 1.0
    assert watchdog.shortest(asked, NC3, {"communication_timeout": 5}) == 0.5
    assert watchdog.shortest(silent, NC3, {"communication_timeout": 5}) == 0.5
    assert watchdog.shortest(silent, NC3, {}) == 0.0
