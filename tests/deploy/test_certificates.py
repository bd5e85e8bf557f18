"""What scripts/certificates makes, refuses and prints."""

from __future__ import annotations

import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from deploy.certificates import CertificatesError, Order, load_authority, make
from rgbd_wire.tls_files import tls_files
from tests.certificates import make_ends
from tests.deploy.manifests import ROOT

NOW = datetime(2026, 5, 1, tzinfo=UTC)


def order(folder, **fields):
    """An order of one drone and one worker."""
    some = {
        "drones": ("drone-1",),
        "workers": ("worker-a",),
        "hosts": ("edge.example", "192.0.2.7", "[2001:db8::1]"),
        "days": 30,
        "with_tunnel_keys": False,
        "overwrite": False,
    }
    return Order(folder, **(some | fields))


def certificate(folder, name):
    """The certificate of one end."""
    return x509.load_pem_x509_certificate((folder / name / "cert.pem").read_bytes())


def files(folder):
    """Every file with its content."""
    return {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def run(*arguments):
    """The script's module as a process."""
    return subprocess.run(
        [sys.executable, ROOT / "deploy/certificates.py", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_worker_may_be_connected_to_at_its_hosts_and_a_drone_may_not(tmp_path):
    """Key usage, hosts and dates are what TLS asks for."""
    make(order(tmp_path), NOW)
    worker, drone = certificate(tmp_path, "worker-a"), certificate(tmp_path, "drone-1")
    hosts = worker.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert hosts.get_values_for_type(x509.DNSName) == ["worker-a", "localhost", "edge.example"]
    addresses = [str(a) for a in hosts.get_values_for_type(x509.IPAddress)]
    assert addresses == ["127.0.0.1", "::1", "192.0.2.7", "2001:db8::1"]
    uses = {
        name: set(it.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        for name, it in (("worker", worker), ("drone", drone))
    }
    assert ExtendedKeyUsageOID.SERVER_AUTH in uses["worker"]
    assert uses["drone"] == {ExtendedKeyUsageOID.CLIENT_AUTH}
    for it in (worker, drone):
        assert it.not_valid_after_utc == NOW + timedelta(days=30)
        assert not it.extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_every_private_file_is_its_owners_alone(tmp_path):
    """Keys of TLS and of the tunnel; what is public may be read."""
    make_ends(tmp_path / "ends")
    for path in files(tmp_path):
        mode = stat.S_IMODE(path.stat().st_mode)
        public = path.name in ("ca.pem", "cert.pem")
        assert mode == (0o644 if public else 0o600), path


def test_the_tunnel_keys_of_all_drones_go_to_all_workers(tmp_path):
    """One line for each: a name and 32 random bytes in hex."""
    make_ends(tmp_path / "ends", workers=("worker-a", "worker-b"))
    lines = [(tmp_path / "ends" / d / "tunnel.key").read_text() for d in ("drone-1", "drone-2")]
    for worker in ("worker-a", "worker-b"):
        assert (tmp_path / "ends" / worker / "tunnel.keys").read_text() == "".join(lines)
    names, keys = zip(*(line.split() for line in lines), strict=True)
    assert names == ("drone-1", "drone-2")
    assert len({bytes.fromhex(k) for k in keys}) == 2
    assert {len(bytes.fromhex(k)) for k in keys} == {32}


def test_a_drone_that_comes_later_is_known_to_all_and_nothing_else_changes(tmp_path):
    """The same authority signs; the workers get one key more."""
    folder = make_ends(tmp_path / "ends")
    before = files(folder)
    make(order(folder, drones=("drone-3",), workers=(), with_tunnel_keys=True), datetime.now(UTC))
    after = files(folder)
    changed = {p for p in before if after[p] != before[p]}
    assert changed == {folder / "worker-a" / "tunnel.keys"}
    keys = (folder / "worker-a" / "tunnel.keys").read_text()
    assert [line.split()[0] for line in keys.splitlines()] == ["drone-1", "drone-2", "drone-3"]
    assert tls_files(folder / "drone-3").common_name == "drone-3"


def test_nothing_is_overwritten_unless_asked(tmp_path):
    """The line names what is there; asked, the named ends are made anew and no other."""
    folder = make_ends(tmp_path / "ends")
    before = files(folder)
    with pytest.raises(CertificatesError, match="drone-1.*--overwrite"):
        make(order(folder, drones=("drone-1", "drone-9"), workers=()), datetime.now(UTC))
    assert files(folder) == before
    make(order(folder, workers=(), overwrite=True), datetime.now(UTC))
    changed = {p.relative_to(folder) for p, data in files(folder).items() if data != before[p]}
    assert {str(p) for p in changed} == {"drone-1/cert.pem", "drone-1/key.pem"}


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"drones": (), "workers": ()}, "nothing to make"),
        ({"drones": ("Drone",)}, "cannot be a name"),
        ({"drones": ("../up",)}, "cannot be a name"),
        ({"drones": ("authority",)}, "cannot be a name"),
        ({"drones": ("workers",)}, "cannot be a name"),
        ({"drones": ("a", "b"), "workers": ("b",)}, "named twice"),
        ({"hosts": ("no host",)}, "neither a host name nor an address"),
    ],
)
def test_what_cannot_be_made_is_told_before_anything_is_written(tmp_path, fields, says):
    """One line that says what to change, and an untouched folder."""
    with pytest.raises(CertificatesError, match=says):
        make(order(tmp_path / "ends", **fields), NOW)
    assert not (tmp_path / "ends").exists()


def test_an_authority_that_cannot_sign_any_more_is_told(tmp_path):
    """Expired, or not what it was."""
    folder = make_ends(tmp_path / "ends") / "authority"
    load_authority(folder, datetime.now(UTC))
    with pytest.raises(CertificatesError, match="has expired"):
        load_authority(folder, datetime.now(UTC) + timedelta(days=4000))
    (folder / "key.pem").write_bytes((tmp_path / "ends/drone-1/key.pem").read_bytes())
    with pytest.raises(CertificatesError, match="do not fit"):
        load_authority(folder, datetime.now(UTC))
    (folder / "key.pem").write_bytes(b"")
    with pytest.raises(CertificatesError, match="make all anew"):
        load_authority(folder, datetime.now(UTC))


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    """The path, what is wrong with it, and what to give."""
    (tmp_path / "file").touch()
    done = run(str(tmp_path / "file/certs"), "--drones", "d1")
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {tmp_path / 'file/certs'}")
    assert "Not a directory; give a FOLDER" in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_command_says_what_to_do_next_and_help_teaches(tmp_path):
    """Both ends' commands, with the folders just made; errors are one line."""
    made = run(str(tmp_path / "c"), "--drones", "d1", "--workers", "w1", "--tunnel-keys")
    assert made.returncode == 0, made.stderr
    for words in ("EDGE_ZENOH_TLS", "EDGE_ZENOH_DRONES=d1", "DRONE_TLS", "DRONE_KEY_FILE"):
        assert words in made.stdout
    more = run(str(tmp_path / "c"), "--drones", "d2")
    assert "EDGE_ZENOH_DRONES=d1,d2" in more.stdout
    again = run(str(tmp_path / "c"), "--drones", "d1")
    assert again.returncode == 1
    assert again.stderr.startswith("error: there already")
    assert again.stderr.count("\n") == 1
    assert "Example" in run("--help").stdout
