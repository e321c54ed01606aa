"""Who answers under a number: by 2BH where the protocol has it, by the series code or any read where it has not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.bus.blocks import PlannedRead
from gateway.bus.work import Task, Work
from gateway.drives.register import Kind, Register
from gateway.errors import Refusal
from gateway.protocol.pdu import Identify, Identity, ReadWords
from gateway.site import Drive

SERIES = "series_code"  # FB07
CAPACITY = "capacity_code"  # FB05
IDENTITY_REGISTERS = (CAPACITY, "cpu_version", SERIES)  # FB05, FE08, FB07
FOREIGN = "foreign_"  # begins the name of a number that tells another model


@dataclass(slots=True)
class Identification:
    """What is known of who one drive is, since it was last lost."""

    drive: Drive
    identity: Identity | None = None
    _tries: int = 0
    _knows_2bh: bool = False
    _has_no_series: bool = False

    def ask(self, *, is_set_up: bool) -> Work:
        """Return the question who is there.

        MODBUS-RTU: 2BH, and every third time a plain read, for drives that know no 2BH; one that has answered
        2BH, rightly or as a stranger, is asked nothing else; one that was set up without is asked by plain reads.
        TOSHIBA: the series code where the model has a known one, else a plain read.
        """
        self._tries += 1
        plain = self._plain()
        if self.drive.codec.forms.has_identification:
            is_plain = plain is not None and not self._knows_2bh and (is_set_up or self._tries % 3 == 0)
            if not is_plain:
                return Work(Task.IDENTIFY, Identify(self.drive.number))
        register = plain or next(iter(self.drive.points.values())).register
        request = ReadWords(self.drive.number, register.address)
        return Work(Task.IDENTIFY, request, PlannedRead(request, (register,)))

    def _plain(self) -> Register | None:
        model = self.drive.model
        has_series = model.series_code is not None and not self.drive.codec.forms.has_identification
        names = (SERIES, "status") if has_series and not self._has_no_series else ("status",)
        return next((model.registers[name] for name in names if name in model.registers), None)

    def afresh(self) -> Identification:
        """Begin anew with a drive that was lost; one that has answered 2BH is still asked nothing else."""
        return Identification(self.drive, _knows_2bh=self._knows_2bh)

    def refused(self, work: Work, reason: Refusal) -> None:
        """Take note that the drive refuses the question, or a register that tells who it is."""
        if work.read is not None and work.read.registers[0].name == SERIES and reason is Refusal.ADDRESS:
            self._has_no_series = True

    @property
    def signs(self) -> tuple[Register, ...]:
        """Return what else is to be read because nothing sure is known: numbers that tell another model."""
        model = self.drive.model
        if self.identity is not None or (model.series_code is not None and not self._has_no_series):
            return ()
        return tuple(
            Register(f"{FOREIGN}{sign.address:04X}", sign.address, Kind.STATUS, model.source, sign.means)
            for sign in model.foreign
        )

    def is_stranger(self, identity: Identity) -> str:
        """Take who a drive says it is; say why it is not the one configured, "" where it is."""
        self._knows_2bh = True
        model = self.drive.model
        if model.identity and not identity.device.startswith(model.identity):
            self.identity = None
            return f"identity mismatch: {model.name} is configured, {identity.device!r} answers"
        self.identity = identity
        return ""

    def is_other_model(self, register: Register, word: int) -> str:
        """Say why the word of a plain read is not of the model configured, "" where it may be.

        The manual prints the series code without saying whether it is hexadecimal; 0 says nothing, as a series
        code and as a capacity code that the model has not got.
        """
        model = self.drive.model
        told = ""
        if register.name == SERIES and word not in (0, model.series_code, int(str(model.series_code), 16)):
            told = f"{model.name} has series code {model.series_code}, {word} answers"
        elif register.name == CAPACITY and self.identity is None and model.capacities:
            told = "" if word in (0, *model.capacities) else f"{model.name} has no capacity code {word} (FB05)"
        elif register.name.startswith(FOREIGN):
            words = next(sign.words for sign in model.foreign if sign.address == register.address)
            told = f"{model.name} is configured, {register.title} answers" if not words or word in words else ""
        return f"identity mismatch: {told}" if told else ""

    def described(self, facts: Mapping[str, int]) -> Mapping[str, str]:
        """Return who the drive is, in words, for people."""
        told = {"vendor": "", "device": "", "version": ""}
        if self.identity is not None:
            who = self.identity
            told = {"vendor": who.vendor, "device": who.device, "version": who.version}
        capacity = facts.get(CAPACITY)
        if capacity is not None:
            told["type_form"] = self.drive.model.capacities.get(capacity, f"code {capacity}")
        if "cpu_version" in facts:
            told["cpu_version"] = str(facts["cpu_version"])
        return {key: value for key, value in told.items() if value}
