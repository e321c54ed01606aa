"""Which model a drive is, by what it says of itself: 2BH, the series code, the capacity code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.bus.identification import IDENTITY_REGISTERS, SERIES
from gateway.drives.model import Model
from gateway.protocol.pdu import Identity

CAPACITY = "capacity_code"  # FB05


@dataclass(frozen=True, slots=True)
class Recognised:
    """The model, None where there is no telling; `by` says in words by what, and what else it might be."""

    model: Model | None
    by: str


def addresses(models: Mapping[str, Model]) -> dict[int, str]:
    """Return the communication numbers that tell who a drive is, and what they are called."""
    return {
        model.registers[name].address: name
        for name in IDENTITY_REGISTERS
        for model in models.values()
        if name in model.registers
    }


def recognise(models: Mapping[str, Model], identity: Identity | None, facts: Mapping[str, int]) -> Recognised:
    """Recognise a drive by the surest thing that it says. `facts` are words by register name."""
    if identity is not None:
        said = f"2BH: {identity.vendor} {identity.device} {identity.version}"
        known = [model for model in models.values() if model.identity and identity.device.startswith(model.identity)]
        best = max(known, key=lambda model: len(model.identity), default=None)
        return Recognised(best, said if best else f"{said}, which no model of the catalogue begins with")
    by_series = [model for model in models.values() if model.series_code == facts.get(SERIES, -1)]
    if by_series:
        return _one_of(by_series, f"series code {facts[SERIES]} (FB07)", is_sure=len(by_series) == 1)
    by_capacity = [
        model for model in models.values() if model.series_code is None and facts.get(CAPACITY) in model.capacities
    ]
    if by_capacity:
        return _one_of(by_capacity, f"capacity code {facts[CAPACITY]} (FB05)", is_sure=False)
    told = ", ".join(f"{name} {word}" for name, word in facts.items())
    return Recognised(None, f"it says {told}, which no model of the catalogue does" if told else "it says nothing")


def _one_of(models: list[Model], by: str, *, is_sure: bool) -> Recognised:
    others = ", ".join(model.name for model in models[1:])
    doubt = "" if is_sure else f" only: check it{f'; it may be {others}' if others else ''}"
    return Recognised(models[0], by + doubt)
