"""tosvert-gateway: TOSVERT drives on RS485 become MQTT topics and a MODBUS-TCP image."""

__version__ = "0.1.0"
