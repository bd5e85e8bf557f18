"""Certificates and tunnel keys for drones and workers: what ``scripts/certificates`` runs.

One folder for each end, so that each machine gets its own and no other::

    FOLDER/authority/      ca.pem, key.pem    stays here: whoever has it can make drones
    FOLDER/drone-1/        ca.pem, cert.pem, key.pem, and with --tunnel-keys tunnel.key
    FOLDER/worker-a/       the same, and with --tunnel-keys tunnel.keys, of all drones
"""

from __future__ import annotations

import ipaddress
import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rgbd_wire.tunnel.keys import generate_key

AUTHORITY = "authority"
AUTHORITY_DAYS = 3650
TUNNEL_KEY = "tunnel.key"
TUNNEL_KEYS = "tunnel.keys"
NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
RESERVED = {AUTHORITY, "workers"}
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")
CLOCK_SLACK = timedelta(minutes=5)
"""Valid from so long ago: a drone's clock may be a little behind."""


class CertificatesError(Exception):
    """Something stands in the way; one line that says what to do."""


@dataclass(frozen=True, slots=True)
class Credential:
    """A certificate and its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    def certificate_pem(self) -> bytes:
        """As it is written to a file."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    def key_pem(self) -> bytes:
        """As it is written to a file: not encrypted, since no person stands beside a drone."""
        return self.key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )


def make_authority(now: datetime, days: int = AUTHORITY_DAYS) -> Credential:
    """An authority that signs certificates of ends, and no other authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _named("aerial-contact authority")
    certificate = (
        _begun(name, name, key.public_key(), now, days)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    return Credential(certificate, key)


def issue(
    authority: Credential,
    name: str,
    now: datetime,
    days: int,
    hosts: Iterable[str] = (),
    *,
    is_worker: bool = False,
) -> Credential:
    """A certificate of one end.

    Args:
        authority: who signs.
        name: the common name: what the other end goes by.
        now: calendar time, with its zone.
        days: how long it is valid.
        hosts: names and addresses under which a worker is reached.
        is_worker: it may be connected to; a drone's certificate never passes for a worker's.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if is_worker:
        uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
    issuer = authority.certificate
    builder = (
        _begun(_named(name), issuer.subject, key.public_key(), now, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()),
            critical=False,
        )
    )
    hosts = list(dict.fromkeys(hosts))
    if hosts:
        builder = builder.add_extension(
            x509.SubjectAlternativeName([_host(h) for h in hosts]), critical=False
        )
    return Credential(builder.sign(authority.key, hashes.SHA256()), key)


def _begun(
    subject: x509.Name,
    issuer: x509.Name,
    public_key: ec.EllipticCurvePublicKey,
    now: datetime,
    days: int,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SLACK)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
    )


def _named(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        pass
    if not re.fullmatch(r"(\*\.)?[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*", host):
        raise CertificatesError(f"{host!r} is neither a host name nor an address")
    return x509.DNSName(host)


def load_authority(folder: Path, now: datetime) -> Credential:
    """The authority that an earlier run left.

    Raises:
        CertificatesError: it cannot be used any more.
    """
    try:
        certificate = x509.load_pem_x509_certificate((folder / "ca.pem").read_bytes())
        key = serialization.load_pem_private_key((folder / "key.pem").read_bytes(), password=None)
    except (OSError, ValueError) as error:
        raise CertificatesError(
            f"cannot read the authority in {folder}: {error}; remove it, and make all anew"
        ) from None
    if (
        not isinstance(key, ec.EllipticCurvePrivateKey)
        or key.public_key() != certificate.public_key()
    ):
        raise CertificatesError(f"key and certificate in {folder} do not fit; make all anew")
    if now > certificate.not_valid_after_utc:
        raise CertificatesError(f"the authority in {folder} has expired; make all anew")
    return Credential(certificate, key)


def write(folder: Path, name: str, data: bytes, *, is_private: bool) -> None:
    """Write a file whole or not at all; a private one is never open to others, not for a moment."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    unfinished = folder / f".{name}.new"
    unfinished.unlink(missing_ok=True)
    mode = 0o600 if is_private else 0o644
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with open(descriptor, "wb") as file:
        file.write(data)
    unfinished.replace(folder / name)


def read_tunnel_keys(folder: Path) -> dict[str, str]:
    """Lines of the drones that have a key already, by name, from their own folders."""
    paths = sorted(folder.glob(f"*/{TUNNEL_KEY}"))
    lines = (line for path in paths for line in _lines(path))
    return {name: line for line in lines if (name := _named_in(line))}


def withheld(folder: Path) -> dict[str, Path]:
    """Drones with a key that a worker's file does not hold, and that file.

    Somebody took the line out, and a thief may have the key: no later run puts it back.
    """
    files = sorted(folder.glob(f"*/{TUNNEL_KEYS}"))
    return {
        name: path
        for name, line in read_tunnel_keys(folder).items()
        for path in files
        if _words(line) not in map(_words, _lines(path))
    }


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").splitlines()
    except UnicodeDecodeError:
        raise CertificatesError(f"{path} is not ASCII text") from None


def _words(line: str) -> list[str]:
    """Name and key of a line, without its comment."""
    return line.partition("#")[0].split()


def _named_in(line: str) -> str:
    return next(iter(_words(line)), "")


@dataclass(frozen=True, slots=True)
class Order:
    """What to make."""

    folder: Path
    drones: tuple[str, ...]
    workers: tuple[str, ...]
    hosts: tuple[str, ...]
    days: int
    with_tunnel_keys: bool
    overwrite: bool


def check(order: Order) -> None:
    """Refuse what cannot be made, before anything is written.

    Raises:
        CertificatesError: says what to change.
    """
    names = order.drones + order.workers
    if not names:
        raise CertificatesError("nothing to make: name some with --drones and --workers")
    for name in names:
        if not NAME.fullmatch(name) or name in RESERVED:
            raise CertificatesError(
                f"{name!r} cannot be a name: up to 32 of a-z 0-9 - _, and none of "
                + ", ".join(sorted(RESERVED))
            )
        if names.count(name) > 1:
            raise CertificatesError(f"{name!r} is named twice; each end needs a name of its own")
    for host in order.hosts:
        _host(host)
    there = [name for name in names if (order.folder / name).exists()]
    if there and not order.overwrite:
        raise CertificatesError(
            f"there already: {', '.join(str(order.folder / n) for n in there)}; "
            "leave them out, or make them anew with --overwrite"
        )


def remove(folder: Path, drones: Sequence[str], now: datetime) -> dict[str, datetime]:
    """Take drones' lines out of the workers' files, and their folders away.

    Returns:
        Until when the certificate of each is valid, of those that have not expired.

    Raises:
        CertificatesError: one of them is no drone here; nothing was changed.
    """
    certificates = _drones_by_certificate(folder)
    files = sorted(folder.glob(f"*/{TUNNEL_KEYS}"))
    listed = {_named_in(line) for path in files for line in _lines(path)}
    known = (listed | read_tunnel_keys(folder).keys() | certificates.keys()) - {""}
    # A folder that is no drone's stays, whatever stands in a list
    known -= {p.parent.name for p in folder.glob("*/cert.pem")} - certificates.keys() | RESERVED
    for name in drones:
        if name not in known or not NAME.fullmatch(name):
            raise CertificatesError(
                f"{name!r} is no drone in {folder}; there are: {', '.join(sorted(known)) or 'none'}"
            )
    for path in files:  # first, for without a line a key stays out
        lines = _lines(path)
        kept = [line for line in lines if _named_in(line) not in drones]
        if kept != lines:
            _write_lines(path.parent, kept)
    for name in drones:
        if (folder / name).exists():
            shutil.rmtree(folder / name)
    ends = {n: certificates[n].not_valid_after_utc for n in drones if n in certificates}
    return {name: end for name, end in ends.items() if end > now}


def make(order: Order, now: datetime) -> None:
    """Write all that is ordered; the authority of an earlier run signs again.

    Raises:
        CertificatesError: nothing was written, or the authority cannot be used.
    """
    check(order)
    out = withheld(order.folder).keys() - (order.drones if order.with_tunnel_keys else ())
    home = order.folder / AUTHORITY
    if home.exists():
        authority = load_authority(home, now)
    else:
        authority = make_authority(now)
        write(home, "key.pem", authority.key_pem(), is_private=True)
        write(home, "ca.pem", authority.certificate_pem(), is_private=False)
    for name in order.drones + order.workers:
        is_worker = name in order.workers
        hosts = (name, *LOCAL_HOSTS, *order.hosts) if is_worker else ()
        end = issue(authority, name, now, order.days, hosts, is_worker=is_worker)
        folder = order.folder / name
        write(folder, "ca.pem", authority.certificate_pem(), is_private=False)
        write(folder, "cert.pem", end.certificate_pem(), is_private=False)
        write(folder, "key.pem", end.key_pem(), is_private=True)
    if order.with_tunnel_keys:
        for name in order.drones:
            line = f"{name} {generate_key()}\n"
            write(order.folder / name, TUNNEL_KEY, line.encode(), is_private=True)
    _give_tunnel_keys(order, out)


def _give_tunnel_keys(order: Order, out: Set[str]) -> None:
    """A new drone's key to all workers, a new worker all keys but those that were taken away."""
    keys = read_tunnel_keys(order.folder)
    new = [keys[name] for name in sorted(order.drones) if order.with_tunnel_keys]
    known = {path.parent.name for path in order.folder.glob(f"*/{TUNNEL_KEYS}")}
    for name in sorted(known):
        # What else stands in the file is the operator's, and so is what does not
        lines = _lines(order.folder / name / TUNNEL_KEYS)
        kept = [line for line in lines if not new or _named_in(line) not in order.drones]
        if kept + new != lines:
            _write_lines(order.folder / name, kept + new)
    lines = [keys[name] for name in sorted(keys.keys() - out)]
    for name in sorted(set(order.workers) - known):
        if lines:
            _write_lines(order.folder / name, lines)


def _write_lines(folder: Path, lines: Iterable[str]) -> None:
    text = "".join(f"{line}\n" for line in lines)
    write(folder, TUNNEL_KEYS, text.encode(), is_private=True)


def known_drones(folder: Path) -> list[str]:
    """Names of all drones that have a certificate here and whose key nobody took away."""
    return sorted(_drones_by_certificate(folder).keys() - withheld(folder).keys())


def _drones_by_certificate(folder: Path) -> dict[str, x509.Certificate]:
    drones = {}
    for path in sorted(folder.glob("*/cert.pem")):
        try:
            certificate = x509.load_pem_x509_certificate(path.read_bytes())
            uses = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        except (ValueError, OSError, x509.ExtensionNotFound):
            continue  # somebody else's
        if ExtendedKeyUsageOID.SERVER_AUTH not in uses:
            drones[path.parent.name] = certificate
    return drones


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def next_steps(order: Order) -> str:
    """What to type now, at both ends."""
    folder = order.folder
    worker = order.workers[0] if order.workers else "WORKER"
    drone = order.drones[0] if order.drones else "DRONE"
    drones = ",".join(known_drones(folder)) or drone
    host = next(iter(order.hosts), "localhost").strip("[]")
    anywhere = "0.0.0.0"
    if ":" in host:
        host, anywhere = f"[{host}]", "[::]"  # which takes IPv4 as well
    at_worker, at_drone = folder / worker, folder / drone
    lines = [
        f"# worker {worker}: copy {_quoted(at_worker)} there, and nothing else; a new drone is let",
        "# in over Zenoh when the worker starts again, over the tunnel within a second",
        f"EDGE_ZENOH_TLS={_quoted(at_worker)} EDGE_ZENOH_DRONES={drones} \\",
    ]
    if order.with_tunnel_keys:
        lines += [
            f"EDGE_UDP_LISTEN={_quoted(f'{anywhere}:7448')} "
            f"EDGE_TUNNEL_KEYS={_quoted(at_worker / TUNNEL_KEYS)} \\",
        ]
    lines += [
        f"  edge-service serve --name {worker} --listen {_quoted(f'tls/{anywhere}:7447')}",
        f"# drone {drone}: the same with {_quoted(at_drone)}",
        f"DRONE_NAME={drone} DRONE_TLS={_quoted(at_drone)} "
        f"DRONE_CONNECT={_quoted(f'tls/{host}:7447')} \\",
        "  drone-client replay RECORDING",
    ]
    if order.with_tunnel_keys:
        lines += [
            "# or over the UDP tunnel, which is made for a radio:",
            f"DRONE_NAME={drone} DRONE_KEY_FILE={_quoted(at_drone / TUNNEL_KEY)} \\",
            f"  DRONE_CONNECT={_quoted(f'udp/{host}:7448')} drone-client replay RECORDING",
        ]
    return "\n".join(lines)


def steps_after_removal(folder: Path, drones: Sequence[str], valid: dict[str, datetime]) -> str:
    """What is to be done now, since nothing but files in the folder has changed."""
    lines = [f"# removed: {', '.join(drones)}"]
    if files := sorted(folder.glob(f"*/{TUNNEL_KEYS}")):
        lines += [
            "# over the tunnel: bring each worker its file, or the cluster its secret; a second",
            "# after it has come, the drone is out",
            *(f"#   {_quoted(path)}" for path in files),
        ]
    for name, end in valid.items():
        lines += [
            f"# over Zenoh: the certificate of {name} is valid until {end:%Y-%m-%d %H:%M} UTC:",
            "# give the name to no other drone before, and start the workers again without it",
        ]
    return "\n".join([*lines, f"EDGE_ZENOH_DRONES={','.join(known_drones(folder))}"])


def _quoted(word: object) -> str:
    return shlex.quote(str(word))


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command(
    no_args_is_help=True,
    epilog="Example: scripts/certificates certs --drones drone-1,drone-2 --workers worker-a "
    "--hosts edge.example,192.0.2.7 --tunnel-keys",
)
def certificates(
    folder: Annotated[Path, typer.Argument(help="where one folder for each end is made")],
    drones: Annotated[
        str, typer.Option(help="names, comma separated; a drone's certificate is its name")
    ] = "",
    workers: Annotated[str, typer.Option(help="names, comma separated")] = "",
    hosts: Annotated[
        str,
        typer.Option(
            help="names and addresses under which drones reach the workers, comma separated; "
            "a worker's own name and localhost are always among them"
        ),
    ] = "",
    days: Annotated[
        int, typer.Option(min=1, max=AUTHORITY_DAYS, help="how long a certificate is valid")
    ] = 30,
    tunnel_keys: Annotated[
        bool, typer.Option("--tunnel-keys", help="keys for the UDP tunnel, too")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="make ends anew that are there already")
    ] = False,
    removed: Annotated[
        str,
        typer.Option(
            "--remove",
            help="names of lost drones, comma separated: their folders and their lines in the "
            "workers' tunnel.keys go for good; it says what else is to be done",
        ),
    ] = "",
) -> None:
    """Make an authority, certificates and keys for drones and workers.

    Run it again to add an end: the authority in FOLDER signs again, and what others have stays
    valid. Keep FOLDER/authority on this machine; give each end its own folder alone.
    """
    order = Order(
        folder, _split(drones), _split(workers), _split(hosts), days, tunnel_keys, overwrite
    )
    lost = _split(removed)
    try:
        if lost:
            if order.drones or order.workers:
                raise CertificatesError("--remove makes nothing: run it again for the others")
            typer.echo(steps_after_removal(folder, lost, remove(folder, lost, datetime.now(UTC))))
        else:
            make(order, datetime.now(UTC))
            typer.echo(next_steps(order))
    except CertificatesError as error:
        sys.exit(f"error: {error}")
    except OSError as error:
        sys.exit(f"error: {error.filename or folder}: {error.strerror}; give a FOLDER to write to")
    for name, path in withheld(folder).items():
        typer.echo(
            f"warning: {name} has a key and no line in {path}, and is kept out: --remove {name} "
            f"forgets it, --drones {name} --tunnel-keys --overwrite lets it in with a new key",
            err=True,
        )


if __name__ == "__main__":
    app()
