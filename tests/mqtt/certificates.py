"""A certificate authority for tests, by the openssl program."""

from __future__ import annotations

import subprocess
from pathlib import Path

KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


class Authority:
    """Signs certificates; `certificate` is what to trust."""

    def __init__(self, folder: Path, name: str = "ca") -> None:
        self._folder = folder
        self.certificate = folder / f"{name}.pem"
        self._key = folder / f"{name}.key"
        self._serial = 0
        subject = ("-subj", f"/CN={name}")
        _openssl("req", "-x509", *KEY, "-days", "2", *subject, "-keyout", self._key, "-out", self.certificate)

    def issue(self, name: str, alternative: str = "") -> tuple[Path, Path]:
        """Return a certificate and its key; `alternative` names a server: "IP:127.0.0.1"."""
        certificate, key, request = (self._folder / f"{name}.{ending}" for ending in ("pem", "key", "csr"))
        extensions = self._folder / f"{name}.ext"
        extensions.write_text(f"subjectAltName={alternative}\n" if alternative else "", encoding="utf-8")
        self._serial += 1
        _openssl("req", "-new", *KEY, "-subj", f"/CN={name}", "-keyout", key, "-out", request)
        _openssl(
            *("x509", "-req", "-in", request, "-days", "2", "-set_serial", str(self._serial)),
            *("-CA", self.certificate, "-CAkey", self._key, "-extfile", extensions, "-out", certificate),
        )
        return certificate, key


def _openssl(*arguments: object) -> None:
    subprocess.run(["openssl", *map(str, arguments)], check=True, capture_output=True)
