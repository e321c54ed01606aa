"""What outlives the process: counts of EEPROM writes and the audit of commands; what brokers missed."""

from gateway.store.store import Store, needs_store, store_path

__all__ = ["Store", "needs_store", "store_path"]
