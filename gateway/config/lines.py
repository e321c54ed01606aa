"""The section `[[line]]`: an RS485 line, its port, and groups of its drives."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from gateway.config.drives import DriveSection
from gateway.config.notation import Duration, TopicLevel, address, seconds
from gateway.config.section import Section
from gateway.protocol.timing import LineTiming

SERVER_SCHEMES = ("socket://", "rfc2217://")
ROUNDING = 1e-6  # what multiplying a duration may be off by
RTS_KEYS = ("rts_on_send", "rts_delay_before", "rts_delay_after")  # of a line, the delays last


def server_address(port: str) -> tuple[str, int] | None:
    """Return host and port of a serial server; None for a device, ValueError where the address is no address."""
    scheme = next((scheme for scheme in SERVER_SCHEMES if port.startswith(scheme)), None)
    if scheme is None:
        return None
    try:
        return address(port.removeprefix(scheme))
    except ValueError as error:
        raise ValueError(f'an address and a port are wanted: "{scheme}10.0.0.7:4001"') from error


def _port(value: str) -> str:
    if "\0" in value:
        raise ValueError("a path or an address cannot contain a NUL character")
    if server_address(value) is None:
        if "://" in value:
            raise ValueError(
                'a serial device or a serial server is wanted: "/dev/ttyUSB0", "socket://10.0.0.7:4001",'
                ' "rfc2217://10.0.0.7:4001"'
            )
        if not value.startswith("/"):
            raise ValueError(f'give the whole path: "/dev/{value}"')
    return value


class GroupSection(Section):
    """Drives of one line that are written to together."""

    name: TopicLevel
    drives: list[TopicLevel] = Field(min_length=1)


class LineSection(Section):
    """One RS485 line."""

    name: TopicLevel
    port: Annotated[str, AfterValidator(_port)]
    baud: Literal[9600, 19200, 38400] = Field(19200, description="F800")
    parity: Literal["even", "odd", "none"] = Field("even", description="F801")
    answer_margin: Duration | None = Field(
        None, gt=0, le=5, description="time for adapters and networks beside the drive's own"
    )
    rs485: Literal["auto", "kernel", "rts", "off"] = Field(
        "auto", description="who switches between sending and receiving: the adapter, its driver, the gateway by RTS"
    )
    rts_on_send: bool = Field(True, description="RTS is asserted while sending and at no other time; false: reversed")
    rts_delay_before: Duration = Field(0.0, ge=0, le=0.1, description="from RTS to the first bit")
    rts_delay_after: Duration = Field(0.0, ge=0, le=0.1, description="from the last bit to RTS; less than the gap")
    local_echo: Literal["auto", "on", "off"] = Field("auto", description="the adapter hears what it sends itself")
    silent_share: float = Field(0.05, gt=0, le=0.5, description="share of the line for silent drives")
    probe_every: Duration = Field(seconds("1s"), gt=0, description="first interval of tries")
    probe_at_most: Duration = Field(seconds("5s"), gt=0, description="longest interval of tries")
    drive: list[DriveSection] = Field(min_length=1)
    group: list[GroupSection] = Field([], description="drives that are written to together")

    @model_validator(mode="after")
    def _tried_ever_more_seldom(self) -> LineSection:
        """Refuse tries of silent drives that would come more often as time goes by."""
        if "probe_at_most" in self.model_fields_set and self.probe_at_most < self.probe_every:
            least = f"{self.probe_every:g} s"
            given = f"{self.probe_at_most:g} s"
            raise ValueError(f"probe_at_most {given} is shorter than probe_every: give {least} or more")
        return self

    @model_validator(mode="after")
    def _switchable(self) -> LineSection:
        """Refuse settings of RTS that would do nothing, or spoil every answer."""
        has_rts = self.rs485 in ("kernel", "rts")
        if has_rts and server_address(self.port) is not None:
            raise ValueError(f'rs485 = "{self.rs485}" is for serial devices; a serial server switches by itself')
        given = [key for key in RTS_KEYS if key in self.model_fields_set]
        if given and not has_rts:
            raise ValueError(f'{" and ".join(given)}: only with rs485 = "kernel" or "rts"')
        gap = LineTiming(self.baud).gap
        if self.rts_delay_after >= gap:
            raise ValueError(
                f"rts_delay_after {self.rts_delay_after * 1000:g} ms cuts off answers, which begin"
                f" {gap * 1000:.2f} ms after a request: set it below"
            )
        for key in RTS_KEYS[1:] if self.rs485 == "kernel" else ():
            if abs((delay := 1000 * getattr(self, key)) - round(delay)) > ROUNDING:
                raise ValueError(f'{key}: the kernel counts whole milliseconds; rs485 = "rts" does not')
        return self
