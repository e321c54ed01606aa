"""Certificates for tests, right and wrong ones: written by DER here, signed by the openssl program."""

from __future__ import annotations

import ssl
import subprocess
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from itertools import count
from pathlib import Path

ROLE = "1.3.6.1.4.1.50316.802.1"
UTF8, PRINTABLE, IA5, BMP = 0x0C, 0x13, 0x16, 0x1E
CLIENT_AUTH, SERVER_AUTH = "1.3.6.1.5.5.7.3.2", "1.3.6.1.5.5.7.3.1"
ECDSA_SHA256 = "1.2.840.10045.4.3.2"
DAY = 86_400.0  # seconds
SERIALS = count(0x10000000)


def tlv(tag: int, *contents: bytes) -> bytes:
    """Write an element."""
    content = b"".join(contents)
    size = len(content)
    if size < 0x80:
        return bytes((tag, size)) + content
    digits = size.to_bytes((size.bit_length() + 7) // 8, "big")
    return bytes((tag, 0x80 | len(digits))) + digits + content


def sequence(*contents: bytes) -> bytes:
    """Write a SEQUENCE."""
    return tlv(0x30, *contents)


def oid(dotted: str) -> bytes:
    """Write an OBJECT IDENTIFIER."""
    first, second, *rest = map(int, dotted.split("."))
    content = bytearray((40 * first + second,))
    for arc in rest:
        digits = [arc & 0x7F]
        while arc := arc >> 7:
            digits.insert(0, arc & 0x7F | 0x80)
        content += bytes(digits)
    return tlv(0x06, bytes(content))


def name(common: str) -> bytes:
    """Write a Name of one CN."""
    return sequence(tlv(0x31, sequence(oid("2.5.4.3"), tlv(UTF8, common.encode()))))


def moment(seconds: float) -> bytes:
    """Write a GeneralizedTime or, before 2050, a UTCTime."""
    when = datetime.fromtimestamp(seconds, UTC)
    if when.year >= 2050:
        return tlv(0x18, when.strftime("%Y%m%d%H%M%SZ").encode())
    return tlv(0x17, when.strftime("%y%m%d%H%M%SZ").encode())


def extension(kind: str, value: bytes, *, is_critical: bool = False) -> bytes:
    """Write an extension."""
    return sequence(oid(kind), *([b"\x01\x01\xff"] if is_critical else []), tlv(0x04, value))


def role(text: str, tag: int = UTF8) -> bytes:
    """Write the extension of MODBUS/TCP Security."""
    return extension(ROLE, tlv(tag, text.encode("utf-16-be" if tag == BMP else "utf-8")))


def usage(*purposes: str) -> bytes:
    """Write an extended key usage."""
    return extension("2.5.29.37", sequence(*map(oid, purposes)))


def address(octets: bytes = b"\x7f\0\0\1") -> bytes:
    """Write a subject alternative name of one IP address."""
    return extension("2.5.29.17", sequence(tlv(0x87, octets)))


AUTHORITY = (  # basic constraints, and a key usage of signing certificates and lists
    extension("2.5.29.19", sequence(b"\x01\x01\xff"), is_critical=True),
    extension("2.5.29.15", tlv(0x03, b"\x01\x06"), is_critical=True),
)


@dataclass(frozen=True, slots=True)
class Key:
    """A private key in a file, and its public half."""

    path: Path
    public: bytes

    @property
    def number(self) -> bytes:
        """Return what identifies it."""
        return sha256(self.public).digest()[:20]

    @classmethod
    def make(cls, path: Path) -> Key:
        """Make a key of P-256."""
        openssl("genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256", "-out", path)
        return cls(path, openssl("pkey", "-in", path, "-pubout", "-outform", "DER"))

    def sign(self, data: bytes) -> bytes:
        """Sign by ECDSA with SHA-256."""
        return openssl("dgst", "-sha256", "-sign", self.path, told=data)


def signed(
    subject: str, key: Key, issuer: str, by: Key, *extensions: bytes, begins: float = -1.0, ends: float = 2.0
) -> bytes:
    """Write a certificate; `begins` and `ends` are days from now."""
    now = time.time()
    algorithm = sequence(oid(ECDSA_SHA256))
    serial = tlv(0x02, next(SERIALS).to_bytes(4, "big"))
    validity = sequence(moment(now + begins * DAY), moment(now + ends * DAY))
    named = [extension("2.5.29.14", tlv(0x04, key.number)), extension("2.5.29.35", sequence(tlv(0x80, by.number)))]
    behind = [tlv(0xA3, sequence(*extensions, *named))]
    version = tlv(0xA0, b"\x02\x01\x02")
    told = sequence(version, serial, algorithm, name(issuer), validity, name(subject), key.public, *behind)
    return sequence(told, algorithm, tlv(0x03, b"\0", by.sign(told)))


def write_pem(path: Path, *certificates: bytes) -> Path:
    """Write certificates to a file."""
    path.write_text("".join(map(ssl.DER_cert_to_PEM_cert, certificates)), encoding="ascii")
    return path


class Authority:
    """Signs certificates; `path` is what to trust."""

    def __init__(self, folder: Path, name: str = "ca", parent: Authority | None = None, **validity: float) -> None:
        self.name = name
        self._folder = folder
        self.key = Key.make(folder / f"{name}.key")
        signer = parent or self
        self.der = signed(name, self.key, signer.name, signer.key, *AUTHORITY, **validity)
        self.path = write_pem(folder / f"{name}.pem", self.der)

    def issue(
        self, subject: str, key: Key, *extensions: bytes, above: tuple[bytes, ...] = (), **validity: float
    ) -> Path:
        """Return a certificate, with those `above` it behind it."""
        der = signed(subject, key, self.name, self.key, *extensions, **validity)
        return write_pem(self._folder / f"{subject}.pem", der, *above)


def openssl(*arguments: object, told: bytes = b"") -> bytes:
    """Run openssl and return what it prints."""
    return subprocess.run(["openssl", *map(str, arguments)], input=told, check=True, capture_output=True).stdout
