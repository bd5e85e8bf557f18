"""What scripts/certificates makes, refuses and prints."""

from __future__ import annotations

import shlex
import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from deploy.certificates import (
    CertificatesError,
    Order,
    load_authority,
    make,
    next_steps,
    remove,
    withheld,
)
from drone_client.settings import load_settings as load_drone_settings
from edge_service.settings import load_settings as load_edge_settings
from rgbd_wire.hosts import resolve
from rgbd_wire.tls_files import tls_files
from rgbd_wire.tunnel.endpoint import parse_endpoint
from rgbd_wire.tunnel.keys import load_keys
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


def names_in(folder, worker="worker-a"):
    """Drones that a worker's file lets in."""
    return list(load_keys(folder / worker / "tunnel.keys"))


def without(folder, drone, worker="worker-a"):
    """Take a drone's line out of a worker's file by hand, as one does in a hurry."""
    path = folder / worker / "tunnel.keys"
    kept = [line for line in path.read_text().splitlines(True) if not line.startswith(drone)]
    path.write_text("".join(kept))


def test_a_line_that_was_taken_out_never_comes_back_by_itself(tmp_path):
    """Not with a new drone, not with a new worker, and not in the command that is printed."""
    folder = make_ends(tmp_path / "ends")
    without(folder, "drone-1")
    assert withheld(folder) == {"drone-1": folder / "worker-a" / "tunnel.keys"}
    added = run(
        *(str(folder), "--drones", "drone-3", "--workers", "worker-b", "--tunnel-keys"),
    )
    assert added.returncode == 0, added.stderr
    assert names_in(folder) == names_in(folder, "worker-b") == ["drone-2", "drone-3"]
    assert "EDGE_ZENOH_DRONES=drone-2,drone-3 " in added.stdout
    assert added.stderr.startswith("warning: drone-1 has a key and no line in ")
    make(order(folder, with_tunnel_keys=True, workers=(), overwrite=True), datetime.now(UTC))
    assert set(names_in(folder)) == {"drone-1", "drone-2", "drone-3"}  # asked for, with a new key
    assert withheld(folder) == {}


def test_what_else_stands_in_a_workers_file_stays(tmp_path):
    """Comments, and the lines of drones whose folders are elsewhere."""
    folder = make_ends(tmp_path / "ends")
    path = folder / "worker-a" / "tunnel.keys"
    path.write_text(f"# the yard's\nguest {bytes(range(32)).hex()}\n{path.read_text()}")
    before = path.read_text()
    make(order(folder, drones=("drone-3",), workers=(), with_tunnel_keys=True), datetime.now(UTC))
    assert path.read_text() == before + (folder / "drone-3" / "tunnel.key").read_text()


def test_a_lost_drone_is_removed_for_good(tmp_path):
    """Its folder and its lines; the rest stays as it is, and the words say what is still open."""
    folder = make_ends(tmp_path / "ends", workers=("worker-a", "worker-b"))
    kept = {p: data for p, data in files(folder).items() if "drone-1" not in p.parts}
    end = certificate(folder, "drone-1").not_valid_after_utc
    done = run(str(folder), "--remove", "drone-1")
    assert (done.returncode, done.stderr) == (0, "")
    for words in (
        str(folder / "worker-a" / "tunnel.keys"),
        str(folder / "worker-b" / "tunnel.keys"),
        f"the certificate of drone-1 is valid until {end:%Y-%m-%d %H:%M} UTC",
        "\nEDGE_ZENOH_DRONES=drone-2\n",
    ):
        assert words in done.stdout
    left = files(folder)
    assert left.keys() == kept.keys()
    changed = {p for p in kept if left[p] != kept[p]}
    assert changed == {folder / w / "tunnel.keys" for w in ("worker-a", "worker-b")}
    assert {stat.S_IMODE(p.stat().st_mode) for p in changed} == {0o600}
    make(order(folder, drones=("drone-3",), workers=(), with_tunnel_keys=True), datetime.now(UTC))
    assert names_in(folder) == names_in(folder, "worker-b") == ["drone-2", "drone-3"]


@pytest.mark.parametrize("name", ["drone-9", "worker-a", "authority", "../ends/drone-1", "guest"])
def test_nothing_but_a_drone_is_removed(tmp_path, name):
    """The line names those that there are; with one that is none, nothing happens to the others."""
    folder = make_ends(tmp_path / "ends")
    with (folder / "worker-a" / "tunnel.keys").open("a") as keys:
        keys.write(f"authority {bytes(range(32)).hex()}\nworker-a {bytes(range(1, 33)).hex()}\n")
    before = files(folder)
    with pytest.raises(CertificatesError, match=r"is no drone in .*there are: drone-1, drone-2$"):
        remove(folder, ("drone-1", name), datetime.now(UTC))
    assert files(folder) == before


def test_what_is_left_of_a_drone_can_be_removed(tmp_path):
    """A line without a folder, or a folder without a line."""
    folder = make_ends(tmp_path / "ends")
    without(folder, "drone-1")
    for path in (folder / "drone-2").iterdir():
        path.unlink()
    (folder / "drone-2").rmdir()
    assert set(remove(folder, ("drone-1", "drone-2"), datetime.now(UTC))) == {"drone-1"}
    assert names_in(folder) == []
    assert {p.name for p in folder.iterdir()} == {"authority", "worker-a"}
    done = run(str(folder), "--remove", "x", "--drones", "y")
    assert done.returncode == 1
    assert done.stderr == "error: --remove makes nothing: run it again for the others\n"


@pytest.mark.parametrize("host", ["edge.example", "192.0.2.7", "2001:db8::1", "[2001:db8::1]"])
def test_the_printed_commands_are_words_that_both_programs_take(tmp_path, monkeypatch, host):
    """Also with a space in the folder, and with IPv6, whose brackets a shell has a use for."""
    folder = tmp_path / "my certificates (new)"
    what = order(folder, hosts=(host,), with_tunnel_keys=True)
    make(what, datetime.now(UTC))
    words = shlex.split(next_steps(what).replace("\\\n", ""), comments=True)
    given = dict(word.split("=", 1) for word in words if word[0].isupper() and "=" in word)
    over = [word.partition("=")[2] for word in words if word.startswith("DRONE_CONNECT=")]
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    worker = load_edge_settings(zenoh_listen=words[words.index("--listen") + 1])
    assert worker.zenoh_tls == folder / "worker-a"
    assert worker.tunnel_keys == folder / "worker-a" / "tunnel.keys"
    drone = load_drone_settings()
    assert (drone.tls, drone.key_file) == (folder / "drone-1", folder / "drone-1" / "tunnel.key")
    bare = host.strip("[]")
    assert [endpoint.partition("/")[0] for endpoint in over] == ["tls", "udp"]
    assert {parse_endpoint(f"udp/{e.partition('/')[2]}")[0] for e in over} == {bare}
    heard, _ = parse_endpoint(f"udp/{worker.udp_listen}")
    assert resolve(heard, 0)[0][0].name == ("AF_INET6" if ":" in bare else "AF_INET")
    assert all(heard in endpoint for endpoint in worker.listen_endpoints)


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
