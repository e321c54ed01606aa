"""A fault as the file of a simulated line and requests to it describe it."""

from __future__ import annotations

from pydantic import Field, model_validator

from gateway.config import Section
from gateway.sim.drive import SimulatedDrive
from gateway.sim.faults import Fault, Kind
from gateway.sim.quantities import Amount, Span, is_whole

SECONDS_OF = (Kind.LATE, Kind.DUPLICATE, Kind.SPLIT)
COUNTS_OF = {Kind.REQUEST_FLIP: "bits", Kind.FLIP: "bits", Kind.TRUNCATE: "bytes", Kind.BABBLE: "bytes"}
OF_THE_LINE = (Kind.ECHO,)  # an adapter's, whichever drive answers


class FaultSection(Section):
    """A fault; `value` is seconds, bytes or bits, as its kind wants."""

    kind: Kind = Field(strict=False)
    value: Amount | None = Field(None, description="a number, or two between which one is drawn each time")
    probability: float = Field(1.0, ge=0, le=1)
    count: int | None = Field(None, ge=1, description="how often it strikes; without end by default")
    after: Span = Field(0.0, ge=0, description="since the line was opened, or since the fault began")
    until: Span | None = Field(None, gt=0, description="the same")

    @model_validator(mode="after")
    def _fits_its_kind(self) -> FaultSection:
        kind = self.kind.value
        if self.value is not None and self.kind not in (*SECONDS_OF, *COUNTS_OF):
            raise ValueError(f"{kind} takes no value")
        if self.kind in COUNTS_OF and not is_whole(self.value):
            raise ValueError(f"the value of {kind} counts {COUNTS_OF[self.kind]}: a whole number is wanted")
        if self.until is not None and self.until <= self.after:
            raise ValueError("until is to be later than after")
        return self

    def fault(self, drive: SimulatedDrive | None, now: float) -> Fault:
        """Return the fault of a drive or, without one, of the line; its times are counted from now."""
        until = float("inf") if self.until is None else now + self.until
        return Fault(self.kind, drive, self.value, self.probability, self.count, now + self.after, until)


def whose(drive: SimulatedDrive | None) -> tuple[object, ...]:
    """Return by what a drive's faults go: itself, or the number it has now; none for the line's own."""
    return () if drive is None else (drive, drive.number)
