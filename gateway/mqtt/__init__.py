"""The MQTT side: topics, payloads and the bridge to the broker."""
