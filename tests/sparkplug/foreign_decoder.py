"""Decodes and encodes by pysparkplug, a line of JSON for each line of JSON: run apart, with packages of its own."""

from __future__ import annotations

import json
import sys
from typing import Any

import pysparkplug
from google.protobuf.json_format import MessageToDict
from pysparkplug._protobuf import Payload

births: dict[str, Any] = {}


def decode(kind: str, payload: bytes, device: str) -> dict[str, Any]:
    """Return what pysparkplug makes of a message, by the last birth of its device, and what protobuf makes of it."""
    if kind in ("NBIRTH", "DBIRTH"):
        births[device] = getattr(pysparkplug, {"NBIRTH": "NBirth", "DBIRTH": "DBirth"}[kind]).decode(payload)
        read = births[device]
    elif kind == "NDEATH":  # of which pysparkplug keeps nothing but the number
        number = pysparkplug.NDeath.decode(payload).bd_seq_metric.value
        metric = pysparkplug.Metric.from_pb(Payload.FromString(payload).metrics[0])
        assert number == metric.value
        read = pysparkplug.NData(Payload.FromString(payload).timestamp, None, (metric,))
    elif kind == "DDEATH":
        read = pysparkplug.DDeath.decode(payload)
    else:
        read = {"NDATA": pysparkplug.NData, "DDATA": pysparkplug.DData}[kind].decode(payload, birth=births[device])
    metrics = [
        {"name": m.name, "alias": m.alias, "type": m.datatype.name, "value": m.value, "is_null": m.is_null,
         "timestamp": m.timestamp}
        for m in getattr(read, "metrics", ())
    ]  # fmt: skip
    raw = MessageToDict(Payload.FromString(payload), preserving_proto_field_name=True)
    seq = getattr(read, "seq", None)
    return {"timestamp": read.timestamp, "seq": seq, "metrics": metrics, "raw": raw}


def encode(kind: str, timestamp: int, metrics: list[dict[str, Any]]) -> str:
    """Return a command as pysparkplug writes it, in hexadecimal."""
    made = tuple(
        pysparkplug.Metric(timestamp, m.get("name"), pysparkplug.DataType[m["type"]], value=m["value"],
                           alias=m.get("alias"))
        for m in metrics
    )  # fmt: skip
    command = {"NCMD": pysparkplug.NCmd, "DCMD": pysparkplug.DCmd}[kind](timestamp, made)
    return str(command.encode(include_dtypes=True).hex())


for line in sys.stdin:
    asked = json.loads(line)
    if "hex" in asked:
        answer: Any = decode(asked["kind"], bytes.fromhex(asked["hex"]), asked.get("device", ""))
    else:
        answer = encode(asked["kind"], asked["timestamp"], asked["metrics"])
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()
