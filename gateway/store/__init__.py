"""What outlives the process: how often the EEPROM of each drive was written, and the audit of commands."""
