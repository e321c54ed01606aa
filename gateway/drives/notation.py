"""How people write registers and values: names, FD00, F803; 30.0, run+command_priority, 0xC400."""

from __future__ import annotations

import difflib
import re
from decimal import Decimal, InvalidOperation

from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.errors import GatewayError

PARAMETER = re.compile(r"[Ff](\d{3})")  # F803 has the communication number 0803H (E6581657 8)
NUMBER = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})[Hh]?")
WORD = re.compile(r"0[xX]([0-9A-Fa-f]{1,4})|([0-9A-Fa-f]{1,4})[Hh]")
TITLE = re.compile(r"\(([A-Z][A-Z0-9]*)\)")  # the name on the panel: (F803), (ACC)


class NotUnderstood(GatewayError):
    """A register or a value that means nothing here: say what would be right."""


def address_of(text: str) -> int | None:
    """Return the communication number that a text gives: FD00, 0xFD00, FD00H, F803; None where it gives none."""
    if match := PARAMETER.fullmatch(text):
        return int(match[1], 16)
    match = NUMBER.fullmatch(text)
    return int(match[1], 16) if match else None


def find(model: Model, text: str) -> Register | None:
    """Return the register that a text names, by its name, number or name on the panel; None where there is none."""
    if text in model.registers:
        return model.registers[text]
    address = address_of(text)
    if address is not None:
        return model.at(address)
    on_panel = ((register, TITLE.search(register.title)) for register in model.registers.values())
    return next((register for register, match in on_panel if match and match[1] == text.upper()), None)


def found(model: Model, text: str) -> Register:
    """Return the register that a text names; NotUnderstood names the nearest one."""
    register = find(model, text)
    if register is not None:
        return register
    near = difflib.get_close_matches(text, model.registers, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"see: tosvert-gateway registers {model.name}"
    raise NotUnderstood(f"{model.name} has no register {text!r}; {hint}")


def label(register: Register) -> str:
    """Return name and communication number: "frequency_command (FA01)"."""
    return f"{register.name} ({register.address:04X})"


def word_of(register: Register, text: str) -> int:
    """Return the word of a value in the register's unit, of a code by its name or text, or of bits by name.

    OutOfRange: one word at this scale does not hold it. The register's own range is not judged here.
    """
    wanted = text.strip()
    if register.bits:
        return _bits(register, wanted)
    code = _code(register, wanted)
    if code is not None:
        return code
    try:
        value = Decimal(wanted)
    except InvalidOperation:
        raise NotUnderstood(f"{label(register)}: {text!r} is no value{_known(register)}") from None
    return register.scaling.encode(value)


def raw_word_of(register: Register, text: str) -> int:
    """Return the word of a raw value: 6000, -1, 0x1770, 1770H."""
    wanted = text.strip()
    word = _hexadecimal(wanted)
    if word is not None:
        return word
    low, high = register.scaling.limits
    if re.fullmatch(r"-?\d{1,5}", wanted) and min(low, 0) <= int(wanted) <= max(high, 0xFFFF):
        return int(wanted) & 0xFFFF
    raise NotUnderstood(f"{label(register)}: {text!r} is no raw value; one word is wanted: 6000, 0x1770, 1770H")


def _hexadecimal(text: str) -> int | None:
    match = WORD.fullmatch(text)
    return int(match[1] or match[2], 16) if match else None


def _bits(register: Register, text: str) -> int:
    """Set exactly the named bits: "run+command_priority"; none or 0 clears all; a hexadecimal word is itself."""
    word = _hexadecimal(text)
    if word is not None:
        return word
    if text in ("0", "none"):
        return 0
    place = {name: bit for bit, name in register.bits.items()}
    names = [name.strip() for name in re.split(r"[+,]", text)]
    for name in names:
        if name not in place:
            raise NotUnderstood(f"{label(register)}: no bit {name!r}{_known(register)}")
    return sum(1 << place[name] for name in dict.fromkeys(names))


def _code(register: Register, text: str) -> int | None:
    """Return the code whose name or text this is, whatever its case."""
    if register.enumeration is None:
        return None
    wanted = text.casefold()
    tables = (register.enumeration.names, register.enumeration.texts)
    codes = [code for table in tables for code, known in table.items() if known.casefold() == wanted != ""]
    return codes[0] if codes else None


def _known(register: Register) -> str:
    """Say what there is to choose from."""
    if register.bits:
        return f"; bits: {', '.join(register.bits.values())}; several are joined by +, none clears all"
    if register.enumeration is not None:
        texts = register.enumeration.texts.items()
        return f"; codes: {', '.join(f'{code} ({text})' for code, text in texts)}"
    return "; a number is wanted" + (f" in {register.unit}" if register.unit else "")
