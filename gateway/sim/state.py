"""What a simulated drive is at a moment, told as a table: all that a judge of its master may want to know."""

from __future__ import annotations

from typing import Any

from gateway.sim import display
from gateway.sim.drive import SimulatedDrive
from gateway.sim.inverter import Inverter
from gateway.sim.options import PROTOCOLS

PROTOCOL_NAMES = {code: name for name, code in PROTOCOLS.items()}
BY_COMMUNICATION = 18  # F710 (E6581657 7.3.1)
UNITS = ("", " Hz", " %", " Hz %")  # the lights beside the digits


def state(drive: SimulatedDrive, name: str | None, opened: float) -> dict[str, Any]:
    """Describe a drive that was ticked; times are in seconds, moments since the line was opened."""
    inverter = drive.inverter
    condition, memory = inverter.condition, inverter.memory
    return {
        "number": drive.number,
        "name": name,
        "model": drive.model.name,
        "form": condition.ratings.form,
        "protocol": PROTOCOL_NAMES.get(drive.protocol, "none"),
        "is_deaf": condition.time < inverter.deaf_until,
        "is_running": inverter.is_running,
        "frequency": condition.motor.frequency,
        "run_time": condition.counters.running,
        "trip_code": int(condition.trip_code),
        "past_trips": list(condition.past_trips),
        "alarm": condition.alarm,
        "timeout": _timeout(inverter),
        "selectors": _selectors(inverter),
        "panel": _panel(inverter),
        "frames_heard": drive.frames_heard,
        "messages_acknowledged": drive.messages_acknowledged,
        "acknowledged_at": None if drive.acknowledged is None else drive.acknowledged - opened,
        "eeprom_writes": {f"{address:04X}": count for address, count in memory.eeprom_writes.items()},
        "registers": {name: memory.word(name) for name in drive.model.registers},
        "forced": {f"{address:04X}": word for address, word in drive.registers.forced.items()},
    }


def _timeout(inverter: Inverter) -> dict[str, Any]:
    """Describe the timer of F803: what is left of it now, and what was left when least was."""
    timer = inverter.timer
    left = None if timer.deadline is None else max(0.0, timer.deadline - inverter.condition.time)
    period = inverter.memory.word(inverter.role("timeout")) / 10
    return {
        "period": period,
        "left": left,
        "least_margin": timer.least_margin,
        "is_timed_out": inverter.condition.is_timed_out,
    }


def _selectors(inverter: Inverter) -> dict[str, list[str]]:
    """Name the registers that the blocks carry by the selectors in force, "" for none."""
    model, memory = inverter.model, inverter.memory
    connector = model.connector()
    reads, writes = (connector.block_read, connector.block_write) if connector else ((), ())
    return {
        "read": [model.read_selectors.get(memory.word_in_force(name), "") for name in reads],
        "write": [model.write_selectors.get(memory.word_in_force(name), "") for name in writes],
    }


def _panel(inverter: Inverter) -> str | None:
    """Return what the host shows on the panel's LEDs; None while F710 has something else shown."""
    memory = inverter.memory
    if memory.word("standard_monitor") != BY_COMMUNICATION:
        return None
    *digits, unit = display.shown(memory)
    return "".join(map(_character, digits)) + UNITS[unit & 3]


def _character(code: int) -> str:
    letter = chr(code & ~display.DOT & 0xFF)
    return (letter if letter.isprintable() else " ") + ("." if code & display.DOT else "")
