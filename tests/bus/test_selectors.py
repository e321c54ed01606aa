"""The mapping of the indirect block: what the selectors say, and what the drive's words prove."""

from __future__ import annotations

import pytest

from gateway.bus import selectors
from gateway.drives import catalogue

NC3 = catalogue.load()["vf-nc3"]
STATUS, FREQUENCY, CURRENT = (NC3.registers[name] for name in ("status", "output_frequency", "output_current"))


def test_codes_become_registers_and_0_or_unknown_codes_nothing() -> None:
    """F875-F879 = 1, 0, 2, 77, unread."""
    assert selectors.mapping_of(NC3, [1, 0, 2, 77, None]) == (STATUS, None, FREQUENCY, None, None)


def test_a_block_without_any_value_is_no_mapping() -> None:
    """As shipped all selectors are 0."""
    assert selectors.mapping_of(NC3, [0] * 5) is None


@pytest.mark.parametrize(
    ("single", "before", "after", "agrees"),
    [(6000, 5990, 6010, True), (6000, 6000, 6000, True), (5500, 5000, 6000, True), (6000, 3000, 3100, False)],
)
def test_a_number_must_lie_between_its_neighbours_in_time(single: int, before: int, after: int, agrees: bool) -> None:
    """With a little room for noise."""
    assert selectors.agree(FREQUENCY, single, before, after) is agrees


def test_bits_agree_by_their_defined_part() -> None:
    """6400H and E404H differ in bit 2 (alarm) and in bit 15, which is undefined."""
    assert selectors.agree(STATUS, 0x6404, 0xE404, 0xE404)
    assert not selectors.agree(STATUS, 0x6400, 0xE404, 0xE404)


def test_a_wrong_mapping_does_not_fit() -> None:
    """The words of another selection."""
    mapping = (STATUS, FREQUENCY)
    assert selectors.fits(mapping, [0x6400, 6000], [0x6400, 6001], {"status": 0x6400, "output_frequency": 6000})
    assert not selectors.fits(mapping, [6000, 0x6400], [6000, 0x6400], {"status": 0x6400, "output_frequency": 6000})


class TestAudit:
    def audit(self) -> selectors.Audit:
        """Return an audit of a block of frequency and current."""
        return selectors.Audit(((0, FREQUENCY), (1, CURRENT)))

    def test_a_mapping_that_stays_right_is_checked_ever_more_seldom(self) -> None:
        """Once every word has agreed on something but 0."""
        audit = self.audit()
        assert audit.every == selectors.UNPROVEN_EVERY
        words = {"output_frequency": 6000, "output_current": 5000}
        for _ in range(4):
            assert audit.block([6000, 5000])
            register = audit.next()
            audit.single(register, words[register.name])
            assert audit.block([6000, 5000])
        assert audit.every == selectors.PROVEN_EVERY

    def test_agreeing_at_0_proves_nothing(self) -> None:
        """A standing motor: every word is 0 under any mapping."""
        audit = self.audit()
        for _ in range(6):
            audit.block([0, 0])
            audit.single(audit.next(), 0)
            assert audit.block([0, 0])
        assert audit.every == selectors.UNPROVEN_EVERY

    def test_two_disagreements_in_a_row_end_the_mapping(self) -> None:
        """One may be a jump of the value."""
        audit = self.audit()
        verdicts = []
        for _ in range(2):
            audit.block([6000, 5000])
            audit.single(audit.next(), 1)
            verdicts.append(audit.block([6000, 5000]))
        assert verdicts == [True, False]
