"""The form of a catalogue file: what may stand in it, and how an error in it is said."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from gateway.drives.register import Kind, Storage
from gateway.errors import BadConfig


def _form(pattern: str, wanted: str) -> AfterValidator:
    """Check a text by its pattern, and say in words what is wanted where it does not match."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(f"{wanted} is wanted")
        return text

    return AfterValidator(check)


def _one_word(text: str) -> str:
    if int(text) > 0xFFFF:
        raise ValueError("a code of one word is wanted: at most 65535")
    return text


Name = Annotated[str, _form("[a-z][a-z0-9_]*", "a name of a-z, 0-9 and _, a letter first,")]
NameOrNone = Annotated[str, _form("([a-z][a-z0-9_]*)?", "a register's name, or nothing,")]
ModelName = Annotated[str, _form("[a-z][a-z0-9-]*", "a name of a-z, 0-9 and -, a letter first,")]
Text = Annotated[str, Field(min_length=1)]
Word = Annotated[int, Field(ge=0, le=0xFFFF)]
Bit = Annotated[str, _form("1[0-5]|[0-9]", "a bit from 0 to 15")]
Code = Annotated[str, _form("0|[1-9][0-9]{0,4}", "a decimal number"), AfterValidator(_one_word)]
ScaleText = Annotated[str, _form(r"[0-9]+(\.[0-9]+)?", 'a positive number in quotes, as "0.01",')]
Duration = Annotated[str, _form(r"[0-9]+(\.[0-9]+)?\s*(ms|s|min|h)", 'a duration, as "200ms" or "5min",')]
Pair = Annotated[tuple[int, int], Field(strict=False)]  # TOML has arrays only
Role = Literal[
    "baud_rate",
    "parity",
    "number",
    "timeout",
    "timeout_action",
    "timeout_detection",
    "wait_time",
    "protocol",
    "master_slave",
]


class Entry(BaseModel):
    """A table of a catalogue file: unknown keys are refused, values are not coerced."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class TimesEntry(Entry):
    """[times]: how long the model may take, in seconds."""

    processing: float = Field(0.015, gt=0, le=2)
    eeprom: float = Field(0.050, gt=0, le=2)
    start_up: float = Field(1.0, ge=0, le=60)
    source: Text


class BlocksEntry(Entry):
    """[blocks]: the block forms of the model; what is left out it has not got."""

    indirect_read_address: Word = 0
    indirect_read_minimum: int = Field(0, ge=0, le=5)
    indirect_read_maximum: int = Field(0, ge=0, le=5)
    indirect_write_address: Word = 0
    indirect_write_words: int = Field(0, ge=0, le=2)
    has_exchange: bool = False
    direct_read_maximum: int = Field(0, ge=0, le=8)
    direct_ranges: list[Pair] = []
    source: Text


class ConnectorEntry(Entry):
    """[[connector]]: the communication parameters of one RS485 connector, by register name."""

    name: Name
    parameters: dict[Role, Name]
    block_write: list[Name] = []
    block_read: list[Name] = []
    source: Text


class CautionsEntry(Entry):
    """[cautions]: what to be careful of when writing; a file that extends a model adds to them."""

    never: list[Word] = []
    keys: list[Name] = []
    may_start: list[Name] = []
    unanswered: dict[Name, Name] = {}
    source: Text


class CodeEntry(Entry):
    """One code of an [enumeration.NAME] table."""

    name: str = ""
    text: Text


class DerivedEntry(Entry):
    """[[derived]]: a value computed from a percentage and its base."""

    name: Name
    of: Name
    base: Name
    unit: Text
    digits: int = Field(2, ge=0, le=4)
    source: Text


class PollEntry(Entry):
    """[[profile]]: what to read, and how often, when the configuration does not say."""

    values: list[Name] = Field(min_length=1)
    every: Duration


class RegisterEntry(Entry):
    """[[register]]: one communication number."""

    name: Name
    address: Word
    kind: Kind = Field(strict=False)
    source: Text
    replaces: bool = False
    held: Word | None = None  # where the drive keeps what this was at a trip: the register trip_<name>
    title: str = ""
    unit: str = ""
    scale: ScaleText = "1"
    signed: bool = False
    range: Pair | None = None
    minimum_from: Name = ""
    maximum_from: Name = ""
    access: Literal["r", "rw"] = "r"
    storage: Storage = Field(Storage.NONE, strict=False)
    writable_while_running: bool = True
    takes_effect: Literal["at once", "after reset"] = "at once"
    initial: int | None = None  # 0, or the end of the range that is nearest to it
    bits: dict[Bit, Name] = {}
    values: dict[Code, Text] = {}
    enumeration: Name = ""


class ModelHead(Entry):
    """[model]: what the model is called and how it says who it is."""

    name: ModelName
    title: Text
    source: Text
    identity: str = ""
    series_code: Word | None = None


class ForeignEntry(Entry):
    """[[foreign]]: a number that tells a drive of another model; without `words` by its being known at all."""

    address: Word
    words: list[Word] = []
    means: Text
    source: Text


class CatalogueFile(Entry):
    """One file: a whole model under [model], or what `extend = "model-name"` adds to one."""

    model: ModelHead | None = None
    extend: ModelName | None = None
    foreign: list[ForeignEntry] = []
    times: TimesEntry | None = None
    blocks: BlocksEntry | None = None
    connector: list[ConnectorEntry] = []
    cautions: CautionsEntry | None = None
    read_selectors: dict[Code, NameOrNone] = {}
    write_selectors: dict[Code, NameOrNone] = {}
    capacities: dict[Code, Text] = {}
    enumeration: dict[Name, dict[Code, CodeEntry]] = {}
    derived: list[DerivedEntry] = []
    profile: list[PollEntry] = []
    registers: list[RegisterEntry] = Field([], alias="register")  # pydantic has a register of its own


def parse(name: str, text: str) -> CatalogueFile:
    """Read the text of a catalogue file; BadConfig lists everything that is wrong in its form."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadConfig(f"{name}: not TOML: {error}") from error
    try:
        return CatalogueFile.model_validate(table)
    except ValidationError as error:
        wrong = [f"{name}: {_where(table, item['loc'])}: {_reason(item)}" for item in error.errors()]
        raise BadConfig("\n".join(dict.fromkeys(wrong))) from error


def _where(table: Mapping[str, Any], keys: tuple[int | str, ...]) -> str:
    """Spell the place of an error; an entry of a list is called by its own name where it has one."""
    if len(keys) > 1 and isinstance(keys[1], int):
        entry = table[str(keys[0])][keys[1]]
        label = entry.get("name", keys[1] + 1) if isinstance(entry, dict) else keys[1] + 1
        return ": ".join([f"{keys[0]} {label!r}", *filter(None, [_dotted(keys[2:])])])
    return _dotted(keys)


def _dotted(keys: tuple[int | str, ...]) -> str:
    return ".".join(str(key) for key in keys if key != "[key]")


def _reason(item: Any) -> str:
    if item["type"] == "extra_forbidden":
        return "no such key"
    if item["type"] == "missing":
        return "is missing"
    return f"{item['msg'].removeprefix('Value error, ')} (given: {item['input']!r:.80})"
