"""From the entries of a catalogue file to a drive model, and what contradicts itself on the way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from decimal import Decimal

from gateway.drives.catalogue_file import (
    BlocksEntry,
    CatalogueFile,
    CautionsEntry,
    ConnectorEntry,
    RegisterEntry,
    TimesEntry,
)
from gateway.drives.model import BlockForms, Cautions, Connector, DriveTimes, Foreign, Model
from gateway.drives.register import Derived, Enumeration, Kind, Register, Storage
from gateway.drives.scaling import Scaling


def build(file: CatalogueFile, models: Mapping[str, Model]) -> tuple[Model | None, list[str]]:
    """Build the model that a file describes or extends; the list says all that is wrong with it."""
    base, wrong = _base(file, models)
    if base is None:
        return None, wrong
    enumerations = _enumerations(file, base, wrong)
    registers = _registers(file, base, enumerations, wrong)
    derived = tuple(Derived(d.name, d.of, d.base, d.unit, d.digits) for d in file.derived)
    model = replace(
        base,
        registers=registers,
        foreign=base.foreign + tuple(Foreign(f.address, frozenset(f.words), f.means) for f in file.foreign),
        times=_times(file.times, base.times),
        blocks=_blocks(file.blocks) if file.blocks else base.blocks,
        connectors=base.connectors + tuple(map(_connector, file.connector)),
        cautions=_cautions(file.cautions, base.cautions),
        read_selectors={**base.read_selectors, **_by_number(file.read_selectors)},
        write_selectors={**base.write_selectors, **_by_number(file.write_selectors)},
        capacities={**base.capacities, **_by_number(file.capacities)},
        derived=base.derived + derived,
        profile=tuple((tuple(poll.values), poll.every) for poll in file.profile) or base.profile,
    )
    return model, wrong + list(_contradictions(model))


def _base(file: CatalogueFile, models: Mapping[str, Model]) -> tuple[Model | None, list[str]]:
    """Return what the file builds on: the model that it extends, or an empty new one."""
    head = file.model
    if head is not None and file.extend is None:
        if head.name in models:
            return None, [f"model.name: {head.name!r} exists already; to add to it: extend = {head.name!r}"]
        return Model(head.name, head.title, head.source, {}, head.identity, head.series_code), []
    if head is None and file.extend is not None:
        known = ", ".join(sorted(models))
        base = models.get(file.extend)
        return base, [] if base else [f"extend: no model {file.extend!r}; known: {known}"]
    return None, ['model, extend: give one of them: [model] (a whole model) or extend = "model-name"']


def _enumerations(file: CatalogueFile, base: Model, wrong: list[str]) -> dict[str, Enumeration]:
    """Collect the tables of the base and of the file; a file may add codes to a table of the base."""
    tables = {r.enumeration.name: r.enumeration for r in base.registers.values() if r.enumeration}
    for name, codes in file.enumeration.items():
        known = tables.get(name, Enumeration(name, {}, {}))
        twice = [code for code in codes if int(code) in known.texts]
        wrong += [f"enumeration.{name}.{code}: the code exists already" for code in twice]
        names = {**known.names, **{int(code): entry.name for code, entry in codes.items()}}
        texts = {**known.texts, **{int(code): entry.text for code, entry in codes.items()}}
        tables[name] = Enumeration(name, names, texts)
    return tables


def _registers(
    file: CatalogueFile, base: Model, enumerations: Mapping[str, Enumeration], wrong: list[str]
) -> dict[str, Register]:
    registers = {
        name: replace(r, enumeration=enumerations[r.enumeration.name]) if r.enumeration else r
        for name, r in base.registers.items()
    }
    seen: set[str] = set()
    for entry in file.registers:
        wrong += [f"register {entry.name!r}: {problem}" for problem in _entry_problems(entry, enumerations)]
        for register in _with_held(entry, _register(entry, enumerations)):
            problem = _name_problem(register.name, entry.replaces, seen, registers)
            if problem:
                wrong.append(f"register {register.name!r}: {problem}")
            seen.add(register.name)
            registers[register.name] = register
    return registers


def _with_held(entry: RegisterEntry, register: Register) -> Iterator[Register]:
    """Give a register, and the one that holds its value at a trip where the entry has `held`."""
    yield register
    if entry.held is not None:
        title = f"{entry.title}, held at a trip" if entry.title else ""
        yield replace(register, name=f"trip_{entry.name}", address=entry.held, kind=Kind.TRIP_HELD, title=title)


def _name_problem(name: str, replaces: bool, seen: set[str], registers: Mapping[str, Register]) -> str:
    if name in seen:
        return "name: it stands twice in this file"
    if name in registers and not replaces:
        return "name: it exists already; replaces = true puts this entry in its place"
    if replaces and name not in registers:
        return "replaces: there is no such register to replace"
    return ""


def _entry_problems(entry: RegisterEntry, enumerations: Mapping[str, Enumeration]) -> Iterator[str]:
    """Say what one entry says against itself."""
    if entry.enumeration and entry.enumeration not in enumerations:
        yield f"enumeration: no table [enumeration.{entry.enumeration}]"
    if sum(map(bool, (entry.bits, entry.values, entry.enumeration))) > 1:
        yield "bits, values, enumeration: give one of them"
    if Decimal(entry.scale) == 0:
        yield "scale: must not be 0"
    if entry.bits or entry.values or entry.enumeration:
        for key in sorted(entry.model_fields_set & {"unit", "scale", "signed"}):
            yield f"{key}: bits and codes have none"
    if len(set(entry.bits.values())) != len(entry.bits):
        yield "bits: two bits have the same name"
    yield from _access_problems(entry)
    yield from _range_problems(entry)


def _access_problems(entry: RegisterEntry) -> Iterator[str]:
    if entry.access == "rw" and entry.held is not None:
        yield "held: a drive holds what it monitors, not what is written to it"
    if entry.access == "rw" and entry.storage is Storage.NONE:
        yield 'storage: a writable register needs "ram" or "eeprom"'
    if entry.access == "r":
        if entry.storage is not Storage.NONE:
            yield "storage: a read-only register stores nothing: leave it out"
        for key in sorted(entry.model_fields_set & {"writable_while_running", "takes_effect"}):
            yield f"{key}: a read-only register is not written: leave it out"


def _range_problems(entry: RegisterEntry) -> Iterator[str]:
    low, high = Scaling(signed=entry.signed).limits
    if entry.range is not None:
        if not low <= entry.range[0] <= entry.range[1] <= high:
            yield f"range: two raw values from {low} to {high}, the lower one first (given: {[*entry.range]})"
        low, high = entry.range
    if entry.initial is not None and not low <= entry.initial <= high:
        yield f"initial: {entry.initial} is outside {low} to {high}"
    for code in entry.values:
        if not low <= int(code) <= high:
            yield f"values.{code}: is outside {low} to {high}"


def _register(entry: RegisterEntry, enumerations: Mapping[str, Enumeration]) -> Register:
    minimum, maximum = entry.range or (None, None)
    nearest_to_0 = max(minimum or 0, min(maximum or 0, 0))
    bits = {int(bit): entry.bits[bit] for bit in sorted(entry.bits, key=int)}
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
        minimum_from=entry.minimum_from,
        maximum_from=entry.maximum_from,
        is_writable=entry.access == "rw",
        storage=entry.storage,
        writable_while_running=entry.writable_while_running,
        takes_effect_after_reset=entry.takes_effect == "after reset",
        initial=nearest_to_0 if entry.initial is None else entry.initial,
        mask=sum(1 << bit for bit in bits) if bits else 0xFFFF,
        bits=bits,
        enumeration=_enumeration(entry, enumerations),
    )


def _enumeration(entry: RegisterEntry, enumerations: Mapping[str, Enumeration]) -> Enumeration | None:
    """Return the table that the entry names, or one of its own `values`, called ".name"."""
    if entry.values:
        texts = {int(code): text for code, text in entry.values.items()}
        return Enumeration(f".{entry.name}", dict.fromkeys(texts, ""), texts)
    return enumerations.get(entry.enumeration)


def _times(entry: TimesEntry | None, base: DriveTimes) -> DriveTimes:
    if entry is None:
        return base
    given = entry.model_dump(include=entry.model_fields_set - {"source"})
    return replace(base, **given)


def _blocks(entry: BlocksEntry) -> BlockForms:
    values = entry.model_dump(exclude={"source", "direct_ranges"})
    return BlockForms(**values, direct_ranges=tuple(entry.direct_ranges))


def _connector(entry: ConnectorEntry) -> Connector:
    parameters: dict[str, str] = {str(role): name for role, name in entry.parameters.items()}
    return Connector(entry.name, parameters, tuple(entry.block_write), tuple(entry.block_read))


def _cautions(entry: CautionsEntry | None, base: Cautions) -> Cautions:
    if entry is None:
        return base
    return Cautions(
        base.never | set(entry.never),
        base.keys | set(entry.keys),
        base.may_start | set(entry.may_start),
        {**base.unanswered, **entry.unanswered},
    )


def _by_number(table: Mapping[str, str]) -> dict[int, str]:
    return {int(code): text for code, text in table.items()}


def _contradictions(model: Model) -> Iterator[str]:
    """Find what one entry says and another does not know of."""
    at: dict[int, str] = {}
    for register in model.registers.values():
        if register.address in at:
            other = at[register.address]
            yield f"register {register.name!r}: address: {register.address:04X}H is {other!r} already"
        at[register.address] = register.name
    derived = [d.name for d in model.derived]
    for name in derived:
        if name in model.registers:
            yield f"derived {name!r}: a register has this name"
    yield from _twice("derived", derived)
    yield from _twice("connector", [c.name for c in model.connectors])
    for key, name in _named(model):
        if name and name not in model.registers:
            yield f"{key}: no register {name!r}"
    for name, bit in model.cautions.unanswered.items():
        if name in model.registers and bit not in model.registers[name].bits.values():
            yield f"cautions: unanswered.{name}: the register has no bit {bit!r}"
    for connector in model.connectors:
        yield from _selector_counts(connector, model.blocks)


def _twice(key: str, names: Iterable[str]) -> Iterator[str]:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            yield f"{key} {name!r}: the name exists already"
        seen.add(name)


def _named(model: Model) -> Iterator[tuple[str, str]]:
    """Give every place that names a register, and the name."""
    for register in model.registers.values():
        yield f"register {register.name!r}: minimum_from", register.minimum_from
        yield f"register {register.name!r}: maximum_from", register.maximum_from
    for code, name in model.read_selectors.items():
        yield f"read_selectors.{code}", name
    for code, name in model.write_selectors.items():
        yield f"write_selectors.{code}", name
    for connector in model.connectors:
        for role, name in connector.parameters.items():
            yield f"connector {connector.name!r}: parameters.{role}", name
        for name in connector.block_write:
            yield f"connector {connector.name!r}: block_write", name
        for name in connector.block_read:
            yield f"connector {connector.name!r}: block_read", name
    for key, names in (("keys", model.cautions.keys), ("may_start", model.cautions.may_start)):
        for name in sorted(names):
            yield f"cautions: {key}", name
    for name in model.cautions.unanswered:
        yield "cautions: unanswered", name
    for d in model.derived:
        yield f"derived {d.name!r}: of", d.of
        yield f"derived {d.name!r}: base", d.base
    derived = {d.name for d in model.derived}
    for values, every in model.profile:
        for name in values:
            yield f"profile {every!r}: values", "" if name in derived else name


def _selector_counts(connector: Connector, blocks: BlockForms) -> Iterator[str]:
    """Find a connector with fewer or more selectors than its block has words."""
    for key, names, words in (
        ("block_write", connector.block_write, blocks.indirect_write_words),
        ("block_read", connector.block_read, blocks.indirect_read_maximum),
    ):
        if names and len(names) != words:
            yield f"connector {connector.name!r}: {key}: {len(names)} selectors for a block of {words} words"
