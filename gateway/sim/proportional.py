"""What a slave makes of the proportional command S: a frequency of its own, and F806 (VF-MB1 RS485 4.2, 6)."""

from __future__ import annotations

from fractions import Fraction

from gateway.sim.memory import Memory

ZERO, GO_ON, TRIP = range(3)  # F806: what a slave does when its master trips; 3 and 4 are masters
FULL = 10_000  # 100.00 % in a command
PERCENT = 100  # counts of 0.01 % in one of F811 and F813
HIGHEST = 0xFFFF


def counts_of_hertz(memory: Memory, word: int, maximum: float) -> int | None:
    """Return the counts of 0.01 Hz for counts of 0.01 %, fractions omitted; `maximum` is FH in Hz.

    None where F811 and F813 are the same point, which leaves no line to go by. Less than 0 becomes 0.
    """
    if not memory.word("frequency_points"):
        return min(HIGHEST, word * round(maximum * 100) // FULL)
    first, second = (PERCENT * memory.word(f"point_{number}_setting") for number in (1, 2))
    low, high = (memory.word(f"point_{number}_frequency") for number in (1, 2))
    if first == second:
        return None
    hertz = low + Fraction((high - low) * (word - first), second - first)
    return min(HIGHEST, max(0, int(hertz)))
