"""What is read of others is exact, or nothing."""

from __future__ import annotations

from decimal import Decimal

import pytest

from gateway.mqtt import exact
from gateway.mqtt.exact import NotExact


@pytest.mark.parametrize(
    ("payload", "found"),
    [
        (b"stop", "stop"),
        (b"  30.0\n", "30.0"),
        (b'"30.0"', "30.0"),
        (b"", ""),
        (b'{"value": 30.0}', {"value": Decimal("30.0")}),
        (b'{"value": 1e1, "id": 7}', {"value": Decimal("10"), "id": Decimal(7)}),
        (b'{"a": [true, null, "\\u00e4"]}', {"a": [True, None, "ä"]}),
    ],
)
def test_text_and_json_are_read(payload: bytes, found: object) -> None:
    """Plain, quoted, or an object; numbers as they were written."""
    assert exact.document(payload) == found


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"\xff\xfe", "byte 0 is not UTF-8"),
        ('{"value": 1}'.encode("utf-16-le"), "no JSON"),
        (b"x" * 4097, "4097 bytes; at most 4096"),
        (b'{"value": NaN}', "NaN is no number"),
        (b'{"value": Infinity}', "Infinity is no number"),
        (b'{"value": -Infinity}', "-Infinity is no number"),
        (b'{"value": 1e999}', "no number that anything here could hold"),
        (b'{"value": %s}' % (b"9" * 4000), "no number that anything here could hold"),
        (b'{"value": 1, "value": 2}', 'key "value" stands there twice'),
        (b'{"a": {"b": 1, "b": 1}}', 'key "b" stands there twice'),
        (b'{"value": 01}', "no JSON"),
        (b"{" * 3000, "no JSON"),
        (b'{"a":' + b"[" * 4000, "no JSON: nested too deep"),
        (b"[30.0]", "a JSON object is wanted"),
        (b'{"value": 30', "no JSON"),
        (b'"30', "no JSON"),
    ],
)
def test_what_is_not_exact_is_refused_in_words(payload: bytes, words: str) -> None:
    """No guess at an encoding, a number or a key."""
    with pytest.raises(NotExact, match=words.replace("[", r"\[")):
        exact.document(payload)


@pytest.mark.parametrize("text", ["30", "30.0", "-0.5", "+7", "1e2", "1E-2", "007", " 3 "])
def test_numbers_are_taken_as_they_are_written(text: str) -> None:
    """From JSON strings and plain payloads alike."""
    assert exact.number(text) == Decimal(text.strip())
    assert exact.number_or_words(text) == Decimal(text.strip())


@pytest.mark.parametrize(
    "text",
    ["", "nan", "inf", "Infinity", "sNaN", "1_000", "\uff13\uff10", "\u0663", "1e100", "0x10", "1,5", "30 Hz", "."],
)
def test_no_number_is_made_of_what_is_none(text: str) -> None:
    """Python takes underscores, other alphabets' digits, infinities; a motor must not."""
    with pytest.raises(NotExact):
        exact.number(text)


@pytest.mark.parametrize("value", [True, False, None, [], {}, 3.0])
def test_only_numbers_and_texts_are_numbers(value: object) -> None:
    """A truth is not 1."""
    with pytest.raises(NotExact, match="is no number"):
        exact.number(value)
    with pytest.raises(NotExact):
        exact.number_or_words(value)


def test_codes_and_bits_by_name_are_words() -> None:
    """What a number in an odd spelling is not."""
    assert exact.number_or_words(" run+command_priority ") == "run+command_priority"
    assert exact.number_or_words("0xC400") == "0xC400"
    for text in ("1_000", "nan", "Infinity", "\uff11", "1e500", "a\nb", "x" * 129):
        with pytest.raises(NotExact):
            exact.number_or_words(text)


def test_raw_words_are_whole_and_hexadecimal_is_marked() -> None:
    """One word each, as many as may be."""
    assert exact.words([Decimal(0), Decimal(65535), "C400H", "0x1a"], 4) == (0, 65535, 0xC400, 0x1A)
    wrong: object
    for wrong in ([], [Decimal(1)] * 5, "C400", None, [Decimal(-1)], [Decimal(65536)], [Decimal("1.5")], [True]):
        with pytest.raises(NotExact):
            exact.words(wrong, 4)
    for wrong in ("C400", "10000H", "0x", "\u0661H", Decimal("1E+2")):
        with pytest.raises(NotExact):
            exact.words([wrong], 4)


def test_names_are_short_and_printable() -> None:
    """They go into logs and topics: no line breaks, no lone surrogates."""
    assert exact.name("dashboard Ä", "source") == "dashboard Ä"
    assert exact.name(Decimal(42), "id") == "42"
    for wrong in ("a\nb", "\x1b[2J", "\ud800", "x" * 129, Decimal("4.2"), Decimal("1E+5"), True, None, ["a"]):
        with pytest.raises(NotExact, match=r"id .*: a printable text of at most 128"):
            exact.name(wrong, "id")


def test_an_id_is_a_name_or_any_number_or_none() -> None:
    """As counters and times of many languages are."""
    for value, found in (("a7", "a7"), (Decimal(42), "42"), (Decimal("4.20"), "4.20"), (None, ""), ("", "")):
        assert exact.identity(value, "id") == found
    wrong: object
    for wrong in ("a\nb", "x" * 129, True, ["a"], {}):
        with pytest.raises(NotExact, match=r"id .*: a printable text of at most 128"):
            exact.identity(wrong, "id")


def test_times_name_their_offset_or_are_utc() -> None:
    """ISO 8601 and seconds; milliseconds as JavaScript has them."""
    noon = 1_772_366_400.0
    value: object
    for value in ("2026-03-01T12:00:00Z", "2026-03-01 12:00", "2026-03-01T13:00:00.000+01:00", Decimal(1772366400)):
        assert exact.moment(value, "issued") == noon
    assert exact.moment(Decimal("1772366400250"), "issued") == noon + 0.25
    assert exact.moment("2026-03-01T12:00:00.5Z", "issued") == noon + 0.5
    wrong: list[object] = ["2026-03-01", "2026-13-01T00:00:00Z", "20260301T120000Z", "now", "", Decimal(-1)]
    for value in [*wrong, Decimal(10) ** 20, True, None, "2026-W09-7T12:00"]:
        with pytest.raises(NotExact, match=r"issued .* is no time"):
            exact.moment(value, "issued")


def test_what_is_repeated_in_words_is_short_and_plain() -> None:
    """Whatever was sent."""
    assert exact.shown("a\nb") == r'"a\nb"'
    assert exact.shown("\ud800") == r'"\ud800"'
    assert len(exact.shown("x" * 4000)) == 60
    values: list[object] = [Decimal("30.0"), True, None, [1], {}]
    shown = [exact.shown(value) for value in values]
    assert shown == ["30.0", "true", "null", "a list", "an object"]
