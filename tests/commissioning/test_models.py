"""Whether drives are of the models that they are said to be, in every protocol and for every pair of models."""

from __future__ import annotations

from typing import Any

import pytest

from gateway.commissioning import models
from gateway.commissioning.recognition import mismatch
from gateway.commissioning.targets import Target
from gateway.drives.catalogue import load
from gateway.errors import BadConfig, NoReply
from gateway.sim.faults import Kind
from tests.bus.hand import Hand, play

MODELS = load()
NC3, MB1, AS3 = (MODELS[name] for name in ("vf-nc3", "vf-mb1", "vf-as3"))
PROTOCOLS = ["modbus-rtu", "toshiba-ascii", "toshiba-binary"]
every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS)


def drive(protocol: str, model: str, is_: str, **more: Any) -> dict[str, Any]:
    """Return a drive that is configured as a model and is one."""
    return {"number": 1, "protocol": protocol, "model": model, "is": is_, **more}


def target(hand: Hand, *, any_model: bool = False, is_group: bool = False) -> Target:
    """Return all drives of the line."""
    return Target(hand.line, hand.line.drives, is_group, any_model, MODELS)


async def warnings(hand: Hand) -> list[str]:
    """Return what is warned of before values are shown."""
    said: list[str] = []
    await models.warn_of_others(hand.session, target(hand), said.append)
    return said


@pytest.mark.hazard("H07")
@every_protocol
@pytest.mark.parametrize("model", ["vf-nc3", "vf-mb1"])
def test_the_right_model_passes(protocol: str, model: str) -> None:
    """Without a word."""

    async def scene(hand: Hand) -> None:
        said: list[str] = []
        await models.check(hand.session, target(hand), said.append)
        assert said == await warnings(hand) == []

    play([drive(protocol, model, model)], scene)


@pytest.mark.hazard("H07")
@every_protocol
@pytest.mark.parametrize(("model", "is_"), [("vf-nc3", "vf-mb1"), ("vf-mb1", "vf-nc3")])
def test_another_model_is_refused_with_both_names_unless_any_will_do(protocol: str, model: str, is_: str) -> None:
    """For reading it is only warned of."""

    async def scene(hand: Hand) -> None:
        said: list[str] = []
        with pytest.raises(BadConfig, match=rf"d1: identity mismatch: {model} is con.*--any-model") as caught:
            await models.check(hand.session, target(hand), said.append)
        assert is_ in str(caught.value) or MODELS[is_].identity in str(caught.value)
        assert said == []
        await models.check(hand.session, target(hand, any_model=True), said.append)
        (warned,) = await warnings(hand)
        assert warned == f"{said[0]}: its values may mean something else"

    play([drive(protocol, model, is_)], scene)


@pytest.mark.hazard("H07")
def test_a_series_or_a_capacity_of_nobody_is_refused_too() -> None:
    """A drive that the catalogue has not got."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(BadConfig, match=r"another model answers: its series code \(FB07\) is 7"):
            await models.check(hand.session, target(hand), print)

    play([drive("toshiba-ascii", "vf-nc3", "vf-nc3", registers={"series_code": 7})], scene)


def test_a_silent_drive_is_let_be_in_a_group_only() -> None:
    """A write finds out for itself; reading has told of it already."""

    async def scene(hand: Hand) -> None:
        hand.fault(Kind.CUT)
        with pytest.raises(NoReply):
            await models.check(hand.session, target(hand), print)
        await models.check(hand.session, target(hand, is_group=True), print)
        assert await warnings(hand) == []

    play([drive("toshiba-ascii", "vf-nc3", "vf-nc3")], scene)


@pytest.mark.parametrize(
    ("model", "facts", "unknown", "said"),
    [
        (NC3, {"series_code": 208, "capacity_code": 26}, (), ""),
        (NC3, {"series_code": 0x208}, (), ""),
        (NC3, {"series_code": 0, "capacity_code": 26}, (), ""),
        (NC3, {}, (), ""),
        (NC3, {}, ("series_code",), "vf-nc3 is configured, another model answers: it does not know the series code"),
        (NC3, {"capacity_code": 44}, ("series_code",), "vf-nc3 is configured, vf-mb1 answers: it does not know"),
        (NC3, {"series_code": 208, "capacity_code": 77}, (), "its capacity code (FB05) is 77, which vf-nc3 has not"),
        (MB1, {"series_code": 208, "capacity_code": 28}, (), "vf-mb1 is configured, vf-nc3 answers: its series code"),
        (MB1, {"series_code": 5, "capacity_code": 28}, (), ""),
        (MB1, {"capacity_code": 28}, ("series_code",), ""),
        (MB1, {"capacity_code": 1}, ("series_code",), "its capacity code (FB05) is 1, which vf-mb1 has not got"),
        (AS3, {"series_code": 208}, (), "vf-as3 is configured, vf-nc3 answers"),
        (AS3, {"capacity_code": 28}, ("series_code",), ""),
    ],
)
def test_what_a_drive_says_is_held_against_its_model(
    model: Any, facts: dict[str, int], unknown: tuple[str, ...], said: str
) -> None:
    """Nothing said is nothing against it."""
    told = mismatch(model, MODELS, facts, unknown)
    assert said in told
    assert bool(said) is bool(told)
