"""What a scan tries, in which order, and how models are recognised."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from gateway.bus.groups import MODBUS
from gateway.commissioning import scan_plan
from gateway.commissioning.recognition import addresses, recognise
from gateway.commissioning.scan_plan import Setting, Wish
from gateway.drives.catalogue import load
from gateway.errors import BadConfig
from gateway.protocol.pdu import Identify, Identity, ReadWords
from gateway.protocol.registry import PROTOCOLS

MODELS = load()
WISH = Wish("/dev/ttyUSB0")


def test_the_settings_begin_as_the_drives_are_shipped() -> None:
    """19200 even first, then the other baud rates with even parity; all nine once."""
    tried = scan_plan.settings(WISH, has_parity=True, has_baud=True)
    assert tried[:3] == (Setting(19200, "even"), Setting(9600, "even"), Setting(38400, "even"))
    assert len(set(tried)) == 9
    assert scan_plan.settings(WISH, has_parity=False, has_baud=False) == (Setting(19200, "even"),)
    assert str(Setting(9600, "none")) == "9600 baud, no parity"


def test_the_first_look_asks_whether_anybody_speaks_toshiba_and_for_likely_numbers() -> None:
    """Few questions, for they are asked at every setting."""
    probes = scan_plan.first_look(WISH, MODELS)
    assert [(probe.protocol, probe.number) for probe in probes[:2]] == [
        ("toshiba-binary", None),
        ("toshiba-ascii", None),
    ]
    assert [(probe.protocol, probe.request) for probe in probes[2:]] == [(MODBUS, Identify(n)) for n in range(1, 17)]


def test_all_looks_together_ask_for_every_number_once() -> None:
    """MODBUS 1 to 247, binary 0 to 63, ASCII for those beyond."""
    looks = (scan_plan.first_look, scan_plan.second_look, scan_plan.every_toshiba)
    probes = [probe for look in looks for probe in look(WISH, MODELS) if probe.number is not None]
    asked = Counter((probe.protocol, probe.number) for probe in probes)
    assert set(asked.values()) == {1}
    assert {number for protocol, number in asked if protocol == MODBUS} == set(range(1, 248))
    assert {number for protocol, number in asked if protocol == "toshiba-binary"} == set(range(64))
    assert {number for protocol, number in asked if protocol == "toshiba-ascii"} == set(range(64, 100))


def test_numbers_that_are_given_are_asked_for_at_once_and_no_others() -> None:
    """In each protocol that has them."""
    wish = Wish("/dev/x", numbers=(0, 5, 70, 200))
    asked = {(p.protocol, p.number) for p in scan_plan.first_look(wish, MODELS) if p.number is not None}
    assert asked == {
        *(("toshiba-binary", n) for n in (0, 5)),
        *(("toshiba-ascii", n) for n in (0, 5, 70)),
        *((MODBUS, n) for n in (5, 70, 200)),
    }
    assert scan_plan.second_look(wish, MODELS) == scan_plan.every_toshiba(wish, MODELS) == ()


@pytest.mark.parametrize("protocols", [(MODBUS,), ("toshiba-ascii",), ("toshiba-binary", "toshiba-ascii")])
def test_no_other_protocol_than_those_wanted_is_spoken(protocols: tuple[str, ...]) -> None:
    """Whatever look it is."""
    wish = Wish("/dev/x", protocols=protocols)
    looks = (scan_plan.first_look, scan_plan.second_look, scan_plan.every_toshiba)
    assert {probe.protocol for look in looks for probe in look(wish, MODELS)} == set(protocols)


def test_a_scan_only_reads() -> None:
    """R, 03H and 2BH; every frame can be made."""
    looks = (scan_plan.first_look, scan_plan.second_look, scan_plan.every_toshiba)
    for probe in (probe for look in looks for probe in look(WISH, MODELS)):
        assert isinstance(probe.request, Identify | ReadWords)
        assert PROTOCOLS[probe.protocol].encode(probe.request)


def test_the_longest_time_is_that_of_the_line() -> None:
    """Slower at 9600, longer with a waiting time: never a constant."""
    probes = scan_plan.first_look(WISH, MODELS)
    patience = scan_plan.patience(MODELS, 0.0)
    assert patience == max(model.times.processing for model in MODELS.values())
    slow, fast = (scan_plan.longest(probes, Setting(baud, "even"), patience, 0.05) for baud in (9600, 38400))
    assert slow > fast > len(probes) * (patience + 0.05)
    waiting = scan_plan.longest(probes, Setting(9600, "even"), scan_plan.patience(MODELS, 0.2), 0.05)
    assert waiting == pytest.approx(slow + 0.2 * len(probes))


def test_numbers_and_protocols_of_the_command_line() -> None:
    """Lists and ranges; "toshiba" is both of its modes."""
    assert scan_plan.numbers_of("1-3, 7,2") == (1, 2, 3, 7)
    assert scan_plan.protocols_of(["toshiba"]) == ("toshiba-binary", "toshiba-ascii")
    assert scan_plan.protocols_of([]) == ("toshiba-binary", "toshiba-ascii", MODBUS)
    scan_plan.one_of("--baud", [9600], "baud")
    wrong: list[tuple[Any, str]] = [
        (lambda: scan_plan.numbers_of("a-3"), "--numbers 'a-3': give numbers from 0 to 247, such as 1-16,20"),
        (lambda: scan_plan.numbers_of("1-248"), "--numbers '1-248': 248 is above 247"),
        (lambda: scan_plan.numbers_of("20-10"), "--numbers '20-10': 20-10 is empty; give 10-20"),
        (lambda: scan_plan.numbers_of(""), "--numbers '': give numbers from 0 to 247, such as 1-16,20"),
        (lambda: scan_plan.numbers_of("1,,2"), "give numbers from 0 to 247, such as 1-16,20"),
        (lambda: scan_plan.numbers_of("²"), "give numbers from 0 to 247, such as 1-16,20"),
        (lambda: scan_plan.numbers_of("\u0661"), "give numbers from 0 to 247, such as 1-16,20"),
        (
            lambda: scan_plan.check_numbers(scan_plan.protocols_of(["toshiba"]), (100, 101)),
            "--numbers 100, 101: no protocol that is tried has these: toshiba-binary 0 to 63, toshiba-ascii 0 to 99",
        ),
        (lambda: scan_plan.protocols_of(["profibus"]), "--protocol profibus: give toshiba, modbus-rtu"),
        (lambda: scan_plan.one_of("--baud", [1200], "baud"), "--baud 1200: give 9600, 19200, 38400"),
        (lambda: scan_plan.one_of("--parity", ["E"], "parity"), "--parity E: give even, odd, none"),
    ]
    for call, said in wrong:
        with pytest.raises(BadConfig, match=said):
            call()


@pytest.mark.parametrize(
    ("identity", "facts", "model", "by"),
    [
        (("VFnC3-2007P", "0100"), {}, "vf-nc3", "2BH: TOSHIBA VFnC3-2007P 0100"),
        (("VFMB1S-2004PL", "0102"), {"capacity_code": 26}, "vf-mb1", "2BH: TOSHIBA VFMB1S-2004PL 0102"),
        (("VFS15-2004", "1"), {}, None, "2BH: TOSHIBA VFS15-2004 1, which no model of the catalogue begins with"),
        (None, {"series_code": 208, "capacity_code": 26}, "vf-nc3", "series code 208 (FB07)"),
        (None, {"capacity_code": 26}, "vf-mb1", "capacity code 26 (FB05) only: check it"),
        (None, {"capacity_code": 4, "series_code": 9}, None, "it says capacity_code 4, series_code 9, which"),
        (None, {}, None, "it says nothing"),
    ],
)
def test_a_model_is_recognised_by_the_surest_thing(
    identity: tuple[str, str] | None, facts: dict[str, int], model: str | None, by: str
) -> None:
    """Its own words, its series, its capacity; what is not sure says so."""
    said = Identity("TOSHIBA", *identity) if identity else None
    found = recognise(MODELS, said, facts)
    assert (found.model.name if found.model else None) == model
    assert found.by.startswith(by)


def test_the_numbers_that_tell_who_a_drive_is_come_from_the_catalogue() -> None:
    """FB05, FE08, FB07."""
    assert addresses(MODELS) == {0xFB05: "capacity_code", 0xFE08: "cpu_version", 0xFB07: "series_code"}
