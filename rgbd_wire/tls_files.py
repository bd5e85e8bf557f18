"""Certificate, key and authority of one end of a TLS link, checked before anything connects.

A TLS handshake that fails says little and says it late; most of its reasons lie in three files.
"""

from __future__ import annotations

import stat
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID

from rgbd_wire.errors import TlsFilesError

CA_FILE = "ca.pem"
CERTIFICATE_FILE = "cert.pem"
KEY_FILE = "key.pem"
WARN_BEFORE = timedelta(days=7)
"""A certificate that ends sooner than this is worth a sentence at the start."""
_MAX_BYTES = 64 * 1024
_MAKE = "scripts/certificates makes all three"


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Three PEM files that fit together; ``tls_files`` makes one of a folder."""

    ca: Path
    """The authority whose certificates the other end may have."""
    certificate: Path
    key: Path
    common_name: str
    """Who the certificate says that we are."""
    warnings: tuple[str, ...] = ()
    """Sentences for the person who starts the program; empty when all is well."""


def tls_files(folder: Path, now: datetime | None = None) -> TlsFiles:
    """The files ``ca.pem``, ``cert.pem`` and ``key.pem`` of a folder.

    Args:
        folder: where they lie.
        now: calendar time, with its zone; None: this machine's.

    Raises:
        TlsFilesError: a file is missing, cannot be read or parsed, does not fit the others, has
            expired, or is a key that everybody may read; one line that says what to do.
    """
    now = now or datetime.now(UTC)
    ca_path, certificate_path, key_path = (
        folder / name for name in (CA_FILE, CERTIFICATE_FILE, KEY_FILE)
    )
    ca = _certificate(ca_path)
    certificate = _certificate(certificate_path)
    _check_private(key_path)
    _check_key(key_path, certificate_path, certificate)
    try:
        certificate.verify_directly_issued_by(ca)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        raise TlsFilesError(
            f"{certificate_path} is not signed by the authority in {ca_path}; "
            "take both from the same run of scripts/certificates"
        ) from None
    warnings = [
        warning
        for path, it in ((ca_path, ca), (certificate_path, certificate))
        for warning in _check_dates(path, it, now)
    ]
    return TlsFiles(
        ca_path, certificate_path, key_path, _name(certificate_path, certificate), tuple(warnings)
    )


def _certificate(path: Path) -> x509.Certificate:
    data = _read(path)
    try:
        return x509.load_pem_x509_certificate(data)
    except ValueError:
        raise TlsFilesError(f"{path} is not a PEM certificate; {_MAKE}") from None


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise TlsFilesError(f"cannot read {path}: {error.strerror}; {_MAKE}") from None
    if len(data) > _MAX_BYTES:
        raise TlsFilesError(f"{path} has more than {_MAX_BYTES} bytes; {_MAKE}")
    return data


def _check_private(path: Path) -> None:
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise TlsFilesError(f"cannot read {path}: {error.strerror}; {_MAKE}") from None
    # The group may read it: that is how a cluster hands a secret to a process that is not root
    if mode & (stat.S_IROTH | stat.S_IWOTH | stat.S_IWGRP):
        raise TlsFilesError(
            f"{path} is open to others (mode {stat.S_IMODE(mode):04o}); chmod 600 {path}"
        )


def _check_key(path: Path, certificate_path: Path, certificate: x509.Certificate) -> None:
    try:
        key = serialization.load_pem_private_key(_read(path), password=None)
        is_of_it = key.public_key() == certificate.public_key()
    except (ValueError, TypeError):
        raise TlsFilesError(f"{path} is not an unencrypted PEM private key; {_MAKE}") from None
    except UnsupportedAlgorithm:
        raise TlsFilesError(f"{path} is a key of a kind that nobody here knows; {_MAKE}") from None
    if not is_of_it:
        raise TlsFilesError(f"{path} is not the key of {certificate_path}; {_MAKE}")


def _check_dates(path: Path, it: x509.Certificate, now: datetime) -> list[str]:
    if now > it.not_valid_after_utc:
        raise TlsFilesError(f"{path} expired on {_day(it.not_valid_after_utc)}; {_MAKE} anew")
    if now < it.not_valid_before_utc:
        raise TlsFilesError(
            f"{path} is not valid before {_day(it.not_valid_before_utc)} and this machine's clock "
            f"says {_day(now)}; set the clock"
        )
    if it.not_valid_after_utc - now < WARN_BEFORE:
        return [f"{path} expires on {_day(it.not_valid_after_utc)}; {_MAKE} anew"]
    return []


def _name(path: Path, certificate: x509.Certificate) -> str:
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if len(names) != 1:
        raise TlsFilesError(f"{path} has {len(names)} common names instead of one; {_MAKE}")
    return str(names[0].value)


def _day(when: datetime) -> str:
    return when.astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")
