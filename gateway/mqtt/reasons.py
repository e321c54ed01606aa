"""Says in words why a broker cannot be reached or refuses, and what to change."""

from __future__ import annotations

# MQTT 5 reason codes (2.4); the five of MQTT 3.1.1 (3.2.2.3) come as their equals here.
REMEDIES = {
    0x80: "see the broker's log",
    0x82: 'if the broker knows no MQTT 5, set mqtt.version = "3.1.1"',
    0x84: 'set mqtt.version = "3.1.1", or "5" where it is that already',
    0x85: "set mqtt.client_id to a name that the broker accepts",
    0x86: "correct mqtt.user and mqtt.password",
    0x87: "correct mqtt.user and mqtt.password, or let this user publish under mqtt.base in the broker's rules",
    0x8A: "the broker bans this client: see its configuration",
    0x8E: "another client has the same client id: give each gateway a name or an mqtt.client_id of its own",
    0x93: "set mqtt.qos = 0, or let the broker take more messages at a time",
    0x95: "let the broker take larger packets",
    0x96: "raise mqtt.longest_silence or mqtt.deadband, or the broker's limit",
    0x97: "raise the broker's quota",
    0x9A: "the broker must support retained messages: status and availability need them",
    0x9B: "set mqtt.qos lower; a broker has to take QoS 1 at the least: events and history have it",
    0x9F: "raise mqtt.reconnect_after, or the broker's limit",
}

# What is otherwise with Sparkplug, which has no `qos` of its own to be set.
OF_SPARKPLUG = {
    REMEDIES[0x93]: "let the broker take more messages at a time",
    REMEDIES[0x9B]: "the broker has to take QoS 1: NDEATH, the will, has it",
}

HUNG_UP = "the other end hung up: is the port of mqtt.url right, with mqtts:// where it speaks TLS and only there?"

# What errors of sockets and TLS contain, and what it mostly means; the first that fits is taken.
HINTS = (
    ("CERTIFICATE_REQUIRED", "the broker wants a client certificate: set mqtt.tls.certificate and mqtt.tls.key"),
    ("HANDSHAKE_FAILURE", "the broker may want a client certificate: set mqtt.tls.certificate and mqtt.tls.key"),
    ("Hostname mismatch", "mqtt.url must name the broker as its certificate does"),
    ("IP address mismatch", "mqtt.url must name the broker as its certificate does"),
    ("certificate has expired", "renew the broker's certificate, or set the clock of this machine"),
    ("CERTIFICATE_VERIFY_FAILED", "mqtt.tls.ca must hold the authority that signed the broker's certificate"),
    ("UNKNOWN_CA", "the broker does not trust the authority that signed mqtt.tls.certificate"),
    ("WRONG_VERSION_NUMBER", "no TLS at this port: the one for mqtts:// is mostly 8883"),
    ("HTTP 401", "the web server in front of the broker wants somebody else: see its rules"),
    ("HTTP 403", "the web server in front of the broker does not let one in: see its rules"),
    ("HTTP 404", "the path in mqtt.url is not the broker's: it is mostly /mqtt"),
    ("WebSocket", "is the port of mqtt.url the broker's listener for WebSockets, with wss:// where it speaks TLS?"),
    ("speaks no HTTP", "no WebSocket at this port: mqtt:// and mqtts:// are without"),
    ("Connection reset", HUNG_UP),
    ("EOF occurred", HUNG_UP),
    ("_SSL", "see the broker's log on TLS"),
    ("[SSL", "see the broker's log on TLS"),
    ("Connection refused", "nothing listens there: is the broker running, and are host and port of mqtt.url right?"),
    ("Name or service not known", "the host name in mqtt.url is unknown"),
    ("name resolution", "the host name in mqtt.url cannot be looked up now"),
    ("No route to host", "see the network, and the host in mqtt.url"),
    ("timed out", "see the network, a firewall in between, and the host in mqtt.url"),
)
UNEXPLAINED = 'see the broker\'s log; if it knows no MQTT 5, set mqtt.version = "3.1.1"; mqtts:// may be wanted'


def _by_table(remedy: str, table: str) -> str:
    """Return a remedy with its keys as they stand in a table of the configuration: mqtt, or sparkplug."""
    if table != "mqtt":
        remedy = OF_SPARKPLUG.get(remedy, remedy)
        remedy = remedy.replace("mqtt.base", "its topics").replace("mqtt.longest_silence or ", "")
    return remedy.replace("mqtt.", f"{table}.")


def of_code(code: int, name: str, table: str = "mqtt") -> str:
    """Explain a reason code of the broker; `table` of the configuration is what to change."""
    return f"{name} (reason code {code:02X}H); {_by_table(REMEDIES.get(code, REMEDIES[0x80]), table)}"


def of_subscription(code: int, name: str, table: str = "mqtt") -> str:
    """Explain why the broker lets nobody send commands here."""
    remedy = _by_table("let this user subscribe below mqtt.base in the broker's rules", table)
    return f"{name} (reason code {code:02X}H); {remedy}"


def of_error(error: str, table: str = "mqtt") -> str:
    """Explain the error of a socket or of TLS."""
    hint = next((hint for needle, hint in HINTS if needle in error), None)
    return f"{error}; {_by_table(hint, table)}" if hint else error


def of_silence(error: str, table: str = "mqtt") -> str:
    """Explain why a broker closed the connection, or said nothing, instead of accepting it."""
    said = error or "the broker closed the connection before it answered"
    explained = of_error(said, table)
    return explained if explained != said else f"{said}; {_by_table(UNEXPLAINED, table)}"
