"""What a scan brings to light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.commissioning.recognition import Recognised
from gateway.commissioning.scan_plan import Setting


@dataclass(frozen=True, slots=True)
class Found:
    """One drive: how it is reached and who it is. `settings` are its parameters by role, as raw words."""

    setting: Setting
    protocol: str
    number: int
    recognised: Recognised
    facts: Mapping[str, int]
    settings: Mapping[str, int]

    @property
    def model_name(self) -> str:
        """Return the model of the drive, or that it is not known."""
        return self.recognised.model.name if self.recognised.model else "unknown model"


@dataclass(slots=True)
class Result:
    """What a scan found: drives, and numbers under which something answers that cannot be understood.

    `has_late_answers`: a drive answered when another number was asked already.
    """

    found: list[Found] = field(default_factory=list)
    garbled: list[tuple[Setting, str, int]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    has_late_answers: bool = False
