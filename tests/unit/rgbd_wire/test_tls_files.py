"""Certificates that cannot work are told before anything connects."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509

from rgbd_wire.errors import TlsFilesError
from rgbd_wire.tls_files import WARN_BEFORE, tls_files
from tests.certificates import make_ending, make_ends

DAYS = 30


@pytest.fixture
def ends(tmp_path):
    """Folders of two drones and a worker under one authority."""
    return make_ends(tmp_path / "ends")


def test_files_that_fit_are_a_value_without_warnings(ends):
    """The paths, and the name that the other end will see."""
    files = tls_files(ends / "drone-1")
    assert files.common_name == "drone-1"
    assert files.warnings == ()
    assert {p.name for p in (files.ca, files.certificate, files.key)} == {
        "ca.pem",
        "cert.pem",
        "key.pem",
    }


def test_a_certificate_that_ends_soon_is_warned_of_and_one_that_ended_is_refused(ends):
    """A week before, and from the second after its last."""
    now = datetime.now(UTC)
    end = x509.load_pem_x509_certificate(
        (ends / "drone-1" / "cert.pem").read_bytes()
    ).not_valid_after_utc
    assert abs(end - now - timedelta(days=DAYS)) < timedelta(minutes=5)
    assert tls_files(ends / "drone-1", end - WARN_BEFORE).warnings == ()
    (warning,) = tls_files(ends / "drone-1", end - WARN_BEFORE + timedelta(seconds=1)).warnings
    assert "cert.pem expires on" in warning
    tls_files(ends / "drone-1", end)
    with pytest.raises(TlsFilesError, match=r"cert\.pem expired on"):
        tls_files(ends / "drone-1", end + timedelta(seconds=1))


def test_an_expired_certificate_is_refused_today(ends):
    """By this machine's own clock."""
    with pytest.raises(TlsFilesError, match="expired on"):
        tls_files(make_ending(ends, "drone-1", -timedelta(hours=1)))


def test_a_clock_that_is_far_behind_is_named(ends):
    """A companion computer without a battery for its clock starts in 1970."""
    with pytest.raises(TlsFilesError, match="set the clock"):
        tls_files(ends / "drone-1", datetime(1970, 1, 1, tzinfo=UTC))


@pytest.mark.parametrize("name", ["ca.pem", "cert.pem", "key.pem"])
@pytest.mark.parametrize("content", [None, b"", b"nonsense", b"x" * 100_000])
def test_a_file_that_is_missing_or_none_is_told(ends, name, content):
    """Which file it is, and what makes a good one."""
    path = ends / "drone-1" / name
    path.unlink()
    if content is not None:
        path.write_bytes(content)
        path.chmod(0o600)
    with pytest.raises(TlsFilesError) as error:
        tls_files(ends / "drone-1")
    assert str(path) in str(error.value)
    assert "scripts/certificates" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mode", [0o604, 0o602, 0o644, 0o620])
def test_a_key_that_others_may_read_or_write_is_refused(ends, mode):
    """The line says what to type."""
    key = ends / "drone-1" / "key.pem"
    key.chmod(mode)
    with pytest.raises(TlsFilesError, match=f"chmod 600 {key}"):
        tls_files(ends / "drone-1")


@pytest.mark.parametrize("mode", [0o600, 0o400, 0o440, 0o640])
def test_a_key_that_its_group_may_read_is_taken(ends, mode):
    """A cluster hands its secrets over by the group."""
    (ends / "drone-1" / "key.pem").chmod(mode)
    assert tls_files(ends / "drone-1").common_name == "drone-1"


def test_the_key_of_another_is_refused(ends):
    """It would fail in the middle of a handshake, without a word."""
    (ends / "drone-2" / "key.pem").replace(ends / "drone-1" / "key.pem")
    with pytest.raises(TlsFilesError, match="is not the key of"):
        tls_files(ends / "drone-1")


def test_the_certificate_of_another_authority_is_refused(ends, tmp_path):
    """The other end would not believe it."""
    foreign = make_ends(tmp_path / "foreign")
    (foreign / "drone-1" / "ca.pem").replace(ends / "drone-1" / "ca.pem")
    with pytest.raises(TlsFilesError, match="is not signed by the authority"):
        tls_files(ends / "drone-1")
