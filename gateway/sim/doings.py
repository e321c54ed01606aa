"""What can be done to a simulated line: one table, for the events of a scenario and for its control socket."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from gateway.sim.doing import Doing, OfDrive, OfRegister, known, outside
from gateway.sim.drive import SimulatedDrive
from gateway.sim.fault_section import OF_THE_LINE, FaultSection, whose
from gateway.sim.faults import BABBLE, Fault, Kind
from gateway.sim.installation import Installation, WrongRequest
from gateway.sim.quantities import Amount, DriveKey, Hertz, Number, Word, is_whole


class Trip(OfDrive):
    """Trips a drive; one that is tripped stays as it is."""

    do: Literal["trip"] = "trip"
    code: int = Field(ge=1, le=0xFF, description="as FC90 reads it")

    def act_on(self, drive: SimulatedDrive, now: float) -> None:
        """Trip it."""
        drive.inverter.trip(self.code)


class Alarm(OfDrive):
    """Sets the alarms that a drive reports; 0 ends them."""

    do: Literal["alarm"] = "alarm"
    value: Word = Field(description="as FC91 reads them")

    def act_on(self, drive: SimulatedDrive, now: float) -> None:
        """Set them."""
        drive.inverter.condition.alarm = self.value


class Run(OfDrive):
    """Presses RUN at the panel with its frequency; 0 Hz presses STOP."""

    do: Literal["run"] = "run"
    frequency: Hertz
    reverse: bool = False

    def act_on(self, drive: SimulatedDrive, now: float) -> None:
        """Press it."""
        drive.inverter.run_by_panel(self.frequency, is_reverse=self.reverse)


class SetRegister(OfRegister):
    """Sets a register at the panel, in its range: no protection applies, and no write to the EEPROM is counted."""

    do: Literal["set"] = "set"
    value: Word

    def act_on(self, drive: SimulatedDrive, now: float) -> None:
        """Set it."""
        name = known(drive, self.register_)
        if wrong := outside(drive.model.registers[name], self.value):
            raise WrongRequest(wrong)
        drive.set_by_panel(name, self.value)


class Force(OfRegister):
    """Makes a register read that word, whatever is true; without a value it reads what is true again."""

    do: Literal["force"] = "force"
    value: Word | None = None

    def act_on(self, drive: SimulatedDrive, now: float) -> None:
        """Force it, or let it go."""
        drive.force(known(drive, self.register_), self.value)


class Renumber(OfDrive):
    """Sets F802 at the panel; it acts at once."""

    do: Literal["renumber"] = "renumber"
    number: Number

    def act_on(self, drive: SimulatedDrive, now: float) -> None:
        """Set it."""
        register = drive.inverter.role("number")
        if not register:
            raise WrongRequest(f"the register of the number of {drive.model.name} is not known")
        drive.set_by_panel(register, self.number)


class PowerCycle(Doing):
    """Switches a drive, or all, off for so long; then it starts up, deaf for about a second."""

    do: Literal["power_cycle"] = "power_cycle"
    drive: DriveKey | None = None
    seconds: float = Field(0.0, ge=0, allow_inf_nan=False)

    def act(self, line: Installation, now: float) -> None:
        """Switch off and on."""
        for drive in line.drives(self.drive, now):
            drive.inverter.reset(now, off=self.seconds)


class Switched(Doing):
    """A lasting fault of a drive or, without one, of the line, that is switched on and off."""

    drive: DriveKey | None = None
    on: bool = Field(True, description="false ends it")
    kind: ClassVar[Kind]

    def act(self, line: Installation, now: float) -> None:
        """Begin it once, or end it."""
        drive = None if self.drive is None else line.drive(self.drive, now)
        line.wire.faults.clear(whose(drive), self.kind)
        if self.on:
            line.wire.faults.add(Fault(self.kind, drive))


class Cut(Switched):
    """Cuts the wire to a drive, or of the whole line: requests do not arrive."""

    do: Literal["cut"] = "cut"
    kind: ClassVar[Kind] = Kind.CUT


class Silence(Switched):
    """Lets a drive, or all, hear and obey without answering."""

    do: Literal["silence"] = "silence"
    kind: ClassVar[Kind] = Kind.DROP


class BeginFault(FaultSection, Doing):
    """Begins a fault of a drive or, without one, of the line."""

    do: Literal["fault"] = "fault"
    drive: DriveKey | None = None

    @model_validator(mode="after")
    def _has_its_place(self) -> BeginFault:
        if self.drive is not None and self.kind in OF_THE_LINE:
            raise ValueError(f"{self.kind.value} is a fault of the line: it takes no drive")
        return self

    def act(self, line: Installation, now: float) -> None:
        """Let it begin now."""
        drive = None if self.drive is None else line.drive(self.drive, now)
        line.wire.faults.add(self.fault(drive, now))


class ClearFaults(Doing):
    """Ends faults: of a drive, of a kind, both, or all; says how many."""

    do: Literal["clear_faults"] = "clear_faults"
    drive: DriveKey | None = None
    kind: Kind | None = Field(None, strict=False)

    def act(self, line: Installation, now: float) -> int:
        """End them."""
        everybody = None if self.drive is None else whose(line.drive(self.drive, now))
        return line.wire.faults.clear(everybody, self.kind)


class Babble(Doing):
    """Puts noise on the line at once."""

    do: Literal["babble"] = "babble"
    bytes: Amount = Field(float(BABBLE), description="how many, or two numbers between which that is drawn")

    @model_validator(mode="after")
    def _counts(self) -> Babble:
        if not is_whole(self.bytes):
            raise ValueError("bytes counts bytes: a whole number is wanted")
        return self

    def act(self, line: Installation, now: float) -> None:
        """Babble."""
        line.wire.babble(line.wire.faults.counted(self.bytes), now)


class Unplug(Doing):
    """Pulls the adapter out: whoever has the port open gets errors."""

    do: Literal["unplug"] = "unplug"

    def act(self, line: Installation, now: float) -> None:
        """Pull it out."""
        line.port.unplug()
        line.wire.clear()


class Plug(Doing):
    """Puts the adapter back, under a new name that the link follows; says the name."""

    do: Literal["plug"] = "plug"

    def act(self, line: Installation, now: float) -> str:
        """Put it back."""
        try:
            line.port.plug()
        except OSError as error:
            raise WrongRequest(f"link: {error.strerror or error}") from error
        return line.port.name


class StartCapture(Doing):
    """Writes the frames from now on to a file for Wireshark; without a file it ends."""

    do: Literal["capture"] = "capture"
    file: str | None = None

    def act(self, line: Installation, now: float) -> None:
        """Begin or end it."""
        try:
            line.capture(Path(self.file) if self.file else None)
        except OSError as error:
            raise WrongRequest(f"file {self.file}: {error.strerror or error}") from error


AnyDoing = Annotated[
    Trip | Alarm | Run | SetRegister | Force | Renumber | PowerCycle | Cut | Silence | BeginFault | ClearFaults
    | Babble | Unplug | Plug | StartCapture,
    Field(discriminator="do"),
]  # fmt: skip
