"""Bytes to values and back, for each protocol that the drives speak; no I/O and no clock."""
