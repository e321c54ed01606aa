"""Which model a drive is, by what it says of itself: 2BH, the series code, the capacity code."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from gateway.bus.identification import CAPACITY, IDENTITY_REGISTERS, SERIES
from gateway.drives.model import Model
from gateway.protocol.pdu import Identity


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


def mismatch(model: Model, models: Mapping[str, Model], facts: Mapping[str, int], unknown: Collection[str]) -> str:
    """Say why a drive is not of its model, and what it is instead; "" where nothing speaks against it.

    `facts` are words by register name, `unknown` the names of those whose numbers the drive does not know.
    """
    told = _contradiction(model, models, facts, unknown)
    if not told:
        return ""
    others = {name: other for name, other in models.items() if name != model.name}
    best = recognise(others, None, facts).model
    return f"identity mismatch: {model.name} is configured, {best.name if best else 'another model'} answers: {told}"


def _contradiction(
    model: Model, models: Mapping[str, Model], facts: Mapping[str, int], unknown: Collection[str]
) -> str:
    series, capacity = facts.get(SERIES, 0), facts.get(CAPACITY)
    if model.series_code is not None and SERIES in unknown:
        return f"it does not know the series code (FB07), which is {model.series_code} for {model.name}"
    if series and not _is_series(model, series):
        known = [other for other in models.values() if other.series_code is not None and _is_series(other, series)]
        if model.series_code is not None or known:
            return f"its series code (FB07) is {series}"
    if model.capacities and capacity is not None and capacity not in model.capacities:
        return f"its capacity code (FB05) is {capacity}, which {model.name} has not got"
    return ""


def _is_series(model: Model, word: int) -> bool:
    """Say whether FB07 is that of a model; the manual prints the code without saying whether it is hexadecimal."""
    return model.series_code is not None and word in (model.series_code, int(str(model.series_code), 16))
