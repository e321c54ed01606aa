"""Simulated drives on a simulated RS485 line, written from the drive manuals."""
