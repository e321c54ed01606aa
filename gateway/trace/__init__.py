"""Seeing the wire: what went over each line, when, and what was made of it, for people and for Wireshark."""
