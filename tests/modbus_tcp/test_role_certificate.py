"""Roles out of certificates: one that is exactly right, or none; whatever the bytes are."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.modbus_tcp.role_certificate import LONGEST_ROLE, BadCertificate, read
from tests.modbus_tcp.certificates import (
    BMP,
    CLIENT_AUTH,
    DAY,
    IA5,
    PRINTABLE,
    ROLE,
    UTF8,
    Key,
    extension,
    role,
    sequence,
    signed,
    tlv,
    usage,
)
from tests.soak import FACTOR


class NoKey(Key):
    """Signs nothing: who reads here does not verify."""

    def sign(self, data: bytes) -> bytes:
        """Return what looks like a signature."""
        return sequence(b"\x02\x01\x01", b"\x02\x01\x01")


KEY = NoKey(Path(), sequence(sequence(b"\x06\x01\x2a"), tlv(0x03, b"\0\x04")))


def certificate(*extensions: bytes, begins: float = -1.0, ends: float = 2.0) -> bytes:
    """Write a certificate."""
    return signed("plc-1", KEY, "ca", KEY, *extensions, begins=begins, ends=ends)


def test_the_role_stands_in_the_extension_of_modbus_tcp_security() -> None:
    """Whatever else the certificate has; it may be marked critical."""
    assert read(certificate(usage(CLIENT_AUTH), role("operator"))).role == "operator"
    assert read(certificate(extension(ROLE, tlv(UTF8, b"operator"), is_critical=True))).role == "operator"
    assert read(certificate(role("Bediener für Pumpe 1"))).role == "Bediener für Pumpe 1"
    assert read(certificate(role("x" * LONGEST_ROLE))).role == "x" * LONGEST_ROLE


@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    ("extensions", "said"),
    [
        ((), "no role"),
        ((usage(CLIENT_AUTH),), "no role"),
        ((role("operator"), role("viewer")), "2 roles"),
        ((role("viewer"), role("viewer")), "2 roles"),
        ((role(""),), "0 characters"),
        ((role("x" * 65),), "65 characters"),
        ((role("operator", PRINTABLE),), "no UTF8String"),
        ((role("operator", IA5),), "no UTF8String"),
        ((role("operator", BMP),), "no UTF8String"),
        ((extension(ROLE, b"operator"),), "no UTF8String"),
        ((extension(ROLE, b""),), "no UTF8String"),
        ((extension(ROLE, tlv(UTF8, b"\xff\xfe")),), "no UTF8String"),
        ((extension(ROLE, tlv(UTF8, b"operator") + b"\0"),), "no UTF8String"),
        ((extension(ROLE, tlv(UTF8, b"operator") + tlv(UTF8, b"viewer")),), "no UTF8String"),
        ((extension(ROLE, sequence(tlv(UTF8, b"operator"))),), "no UTF8String"),
        ((role("opera\ntor"),), "cannot be printed"),
        ((role("operator\0"),), "cannot be printed"),
        ((role(" operator"),), "cannot be printed"),
        ((role("oper\u202eator"),), "cannot be printed"),
    ],
)
def test_what_is_not_exactly_one_role_is_none(extensions: tuple[bytes, ...], said: str) -> None:
    """And it is said why."""
    found = read(certificate(*extensions))
    assert found.role is None
    assert said in found.objection


def test_the_time_of_validity_is_read_in_both_forms() -> None:
    """Two digits of the year up to 2049, four from then on."""
    found = read(certificate(role("viewer"), begins=-400.0, ends=400.0))
    now = time.time()
    assert found.not_before == pytest.approx(now - 400 * DAY, abs=5)
    assert found.not_after == pytest.approx(now + 400 * DAY, abs=5)
    assert found.is_valid(now)
    assert not found.is_valid(now + 401 * DAY)
    assert not found.is_valid(now - 401 * DAY)
    far = read(certificate(role("viewer"), ends=36_500.0))
    assert far.not_after == pytest.approx(now + 36_500 * DAY, abs=5)
    old = certificate()
    at = old.index(b"\x17\x0d") + 2
    assert read(old[:at] + b"500101000000Z" + old[at + 13 :]).not_before == pytest.approx(-631_152_000)


@pytest.mark.hazard("H28")
def test_no_part_of_a_certificate_is_one() -> None:
    """Cut off anywhere, or with anything behind it."""
    whole = certificate(role("operator"), usage(CLIENT_AUTH))
    for end in range(len(whole)):
        with pytest.raises(BadCertificate):
            read(whole[:end])
    for behind in (b"\0", whole):
        with pytest.raises(BadCertificate):
            read(whole + behind)


@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    "wrong",
    [
        b"",
        b"\x30\x80\0\0",
        b"\x30\x81\x02\x05\0",
        b"\x30\x84\0\0\0\x02\x05\0",
        b"\x30\x82\0\x81" + bytes(0x81),
        b"\x3f\x81\x01\0",
        sequence(),
        sequence(sequence(), sequence(), tlv(0x03, b"\0")),
        tlv(0x31, certificate()[4:]),
        sequence(certificate()),
        bytes(70_000),
    ],
)
def test_what_is_not_der_or_no_certificate_is_refused(wrong: bytes) -> None:
    """Indefinite lengths, lengths in a longer form than need be, long tags, other structures."""
    with pytest.raises(BadCertificate):
        read(wrong)


@pytest.mark.parametrize(
    "text", [b"991301000000Z", b"9901010000000", b"99010100000Z ", b"990101000060Z", b"99010100+100Z"]
)
def test_a_time_that_is_none_is_refused(text: bytes) -> None:
    """The thirteenth month, no zone, another zone, no seconds."""
    whole = certificate()
    at = whole.index(b"\x17\x0d") + 2
    with pytest.raises(BadCertificate):
        read(whole[:at] + text + whole[at + 13 :])


@pytest.mark.hazard("H28")
def test_changed_bytes_never_make_another_role_of_an_extension_that_has_none() -> None:
    """Mutations by seed: a certificate that is read, or BadCertificate, and nothing else."""
    chance = random.Random(6)
    whole = certificate(usage(CLIENT_AUTH), role("viewer"))
    for _ in range(10_000 * FACTOR):
        changed = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            at = chance.randrange(len(changed))
            kind = chance.randrange(3)
            if kind == 0:
                changed[at] = chance.randrange(256)
            elif kind == 1:
                del changed[at]
            else:
                changed.insert(at, chance.randrange(256))
        try:
            found = read(bytes(changed))
        except BadCertificate:
            continue
        assert found.role is None or (1 <= len(found.role) <= LONGEST_ROLE and found.role.isprintable())
        assert (found.role is None) == bool(found.objection)


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    """Nothing else is raised."""
    try:
        read(data)
    except BadCertificate:
        return
