"""The catalogue: drive models read from TOML files, the built-in ones and the user's own."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from decimal import Decimal
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from gateway.drives.model import BlockForms, Connector, DriveTimes, Model
from gateway.drives.register import Derived, Enumeration, Kind, Register, Storage
from gateway.drives.scaling import Scaling
from gateway.errors import BadConfig

Name = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]*$")]
ModelName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9-]*$")]
Word = Annotated[int, Field(ge=0, le=0xFFFF)]
Bit = Annotated[str, StringConstraints(pattern=r"^(1[0-5]|[0-9])$")]
Code = Annotated[str, StringConstraints(pattern=r"^[0-9]{1,5}$")]
ScaleText = Annotated[str, StringConstraints(pattern=r"^[0-9]+(\.[0-9]+)?$")]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Times(_Entry):
    processing: float = Field(0.015, gt=0, le=2)
    eeprom: float = Field(0.050, gt=0, le=2)
    start_up: float = Field(1.0, ge=0, le=60)


class _Blocks(_Entry):
    indirect_read_address: Word = 0
    indirect_read_minimum: int = Field(0, ge=0, le=16)
    indirect_read_maximum: int = Field(0, ge=0, le=16)
    indirect_write_address: Word = 0
    indirect_write_words: int = Field(0, ge=0, le=16)
    has_exchange: bool = False
    direct_read_maximum: int = Field(0, ge=0, le=125)
    direct_ranges: list[tuple[Word, Word]] = []
    source: str = Field(min_length=1)


class _Connector(_Entry):
    name: Name
    parameters: dict[Name, Name]
    block_write: list[Name] = []
    block_read: list[Name] = []
    source: str = Field(min_length=1)


class _Code(_Entry):
    name: str = ""
    text: str = Field(min_length=1)


class _Derived(_Entry):
    name: Name
    of: Name
    base: Name
    unit: str = Field(min_length=1)
    digits: int = Field(2, ge=0, le=4)
    source: str = Field(min_length=1)


class _Poll(_Entry):
    values: list[Name] = Field(min_length=1)
    every: str


class _Register(_Entry):
    name: Name
    address: Word
    kind: Kind = Field(strict=False)
    source: str = Field(min_length=1)
    title: str = ""
    unit: str = ""
    scale: ScaleText = "1"
    signed: bool = False
    range: tuple[int, int] | None = None
    minimum_from: Name | None = None
    maximum_from: Name | None = None
    access: Annotated[str, StringConstraints(pattern=r"^rw?$")] = "r"
    storage: Storage = Field(Storage.NONE, strict=False)
    writable_while_running: bool = True
    takes_effect: Annotated[str, StringConstraints(pattern=r"^(at once|after reset)$")] = "at once"
    initial: int = 0
    bits: dict[Bit, Name] = {}
    values: dict[Code, str] = {}
    enumeration: Name | None = None


class _ModelHead(_Entry):
    name: ModelName
    title: str = Field(min_length=1)
    source: str = Field(min_length=1)
    identity: str = ""
    series_code: Word | None = None


class _ModelFile(_Entry):
    """One TOML file: a whole model under [model], or registers for an existing one under [extend]."""

    model: _ModelHead | None = None
    extend: ModelName | None = None
    times: _Times = Field(default_factory=_Times)
    blocks: _Blocks | None = None
    connector: list[_Connector] = []
    read_selectors: dict[Code, str] = {}
    write_selectors: dict[Code, str] = {}
    capacities: dict[Code, str] = {}
    enumeration: dict[Name, dict[Code, _Code]] = {}
    derived: list[_Derived] = []
    profile: list[_Poll] = []
    register: list[_Register] = []


Catalogue = Mapping[str, Model]


def load(extra: Iterable[Path] = ()) -> Catalogue:
    """Read the built-in models and then the user's files, in order; BadConfig says file, key and reason."""
    models: dict[str, Model] = {}
    folder = resources.files("gateway.drives") / "data"
    for entry in sorted(folder.iterdir(), key=lambda item: item.name):
        if entry.name.endswith(".toml"):
            _add(models, entry.name, entry.read_text(encoding="utf-8"))
    for path in extra:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise BadConfig(f"{path}: cannot be read: {error}") from error
        _add(models, str(path), text)
    return models


def _add(models: dict[str, Model], name: str, text: str) -> None:
    file = _parse(name, text)
    problems: list[str] = []
    if (file.model is None) == (file.extend is None):
        problems.append("give either [model] (a whole model) or extend = \"model-name\"")
    elif file.extend is not None and file.extend not in models:
        problems.append(f"extend: no model {file.extend!r}; known: {', '.join(sorted(models))}")
    elif file.model is not None and file.model.name in models:
        problems.append(f"model.name: {file.model.name!r} exists already; use extend = {file.model.name!r}")
    if not problems:
        base = models.get(file.extend or "")
        model = _build(file, base, problems)
        problems += _contradictions(model)
    if problems:
        raise BadConfig("\n".join(f"{name}: {problem}" for problem in problems))
    models[model.name] = model


def _parse(name: str, text: str) -> _ModelFile:
    try:
        return _ModelFile.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise BadConfig(f"{name}: not TOML: {error}") from error
    except ValidationError as error:
        raise BadConfig("\n".join(f"{name}: {_where(item, text)}" for item in error.errors())) from error


def _where(item: Any, text: str) -> str:
    """Say the key of a validation error and the reason, with the entry's own name where it has one."""
    keys = list(item["loc"])
    path = ".".join(str(key) for key in keys)
    if len(keys) > 1 and keys[0] == "register" and isinstance(keys[1], int):
        entries = tomllib.loads(text).get("register", [])
        entry = entries[keys[1]] if keys[1] < len(entries) else {}
        if isinstance(entry, dict) and "name" in entry:
            path = f"register {entry['name']!r}: {'.'.join(str(key) for key in keys[2:]) or 'entry'}"
    return f"{path}: {item['msg']} (given: {item['input']!r:.80})"


def _build(file: _ModelFile, base: Model | None, problems: list[str]) -> Model:
    enumerations = {
        name: Enumeration(
            name,
            {int(code): entry.name for code, entry in codes.items()},
            {int(code): entry.text for code, entry in codes.items()},
        )
        for name, codes in file.enumeration.items()
    }
    for register in base.registers.values() if base else ():
        if register.enumeration and not register.enumeration.name.startswith("."):
            enumerations.setdefault(register.enumeration.name, register.enumeration)
    registers = dict(base.registers) if base else {}
    for entry in file.register:
        if entry.name in registers:
            problems.append(f"register {entry.name!r}: the name exists already")
        registers[entry.name] = _register(entry, enumerations, problems)
    derived = tuple(Derived(d.name, d.of, d.base, d.unit, d.digits) for d in file.derived)
    profile = tuple((tuple(poll.values), poll.every) for poll in file.profile)
    if base is not None:
        return replace(
            base,
            registers=registers,
            derived=base.derived + derived,
            profile=profile or base.profile,
            capacities={**base.capacities, **_codes(file.capacities)},
            read_selectors={**base.read_selectors, **_codes(file.read_selectors)},
            write_selectors={**base.write_selectors, **_codes(file.write_selectors)},
            identity=base.identity,
            blocks=_blocks(file.blocks) if file.blocks else base.blocks,
            connectors=base.connectors + _connectors(file),
        )
    head = file.model
    if head is None:  # _add refuses a file with neither before it comes here
        raise AssertionError("a catalogue file without a model")
    return Model(
        name=head.name,
        title=head.title,
        source=head.source,
        registers=registers,
        identity=head.identity,
        series_code=head.series_code,
        times=DriveTimes(file.times.processing, file.times.eeprom, file.times.start_up),
        blocks=_blocks(file.blocks) if file.blocks else BlockForms(),
        connectors=_connectors(file),
        read_selectors=_codes(file.read_selectors),
        write_selectors=_codes(file.write_selectors),
        capacities=_codes(file.capacities),
        derived=derived,
        profile=profile,
    )


def _codes(table: Mapping[str, str]) -> dict[int, str]:
    return {int(code): text for code, text in table.items()}


def _connectors(file: _ModelFile) -> tuple[Connector, ...]:
    return tuple(
        Connector(c.name, c.parameters, tuple(c.block_write), tuple(c.block_read)) for c in file.connector
    )


def _blocks(entry: _Blocks) -> BlockForms:
    return BlockForms(
        indirect_read_address=entry.indirect_read_address,
        indirect_read_minimum=entry.indirect_read_minimum,
        indirect_read_maximum=entry.indirect_read_maximum,
        indirect_write_address=entry.indirect_write_address,
        indirect_write_words=entry.indirect_write_words,
        has_exchange=entry.has_exchange,
        direct_read_maximum=entry.direct_read_maximum,
        direct_ranges=tuple(entry.direct_ranges),
    )


def _register(entry: _Register, enumerations: Mapping[str, Enumeration], problems: list[str]) -> Register:
    def wrong(key: str, reason: str) -> None:
        problems.append(f"register {entry.name!r}: {key}: {reason}")

    enumeration = enumerations.get(entry.enumeration or "")
    if entry.enumeration and enumeration is None:
        wrong("enumeration", f"no table [enumeration.{entry.enumeration}]")
    if entry.values:
        texts = {int(code): text for code, text in entry.values.items()}
        enumeration = Enumeration(f".{entry.name}", dict.fromkeys(texts, ""), texts)
    if sum((bool(entry.bits), bool(entry.values), bool(entry.enumeration))) > 1:
        wrong("bits, values, enumeration", "give one of them")
    if Decimal(entry.scale) == 0:
        wrong("scale", "must not be 0")
    if entry.access == "r" and entry.storage is not Storage.NONE:
        wrong("storage", "a read-only register stores nothing: leave it out")
    if entry.access == "rw" and entry.storage is Storage.NONE:
        wrong("storage", 'a writable register needs storage = "ram" or "eeprom"')
    low, high = (-0x8000, 0x7FFF) if entry.signed else (0, 0xFFFF)
    minimum, maximum = entry.range or (None, None)
    if minimum is not None and maximum is not None and not low <= minimum <= maximum <= high:
        wrong("range", f"raw values from {low} to {high}, the lower one first")
    if not low <= entry.initial <= high:
        wrong("initial", f"a raw value from {low} to {high}")
    bits = {int(bit): name for bit, name in sorted(entry.bits.items(), key=lambda item: int(item[0]))}
    if len(set(bits.values())) != len(bits):
        wrong("bits", "two bits have the same name")
    return Register(
        name=entry.name,
        address=entry.address,
        kind=entry.kind,
        source=entry.source,
        title=entry.title,
        unit=entry.unit,
        scaling=Scaling(Decimal(entry.scale), entry.signed),
        minimum=minimum,
        maximum=maximum,
        minimum_from=entry.minimum_from or "",
        maximum_from=entry.maximum_from or "",
        is_writable=entry.access == "rw",
        storage=entry.storage,
        writable_while_running=entry.writable_while_running,
        takes_effect_after_reset=entry.takes_effect == "after reset",
        initial=entry.initial,
        mask=sum(1 << bit for bit in bits) if bits else 0xFFFF,
        bits=bits,
        enumeration=enumeration,
    )


def _contradictions(model: Model) -> list[str]:
    """Find what one entry says and another does not know of."""
    problems = []
    seen: dict[int, str] = {}
    for register in model.registers.values():
        if register.address in seen:
            other = seen[register.address]
            problems.append(f"register {register.name!r}: {register.address:04X}H is {other!r} already")
        seen[register.address] = register.name
    named = [("register minimum_from", r.minimum_from) for r in model.registers.values() if r.minimum_from]
    named += [("register maximum_from", r.maximum_from) for r in model.registers.values() if r.maximum_from]
    named += [("read_selectors", name) for name in model.read_selectors.values() if name]
    named += [("write_selectors", name) for name in model.write_selectors.values() if name]
    for connector in model.connectors:
        used = (*connector.parameters.values(), *connector.block_write, *connector.block_read)
        named += [(f"connector {connector.name!r}", name) for name in used]
    named += [(f"derived {d.name!r}", name) for d in model.derived for name in (d.of, d.base)]
    names = {d.name for d in model.derived}
    problems += [f"derived {name!r}: a register has this name" for name in names if name in model.registers]
    named += [("profile", v) for values, _ in model.profile for v in values if v not in names]
    problems += [f"{key}: no register {name!r}" for key, name in named if name not in model.registers]
    return problems
