"""What a type form says of a drive: kilowatts and voltage class, and a plausible rated current for them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from gateway.drives.model import Model

TYPE_FORM = re.compile(r"-(?P<volts>[124])(?P<kilowatts>\d{3})")  # VFnC3-2007P: 200/240 V, 0.75 kW
VOLTS = {"1": 200.0, "2": 200.0, "4": 400.0}  # the 120 V class doubles its supply for the motor
KILOWATTS = {"007": 0.75}  # the others are tenths: 015 is 1.5 kW
USUAL_FORM = "007"  # taken where nobody says: VFnC3-2007P is the manual's example

# Amperes at 200 V for each kW size. The manual gives one (4.8 A, E6581657 7.2); the others are usual motor ratings.
AMPERES = (
    (0.1, 0.7),
    (0.2, 1.4),
    (0.4, 2.4),
    (0.75, 4.8),
    (1.5, 8.0),
    (2.2, 11.0),
    (3.7, 17.5),
    (5.5, 28.0),
    (7.5, 35.0),
    (11.0, 55.0),
    (15.0, 66.0),
)


@dataclass(frozen=True, slots=True)
class Ratings:
    """The size of one drive. `form` is the device reference that 2BH answers, `code` is FB05."""

    form: str
    code: int
    kilowatts: float
    amperes: float
    volts: float


def of_capacity(model: Model, capacity: str | int | None = None) -> Ratings:
    """Return the ratings of a type form or of its FB05 code; KeyError where the model has no such size."""
    if not model.capacities and capacity is None:
        return _from_form(model.identity, 0)
    code = _code(model, capacity)
    return _from_form(model.capacities[code], code)


def _code(model: Model, capacity: str | int | None) -> int:
    if isinstance(capacity, int):
        return capacity
    if capacity is None:
        return next(
            (code for code, form in model.capacities.items() if _size(form) == USUAL_FORM),
            min(model.capacities),
        )
    codes = {form: code for code, form in model.capacities.items()}
    return codes[capacity]


def _size(form: str) -> str:
    match = TYPE_FORM.search(form)
    return match["kilowatts"] if match else USUAL_FORM


def _from_form(form: str, code: int) -> Ratings:
    match = TYPE_FORM.search(form)
    volts = VOLTS[match["volts"]] if match else 200.0
    size = _size(form)
    kilowatts = KILOWATTS.get(size, int(size) / 10)
    amperes = min(AMPERES, key=lambda row: abs(row[0] - kilowatts))[1]
    return Ratings(form, code, kilowatts, round(amperes * 200.0 / volts, 1), volts)
