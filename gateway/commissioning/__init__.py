"""Commissioning by hand: finding the drives of a line, reading and writing single values, the panel's display."""
