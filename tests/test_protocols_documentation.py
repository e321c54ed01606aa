"""docs/protocols.md: every row of its table is whole and names tests that exist; its frames and figures are true."""

from __future__ import annotations

import ast
import contextlib
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import get_args

import pytest

from gateway.errors import Refusal
from gateway.protocol import modbus_rtu, toshiba
from gateway.protocol.codec import Codec, NoSuchForm
from gateway.protocol.pdu import (
    Exchange,
    Identify,
    Proportional,
    ReadBlock,
    ReadWords,
    Reply,
    Request,
    WriteBlock,
    WriteRam,
    WriteStored,
)
from gateway.protocol.registry import PROTOCOLS
from tests.protocol.drive_side import heard
from tests.protocol_page import headed, spans, table, tables
from tests.protocol_rows import CASES
from tests.protocol_speed import CONDITIONS, CYCLES, FORMS, Form, spoken

ROOT = Path(__file__).parents[1]
EXAMPLE = "example: request → answer"
WITH_EXAMPLE = ["row", "command or case", EXAMPLE, "gateway", "simulated line", "test"]
WITHOUT = ["row", "rule", "gateway", "simulated line", "test"]
NAMES = ("toshiba-ascii", "toshiba-binary", "modbus-rtu")  # the order of the columns

ROWS = [
    dict(zip(rows[0], row, strict=True))
    for rows in tables()
    if rows[0] in (WITH_EXAMPLE, WITHOUT)
    for row in rows[1:]
]
EXAMPLES = {row["row"]: row[EXAMPLE] for row in ROWS if EXAMPLE in row}


@cache
def node_ids(path: str) -> frozenset[str]:
    """Return the names of the tests in a file, as pytest takes them, without running it."""
    found = set()
    for node in ast.parse((ROOT / path).read_text(encoding="utf-8")).body:
        members = node.body if isinstance(node, ast.ClassDef) else [node]
        for member in members:
            if isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef) and member.name.startswith("test_"):
                found.add(f"{node.name}::{member.name}" if isinstance(node, ast.ClassDef) else member.name)
    return frozenset(found)


def test_every_row_has_all_its_cells_and_a_name_of_its_own() -> None:
    """Nothing is left blank; rows are numbered through in each part."""
    assert len(ROWS) > 130
    for row in ROWS:
        assert not [name for name, cell in row.items() if not re.search(r"\w\w", cell)], row
    names = [row["row"] for row in ROWS]
    for part in "ABMTV":
        of_part = [name for name in names if name.startswith(part)]
        assert of_part == [f"{part}{place}" for place in range(1, len(of_part) + 1)]
    assert {name[0] for name in names} == set("ABMTV")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["row"])
def test_every_test_and_every_module_that_a_row_names_exists(row: dict[str, str]) -> None:
    """Tests are found by reading the files; modules are below gateway/, those of the simulated line in sim/."""
    named = spans(row["test"])
    assert named
    assert row["test"] == "<br>".join(f"`{name}`" for name in named)
    for name in named:
        path, _, test = name.partition("::")
        assert test in node_ids(path), name
    for column in ("gateway", "simulated line"):
        modules = [span for span in spans(row[column]) if span.endswith(".py")]
        assert modules, (row["row"], column)
        for module in modules:
            assert (ROOT / "gateway" / module).is_file(), module
            assert module.startswith("sim/") == (column == "simulated line"), module


def frames(row: str) -> tuple[bytes, bytes | None]:
    """Return request and answer of an example, None for silence; ASCII stands there as text too, and the same."""
    lines = EXAMPLES[row].split("<br>")
    request, answer = lines[-1].split(" → ")
    read = bytes.fromhex(request.strip("`")), None if answer == "silence" else bytes.fromhex(answer.strip("`"))
    if row.startswith("A"):
        texts = [frame.decode("ascii").rstrip("\r") for frame in read if frame is not None]
        assert spans(lines[0]) == texts
    assert len(lines) == (2 if row.startswith("A") else 1)
    return read


def test_every_row_with_frames_has_a_case_that_makes_them() -> None:
    """And no case is without its row."""
    assert set(EXAMPLES) == set(CASES)


@pytest.mark.parametrize("row", EXAMPLES)
def test_the_codec_makes_the_request_or_never_does(row: str) -> None:
    """What the gateway does not send is no frame of the request that it would have made."""
    case, (request, _) = CASES[row], frames(row)
    if case.frame is None:
        assert case.codec.encode(case.request) == request
        return
    assert case.frame == request
    with contextlib.suppress(NoSuchForm):
        assert case.codec.encode(case.request) != request


@pytest.mark.parametrize("row", [row for row, case in CASES.items() if case.drive is not None])
def test_the_simulated_drive_gives_the_answer(row: str) -> None:
    """Or keeps silent."""
    case, (request, answer) = CASES[row], frames(row)
    assert case.drive is not None
    assert case.drive().send(request) == answer


@pytest.mark.parametrize("row", EXAMPLES)
def test_the_codec_says_what_the_answer_means(row: str) -> None:
    """Fed whole and byte by byte, the silence behind it; an answer to something else is none."""
    case, (_, answer) = CASES[row], frames(row)
    if answer is None:
        assert case.said is None
        return
    expected = [] if case.said is None else [case.said]
    for pieces in ([answer], [bytes([byte]) for byte in answer]):
        assert heard(case.codec.decoder(case.request), [*pieces, b""]) == expected


def test_only_what_cannot_be_simulated_is_not() -> None:
    """A faulty EEPROM, and typ in progress: one row for each protocol, and it says so."""
    not_simulated = [row["row"] for row in ROWS if row["simulated line"].startswith("not simulated")]
    assert not_simulated == [row for row, case in CASES.items() if case.drive is None]
    assert len(not_simulated) == len(PROTOCOLS)


def command(row: str, frame: bytes) -> str:
    """Return the command letter or function of a frame."""
    if row.startswith("M"):
        return f"{frame[1]:02X}"
    found = re.search(rb"[A-Za-z]", frame[1:] if row.startswith("A") else frame[1:3].lstrip(bytes(range(0x40))))
    return found[0].decode() if found else ""


def test_no_command_and_no_error_is_left_out() -> None:
    """Letters, functions, read codes and error codes of the manuals, each in an example."""
    asked: dict[str, set[str]] = {"A": set(), "B": set(), "M": set()}
    told: dict[str, set[str]] = {"A": set(), "B": set(), "M": set()}
    errors: dict[str, set[int]] = {"A": set(), "B": set(), "M": set()}
    for row in EXAMPLES:
        request, answer = frames(row)
        asked[row[0]].add(command(row, request))
        if answer is None:
            continue
        letter = command(row, answer)
        told[row[0]].add(letter)
        if letter in "Nn":
            code = re.search(rb"[Nn]([0-9]{4})", answer) if row.startswith("A") else None
            errors[row[0]].add(int(code[1], 16) if code else int.from_bytes(answer[3:5], "big"))
        elif row.startswith("M") and answer[1] & 0x80:
            errors["M"].add(answer[2])
    assert set("RWP") <= asked["A"]
    assert set("RWPrwpNn") == told["A"]
    assert set("RGWPXSs") <= asked["B"]
    assert set("RGWPYrgwpyNn") == told["B"]
    assert {"03", "06", "10", "17", "2B"} <= asked["M"]
    assert {"83", "86", "90", "97", "AB"} <= told["M"]
    assert errors == {"A": {0, 1, 2, 3, 4}, "B": {0, 1, 2, 4}, "M": {1, 2, 3, 4}}
    identified = {frames(row)[0][3] for row, case in CASES.items() if isinstance(case.request, Identify)}
    assert set(range(4)) <= identified


def test_the_choice_says_what_the_codecs_have() -> None:
    """Numbers and forms."""
    said = {row[0]: row[1:] for row in table("")}
    codecs = [PROTOCOLS[name] for name in NAMES]
    assert said["`protocol`"] == [f"`{name}`" for name in NAMES]
    numbers = [f"{codec.forms.numbers[0]} to {codec.forms.numbers[-1]}" for codec in codecs]
    assert said["inverter numbers (F802)"] == numbers
    for label, form in (
        ("write of a stored parameter to RAM only", "has_ram_write"),
        ("direct block (consecutive numbers)", "has_direct_block"),
        ("indirect block (F875-F879)", "has_block"),
        ("write and read in one frame", "has_exchange"),
        ("broadcast to a digit of the number", "has_digit_groups"),
        ("trip flag in every answer", "says_tripped"),
        ("identification (maker, type, version)", "has_identification"),
        ("proportional command S", "has_proportional"),
    ):
        assert said[label] == ["yes" if getattr(codec.forms, form) else "no" for codec in codecs], label
    assert said["request without a number"] == [yes_or_no(codec, ReadWords(None, 0)) for codec in codecs]


def yes_or_no(codec: Codec, request: Request) -> str:
    """Say whether a codec has a frame for a request."""
    try:
        codec.encode(request)
    except NoSuchForm:
        return "no"
    return "yes"


ASKED: dict[str, Request] = {
    "`ReadWords`, one word": ReadWords(1, 0xFD00),
    "`ReadWords`, 2 to 8 words": ReadWords(1, 0xFD00, 8),
    "`ReadBlock`": ReadBlock(1, 0x1875, 5),
    "`WriteRam`": WriteRam(1, 0xFA01, 0),
    "`WriteStored`": WriteStored(1, 0x0880, 0),
    "`WriteBlock`": WriteBlock(1, 0x1870, (0, 0)),
    "`Exchange`": Exchange(1, 0x1875, 5, 0x1870, (0, 0)),
    "`Identify`": Identify(1),
    "`Proportional`": Proportional(1, 0xFA01, 0),
}


def test_the_request_model_is_the_codecs() -> None:
    """Every request and every reply; none where a codec has no frame."""
    rows = table("request")
    assert [row[0] for row in rows] == list(ASKED)
    assert {type(request) for request in ASKED.values()} == set(get_args(Request))
    assert {spans(row[1])[0] for row in rows if spans(row[1])} == {reply.__name__ for reply in get_args(Reply)}
    for title, _, *frames_ in rows:
        for name, cell in zip(NAMES, frames_, strict=True):
            assert (cell == "none") == (yes_or_no(PROTOCOLS[name], ASKED[title]) == "no"), (title, name)


def test_the_reasons_are_those_of_the_codecs() -> None:
    """Each error code beside what it becomes."""
    rows = {row[0]: row[1:4] for row in table("reason")}
    assert set(rows) == {reason.value for reason in Refusal} - {Refusal.OTHER.value}
    for code, reason in toshiba.REFUSALS.items():
        ascii_, binary, _ = rows[reason.value]
        assert ascii_ == f"{code:04}"
        assert binary == ("silence" if reason is Refusal.COMMAND else f"{code:04}")
    for code, reason in modbus_rtu.REFUSALS.items():
        assert rows[reason.value][2] == f"{code:02}"


@pytest.mark.parametrize(
    ("heading", "forms"), [("five values by", FORMS), ("command, frequency and five values by", CYCLES)]
)
def test_the_figures_are_the_lines_arithmetic(heading: str, forms: Mapping[str, Form]) -> None:
    """Exchanges a second, and rounds a second, under the conditions of the heading."""
    title, *rows = headed(heading)
    conditions = [re.findall(r"\d+", cell) for cell in title[1:]]
    assert conditions == [[str(c.baud), f"{c.processing * 1000:.0f}"] for c in CONDITIONS]
    assert rows == [[name, *(spoken(form, c) for c in CONDITIONS)] for name, form in forms.items()]
