"""What outlives the process: how often the EEPROM of each drive was written, and the audit of commands."""

from gateway.store.store import Store, needs_store, store_path

__all__ = ["Store", "needs_store", "store_path"]
