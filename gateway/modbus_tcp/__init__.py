"""The MODBUS-TCP side: the register map and the server that answers from the image."""
