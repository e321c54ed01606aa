"""Rights: what is covered by some right may be done, all else may not, whoever asks."""

from __future__ import annotations

from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import FUNCTIONS, ModbusTcpSection
from gateway.modbus_tcp.guard import permits
from gateway.modbus_tcp.rights import NOTHING, READ_ALL, Grants, Right, Rights, deeds
from tests.modbus_tcp.plant import exchange, several

TLS = {"certificate": "a", "key": "b", "ca": "c"}
READ = bytes.fromhex("03fd000001")
IDENTIFY = b"\x2b\x0e\x01\x00"


def grants(*rights: dict[str, Any], tls: bool = True) -> Grants:
    """Return the rights of a configuration."""
    section = {"right": list(rights), **({"tls": TLS} if tls else {})}
    return Grants(ModbusTcpSection.model_validate(section))


def may(rights: Rights | None, unit: int, pdu: bytes) -> bool:
    """Say whether a request may be made."""
    assert rights is not None
    return permits(rights, unit, pdu)


@pytest.mark.hazard("H28")
def test_without_any_right_a_role_reads_and_nobody_without_one_does_anything() -> None:
    """Read only is what a certificate with a role is good for by itself."""
    made = grants()
    assert made.of_role("viewer", "10.0.0.7") == READ_ALL
    assert made.of_role(None, "10.0.0.7") == NOTHING
    assert not may(NOTHING, 1, READ)
    assert may(READ_ALL, 1, READ)
    assert may(READ_ALL, 1, IDENTIFY)
    assert not may(READ_ALL, 1, several(0xFA00, 0))


@pytest.mark.hazard("H28")
def test_who_comes_without_tls_may_write_only_where_there_is_no_tls_or_a_right_says_so() -> None:
    """A way in that knows nobody is for reading beside one that does."""
    assert grants(tls=False).of_plain("10.0.0.7") is None
    assert not grants(tls=False).restricts_plain
    assert grants().of_plain("10.0.0.7") == READ_ALL
    given_ = grants({"addresses": ["10.0.0.7"], "functions": ["read", "write"]})
    assert may(given_.of_plain("10.0.0.7"), 1, several(0xFA00, 0))
    assert given_.of_plain("10.0.0.8") == NOTHING


@pytest.mark.hazard("H28")
def test_as_soon_as_one_role_has_a_right_the_others_have_none() -> None:
    """Whatever no right names is refused."""
    made = grants({"role": "view*"}, {"role": "operator", "functions": ["read", "write"], "units": [1]})
    assert may(made.of_role("viewer", "::1"), 9, READ)
    assert may(made.of_role("operator", "::1"), 1, several(0xFA00, 0))
    assert not may(made.of_role("operator", "::1"), 2, READ)
    assert made.of_role("Operator", "::1") == NOTHING
    assert made.of_role("stranger", "::1") == NOTHING
    assert may(made.of_plain("::1"), 1, READ)


@pytest.mark.hazard("H28")
def test_a_role_may_be_bound_to_addresses() -> None:
    """A certificate that was carried away is good for nothing elsewhere; IPv4 and IPv6 do not mix."""
    made = grants({"role": "operator", "addresses": ["10.0.0.0/24", "fd00::/16"]})
    assert may(made.of_role("operator", "10.0.0.200"), 1, READ)
    assert may(made.of_role("operator", "fd00::7"), 1, READ)
    for elsewhere in ("10.0.1.1", "fe80::1", "", "nonsense"):
        assert made.of_role("operator", elsewhere) == NOTHING


@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    ("functions", "pdu", "expected"),
    [
        (["read"], READ, True),
        (["read"], bytes.fromhex("04fd000001"), True),
        (["read"], IDENTIFY, True),
        (["read"], bytes.fromhex("06fa000000"), False),
        (["read"], exchange(0xFD00, 1, 0xFA00, 0), False),
        (["write"], exchange(0xFD00, 1, 0xFA00, 0), False),
        (["read", "write"], exchange(0xFD00, 1, 0xFA00, 0), True),
        ([23], exchange(0xFD00, 1, 0xFA00, 0), True),
        ([23], READ, False),
        ([23], bytes.fromhex("06fa000000"), False),
        ([3], READ, True),
        ([3], bytes.fromhex("04fd000001"), False),
        ([3], IDENTIFY, False),
        ([43], IDENTIFY, True),
        ([6], bytes.fromhex("06fa000000"), True),
        ([6], several(0xFA00, 0), False),
        ([16], several(0xFA00, 0, 0), True),
        (["read"], b"\x05\0\0\xff\0", True),  # no function of this server: 01 anyway
        (["write"], READ, False),
        (["write"], b"\x03", False),
        (["read"], b"\x03", True),  # not exact: 03, as for everybody
        (["read"], b"\x10\xfa\0", False),
        (["write"], b"\x10\xfa\0", True),
        (["read"], bytes.fromhex("03fd000000"), True),
        (["read"], bytes.fromhex("03ffff0010"), True),  # beyond the last register: 02, as for everybody
    ],
)
def test_functions(functions: list[Any], pdu: bytes, expected: bool) -> None:
    """17H wants both halves; a code is that function alone."""
    rights = Rights((Right(deeds=deeds(functions)),))
    assert permits(rights, 1, pdu) is expected


@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    ("start", "count", "expected"),
    [
        (0xFD00, 4, True),
        (0xFD00, 5, True),
        (0xFD00, 9, False),
        (0xFCFF, 2, False),
        (0xFD03, 3, True),
        (0xFD08, 1, False),
        (0xFD10, 1, True),
        (0xFD0F, 2, False),
        (0xFD10, 2, False),
        (0xFFFF, 1, False),
    ],
)
def test_a_range_is_covered_whole_by_whichever_rights(start: int, count: int, expected: bool) -> None:
    """Neighbouring ranges of two rights are one; half inside is outside."""
    rights = Rights((Right(registers=((0xFD00, 0xFD03),)), Right(registers=((0xFD04, 0xFD07), (0xFD10, 0xFD10)))))
    assert rights.permits(1, (3, False), start, count) is expected


SPANS = st.tuples(st.integers(0, 30), st.integers(0, 30)).map(lambda pair: (min(pair), max(pair)))
RIGHTS = st.builds(
    Right,
    units=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)).map(sorted).map(tuple), min_size=1).map(tuple),
    deeds=st.lists(st.sampled_from(FUNCTIONS)).map(lambda functions: deeds(cast("list[int | str]", functions))),
    registers=st.lists(SPANS, min_size=1, max_size=3).map(tuple),
)


@pytest.mark.unmeasured
@given(st.lists(RIGHTS, max_size=4), st.integers(0, 3), st.integers(0, 30), st.integers(1, 8))
def test_rights_are_what_a_look_at_every_register_says(
    given_: list[Right], unit: int, first: int, count: int
) -> None:
    """The merged ranges against the definition."""
    for deed in ((3, False), (6, True), (23, False), (23, True)):
        covered = {
            register
            for right in given_
            if deed in right.deeds and any(low <= unit <= high for low, high in right.units)
            for low, high in right.registers
            for register in range(low, high + 1)
        }
        rights = Rights(tuple(given_))
        assert rights.permits(unit, deed, first, count) is covered.issuperset(range(first, first + count))
        assert rights.touches(unit, deed) is bool(covered)
        assert not rights.reading().permits(unit, (6, True), first, count)
