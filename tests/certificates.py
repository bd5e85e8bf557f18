"""Certificates for tests, made by the project's own script's module."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from deploy.certificates import Order, issue, load_authority, make, write


def make_ends(
    folder: Path,
    drones: tuple[str, ...] = ("drone-1", "drone-2"),
    workers: tuple[str, ...] = ("worker-a",),
) -> Path:
    """Folders of certificates and tunnel keys, one for each end; gives the folder back."""
    make(Order(folder, drones, workers, (), 30, with_tunnel_keys=True, overwrite=False), _now())
    return folder


def make_ending(folder: Path, name: str, ends_in: timedelta) -> Path:
    """A drone's folder, signed by the authority in ``folder``, that is valid until soon.

    Args:
        folder: where ``make_ends`` made the authority.
        name: the drone's.
        ends_in: from now; negative: it has ended.
    """
    authority = load_authority(folder / "authority", _now())
    end = issue(authority, name, _now() + ends_in - timedelta(days=1), 1)
    home = folder / f"{name}-ending"
    write(home, "ca.pem", authority.certificate_pem(), is_private=False)
    write(home, "cert.pem", end.certificate_pem(), is_private=False)
    write(home, "key.pem", end.key_pem(), is_private=True)
    return home


def _now() -> datetime:
    return datetime.now(UTC)
