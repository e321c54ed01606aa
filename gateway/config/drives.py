"""The section `[[line.drive]]`: what a drive is read for, and who may command it how."""

from __future__ import annotations

from typing import Literal

from pydantic import AliasChoices, Field, model_validator

from gateway.config.notation import (
    CommandName,
    CommandSource,
    Deadband,
    Duration,
    NamePattern,
    TopicLevel,
    ValueName,
    seconds,
)
from gateway.config.section import Section


class PollSection(Section):
    """Values that are read together."""

    values: list[ValueName] = Field(min_length=1)
    every: Duration = Field(ge=0, le=86_400, description='"0s": as fast as the line allows')
    max_age: Duration | None = Field(None, gt=0, description="older is stale; about three periods by default")


class FrequencySection(Section):
    """What a drive may be asked for, in Hz; the drive's own limits hold besides."""

    min: float = Field(0.0, ge=0, le=500)
    max: float = Field(500.0, ge=0, le=500)

    @model_validator(mode="after")
    def _in_order(self) -> FrequencySection:
        if self.min > self.max:
            raise ValueError(f"min {self.min} is above max {self.max}")
        return self


class FallbackSection(Section):
    """A frequency to go on with when the controller is lost, in Hz."""

    frequency: float = Field(ge=0, le=500)


class StoredWritesSection(Section):
    """How often the EEPROM of one drive may be written; the manuals give it 10,000 writes for each parameter."""

    burst: int = Field(10, ge=1, le=1000, description="writes that may come at once")
    per_hour: float = Field(20.0, gt=0, le=3600, description="writes an hour after that")
    warn: int = Field(1000, ge=1, le=100_000, description="writes of one parameter after which it is warned")
    refuse: int = Field(5000, ge=1, le=100_000, description="writes of one parameter after which none is made")

    @model_validator(mode="after")
    def _in_order(self) -> StoredWritesSection:
        if self.warn > self.refuse:
            raise ValueError(f"warn {self.warn} is above refuse {self.refuse}")
        return self


class RightSection(Section):
    """What one source may write; without any right a source of `sources` may write all that `control` permits."""

    source: CommandSource
    name: str = Field("*", description="of the controller, or its address; * and ? stand for any")
    broker: NamePattern = Field("*", description="of mqtt: the broker's name; * and ? stand for any")
    commands: list[CommandName] = Field(["*"], description="commands by name, or *")
    registers: list[str] = Field(["*"], description="registers by name; * and ? stand for any")
    min: float | None = Field(None, description="least value in the register's unit")
    max: float | None = Field(None, description="greatest value in the register's unit")


class DriveSection(Section):
    """One drive on a line."""

    name: TopicLevel
    number: int = Field(ge=0, le=247, description="inverter number F802")
    model: str
    protocol: Literal["modbus-rtu", "toshiba-ascii", "toshiba-binary"] = Field(
        "modbus-rtu", description="F829; the drives are shipped with TOSHIBA, ASCII and binary at the same time"
    )
    unit: int | None = Field(
        None, ge=0, le=247, description="MODBUS-TCP unit id; the number by default; 0: none, by unit 255 only"
    )
    control: Literal["off", "direct", "leased"] = Field(
        "off", description="off: read only; leased: by whoever keeps a lease alive; direct: without one"
    )
    sources: list[CommandSource] = Field(
        ["mqtt", "modbus-tcp", "sparkplug"], min_length=1, description="who may command"
    )
    right: list[RightSection] = Field([], description="finer rights of the sources")
    lease: Duration = Field(seconds("2s"), ge=0.1, le=60, description="how long a silent controller keeps the lease")
    on_loss: Literal["stop", "coast", "emergency-stop", "quiesce", "hold"] | FallbackSection = "stop"
    on_exit: Literal["stop", "hold"] = "stop"
    communication_timeout: Duration | None = Field(None, ge=0.1, le=100, description="F803, set where it differs")
    timeout_action: Literal["alarm", "coast", "stop"] | None = Field(None, description="F804, set where it differs")
    timeout_detection: Literal["always", "communication", "running"] | None = Field(
        None,
        validation_alias=AliasChoices("timeout_detection", "detection"),
        description="F808, set where it differs; detection is the same key",
    )
    unwatched: bool = Field(False, description="run commands though F803 or F804 would not stop the motor")
    allow_stored: bool = Field(False, description="parameters may be written to the EEPROM")
    stored_writes: StoredWritesSection = StoredWritesSection()
    frequency: FrequencySection = FrequencySection()
    command_timeout: Duration = Field(seconds("1s"), gt=0, le=10, description="a later command is not sent")
    provision: bool = Field(
        False, description="set F875-F879 where they differ from what is best: wears the EEPROM once"
    )
    block_write: bool = Field(
        False, description="run commands go with the block read where F870 = 1, F871 = 3; tried when the drive comes"
    )
    wait_time: Duration = Field(0.0, ge=0, le=2, description="F805 as set in the drive")
    poll: list[PollSection] = Field([], description="the model's profile where empty")
    deadband: dict[ValueName, Deadband] = Field({}, description="like mqtt.deadband, for this drive")
