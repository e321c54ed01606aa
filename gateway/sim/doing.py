"""What everything that can be done to a simulated line has in common."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from gateway.config import Section
from gateway.drives import notation
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.sim.drive import SimulatedDrive
from gateway.sim.installation import Installation, WrongRequest
from gateway.sim.quantities import DriveKey


class Doing(Section):
    """Something that is done to the line at a moment; its fields are what it takes."""

    do: str

    def act(self, line: Installation, now: float) -> Any:
        """Do it; WrongRequest says why not."""
        raise NotImplementedError

    def __str__(self) -> str:
        table = self.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude={"do"})
        return " ".join([self.do, *(f"{key}={_shown(value)}" for key, value in table.items())])


class OfDrive(Doing):
    """Something that is done to one drive."""

    drive: DriveKey

    def act(self, line: Installation, now: float) -> Any:
        """Do it to the drive as it is now."""
        return self.act_on(line.drive(self.drive, now), now)

    def act_on(self, drive: SimulatedDrive, now: float) -> Any:
        """Do it; WrongRequest says why not."""
        raise NotImplementedError


class OfRegister(OfDrive):
    """Something that is done to a register of a drive."""

    register_: str = Field(
        alias="register", pattern=r"^[A-Za-z0-9_]+$", description="by name, number or name on the panel"
    )


def known(drive: SimulatedDrive, text: str) -> str:
    """Return the name of the register that a text names: FA01, F803, trip_code; WrongRequest names the nearest."""
    try:
        return notation.found(drive.model, text).name
    except notation.NotUnderstood as error:
        address = notation.address_of(text)
        reason = str(error) if address is None else _no_number(drive.model, text, address)
        raise WrongRequest(reason) from error


def _no_number(model: Model, text: str, address: int) -> str:
    nearest = min(model.registers.values(), key=lambda register: abs(register.address - address))
    return f"{model.name} has no register {text!r}; the nearest is {notation.label(nearest)}"


def outside(register: Register, word: int) -> str:
    """Say what a register takes, where that word is not of it; "" where it is."""
    raw = register.scaling.raw(word)
    low, high = register.scaling.limits
    low = low if register.minimum is None else register.minimum
    high = high if register.maximum is None else register.maximum
    return "" if low <= raw <= high else f"{register.name} takes {low} to {high} (given: {raw})"


def _shown(value: object) -> str:
    """Write an argument as short as it was given."""
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)
