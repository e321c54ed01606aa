"""Reads the role and the time of validity from an X.509 certificate, strictly by DER. Pure.

Whoever asks has had the certificate verified already; nothing here says that it is genuine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

ROLE_OID = bytes.fromhex("2b0601040183890c862201")  # 1.3.6.1.4.1.50316.802.1, MODBUS/TCP Security Protocol, 8.4
LONGEST_ROLE = 64  # characters
LONGEST_CERTIFICATE = 64 * 1024  # bytes

# Tags of X.690; those in brackets of RFC 5280, 4.1.
BOOLEAN, INTEGER, BIT_STRING, OCTET_STRING, OBJECT_IDENTIFIER, UTF8_STRING = 0x01, 0x02, 0x03, 0x04, 0x06, 0x0C
UTC_TIME, GENERALIZED_TIME, SEQUENCE = 0x17, 0x18, 0x30
VERSION, ISSUER_ID, SUBJECT_ID, EXTENSIONS = 0xA0, 0x81, 0x82, 0xA3
EXTENSION_FORMS = ([OBJECT_IDENTIFIER, OCTET_STRING], [OBJECT_IDENTIFIER, BOOLEAN, OCTET_STRING])
FORMS = {UTC_TIME: ("%y%m%d%H%M%SZ", 13), GENERALIZED_TIME: ("%Y%m%d%H%M%SZ", 15)}
PIVOT = 2050  # two digits of a year from 50 on are of the century before (RFC 5280, 4.1.2.5.1)


class BadCertificate(Exception):
    """Bytes that are no certificate, exactly."""


@dataclass(frozen=True, slots=True)
class RoleCertificate:
    """What is said of its holder: from when to when (UTC seconds), and the role; None where there is no one role.

    `objection` says why there is none.
    """

    not_before: float
    not_after: float
    role: str | None
    objection: str = ""

    def is_valid(self, wall: float) -> bool:
        """Say whether it holds at a moment (UTC seconds)."""
        return self.not_before <= wall <= self.not_after


def read(der: bytes) -> RoleCertificate:
    """Read a whole certificate; BadCertificate where it is not exactly one."""
    if len(der) > LONGEST_CERTIFICATE:
        raise BadCertificate(f"{len(der)} bytes")
    whole = _only(der, SEQUENCE)
    tags = [(tag, content) for tag, content in _elements(whole)]
    if [tag for tag, _ in tags] != [SEQUENCE, SEQUENCE, BIT_STRING]:
        raise BadCertificate("not signed as a certificate is")
    return _of_signed(tags[0][1])


def _of_signed(signed: bytes) -> RoleCertificate:
    parts = list(_elements(signed))
    if parts and parts[0][0] == VERSION:
        del parts[0]
    wanted = [INTEGER, SEQUENCE, SEQUENCE, SEQUENCE, SEQUENCE, SEQUENCE]
    if [tag for tag, _ in parts[:6]] != wanted:
        raise BadCertificate("serial, algorithm, issuer, validity, subject, key: not as they should be")
    times = [_time(tag, content) for tag, content in _elements(parts[3][1])]
    if len(times) != 2:
        raise BadCertificate("validity is not from one time to another")
    rest = [part for part in parts[6:] if part[0] not in (ISSUER_ID, SUBJECT_ID)]
    if len(rest) > 1 or any(tag != EXTENSIONS for tag, _ in rest):
        raise BadCertificate("unknown parts behind the key")
    values = [value for _, content in rest for value in _values_of(ROLE_OID, content)]
    role, objection = _role(values)
    return RoleCertificate(times[0], times[1], role, objection)


def _values_of(wanted: bytes, extensions: bytes) -> Iterator[bytes]:
    """Yield the value of each extension of one kind; every extension has to be exact."""
    for tag, extension in _elements(_only(extensions, SEQUENCE)):
        parts = list(_elements(extension)) if tag == SEQUENCE else []
        if [part for part, _ in parts] not in EXTENSION_FORMS:
            raise BadCertificate("an extension is not as it should be")
        if parts[0][1] == wanted:
            yield parts[-1][1]


def _role(values: list[bytes]) -> tuple[str | None, str]:
    """Return the role, or None and why there is none."""
    if len(values) != 1:
        return None, f"{len(values)} roles" if values else "no role"
    try:
        text = _only(values[0], UTF8_STRING).decode("utf-8")
    except (BadCertificate, UnicodeDecodeError):
        return None, "its role is no UTF8String"
    if not 1 <= len(text) <= LONGEST_ROLE:
        return None, f"its role has {len(text)} characters, not 1 to {LONGEST_ROLE}"
    if not text.isprintable() or text != text.strip():
        return None, "its role has characters that cannot be printed, or space around it"
    return text, ""


def _time(tag: int, content: bytes) -> float:
    """Return UTC seconds; RFC 5280 has seconds in every time, and no other zone."""
    if tag not in FORMS or len(content) != FORMS[tag][1] or not content[:-1].isdigit():
        raise BadCertificate("a time is not as it should be")
    try:
        moment = datetime.strptime(content.decode("ascii"), FORMS[tag][0]).replace(tzinfo=UTC)
    except ValueError as error:
        raise BadCertificate("a time that does not exist") from error
    if tag == UTC_TIME:
        year = 1900 + int(content[:2])
        moment = moment.replace(year=year if year + 100 >= PIVOT else year + 100)
    return moment.timestamp()


def _only(data: bytes, tag: int) -> bytes:
    """Return the content of the one element that the bytes are."""
    elements = list(_elements(data))
    if len(elements) != 1 or elements[0][0] != tag:
        raise BadCertificate(f"not one element of tag {tag:02X}H")
    return elements[0][1]


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield tag and content of each element; definite lengths in their shortest form, tags of one byte."""
    at, size = 0, len(data)
    while at < size:
        if size - at < 2 or data[at] & 0x1F == 0x1F:
            raise BadCertificate("an element without length, or with a long tag")
        tag, length, at = data[at], data[at + 1], at + 2
        if length & 0x80:
            digits = length & 0x7F
            if not 1 <= digits <= 3 or size - at < digits:
                raise BadCertificate("a length that is not definite, or too long")
            length = int.from_bytes(data[at : at + digits], "big")
            if length < 0x80 or length >> 8 * (digits - 1) == 0:
                raise BadCertificate("a length that is longer than it need be")
            at += digits
        if size - at < length:
            raise BadCertificate("an element that is cut off")
        yield tag, data[at : at + length]
        at += length
