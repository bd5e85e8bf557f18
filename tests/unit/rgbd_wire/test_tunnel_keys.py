"""The key file: parsing, reading, reading again."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rgbd_wire.tunnel.errors import KeyFileError
from rgbd_wire.tunnel.keys import (
    CHECK_EVERY_NS,
    MAX_FILE_BYTES,
    KeyFile,
    generate_key,
    load_key,
    load_keys,
    parse_keys,
)

KEY = "00112233445566778899aabbccddeeff" * 2
NAMES = st.from_regex(r"[a-z0-9][a-z0-9_-]{0,31}", fullmatch=True)


def key_file(folder: Path, text: str) -> Path:
    path = folder / "keys"
    path.write_text(text, encoding="ascii")
    path.chmod(0o600)
    return path


@given(st.dictionaries(NAMES, st.binary(min_size=32, max_size=32), max_size=8))
def test_what_is_written_is_read(keys: dict[str, bytes]) -> None:
    """Every name with its key comes back, comments and blank lines do not."""
    keys = {n: k for n, k in keys.items() if len(set(k.hex())) > 1}
    lines = ["# a comment", "", *(f"  {n}\t{k.hex()}  # of {n}" for n, k in keys.items())]
    assert parse_keys("\n".join(lines), "keys") == keys


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("drone-1", "keys:1: 1 words"),
        (f"drone-1 {KEY} more", "keys:1: 3 words"),
        (f"\nDrone {KEY}", "keys:2: the name"),
        (f"drone-1 {KEY[1:]}", "keys:1: the key of drone-1 is not 64 hex digits (63 here)"),
        (f"drone-1 {KEY[:-1]}g", "keys:1: the key of drone-1"),
        (f"a {KEY}\na {KEY}", "keys:2: a has a key already"),
        (f"a {'0' * 64}", "keys:1: the key of a is one digit"),
    ],
)
def test_a_wrong_line_is_named_and_its_key_is_not_shown(text: str, wrong: str) -> None:
    """An error says file, line and fault, and no part of a key."""
    with pytest.raises(KeyFileError) as error:
        parse_keys(text, "keys")
    assert str(error.value).startswith(wrong)
    assert KEY[4:20] not in str(error.value)


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    """No text makes the parser fail in another way than by its own error."""
    with contextlib.suppress(KeyFileError):
        parse_keys(text, "keys")


def test_a_generated_key_is_one_and_never_the_same() -> None:
    """What ``generate_key`` gives stands in a file as it is."""
    assert len({generate_key() for _ in range(10)}) == 10
    assert len(parse_keys(f"a {generate_key()}", "keys")["a"]) == 32


def test_a_file_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    """Missing, too large or not text: the message holds the file's name."""
    large = tmp_path / "large"
    large.write_bytes(b"#" * (MAX_FILE_BYTES + 1))
    binary = tmp_path / "binary"
    binary.write_bytes(b"\xff\xfe")
    for path in (tmp_path / "missing", large, binary, tmp_path):
        with pytest.raises(KeyFileError, match=str(path)):
            load_keys(path)


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o602, 0o620, 0o666])
def test_a_file_that_is_open_to_others_is_refused(tmp_path: Path, mode: int) -> None:
    """For a worker and a drone alike; the message says what to do."""
    path = key_file(tmp_path, f"a {KEY}")
    path.chmod(mode)
    for read in (load_keys, KeyFile, lambda it: load_key(it, "a")):
        with pytest.raises(KeyFileError, match=f"mode {mode:04o}.; chmod 600 {path}"):
            read(path)


def test_a_new_file_that_is_open_to_others_waits_for_its_mode(tmp_path: Path) -> None:
    """It is refused in flight, too, and taken once nobody else can read it."""
    path = key_file(tmp_path, f"a {KEY}")
    keys = KeyFile(path)
    path.write_text(f"b {KEY}", encoding="ascii")
    path.chmod(0o644)
    assert not keys.refresh(0)
    path.chmod(0o600)
    assert keys.refresh(CHECK_EVERY_NS)
    assert keys.get("b")


@pytest.mark.parametrize("mode", [0o400, 0o600, 0o440, 0o640])
def test_the_group_may_read_it(tmp_path: Path, mode: int) -> None:
    """That is how a cluster hands out secrets."""
    path = key_file(tmp_path, f"a {KEY}")
    path.chmod(mode)
    assert len(KeyFile(path)) == 1


def test_one_key_of_a_file(tmp_path: Path) -> None:
    """A drone finds its own line, or learns that there is none."""
    path = key_file(tmp_path, f"a {KEY}")
    assert load_key(path, "a") == bytes.fromhex(KEY)
    with pytest.raises(KeyFileError, match="no key for b"):
        load_key(path, "b")


def test_a_changed_file_is_read_again_once_a_second(tmp_path: Path) -> None:
    """A new file counts from the next look on, and a look costs nothing in between."""
    path = key_file(tmp_path, f"a {KEY}")
    keys = KeyFile(path)
    assert not keys.refresh(0)
    other = tmp_path / "new"
    other.write_text(f"b {KEY}", encoding="ascii")
    other.chmod(0o600)
    other.replace(path)
    assert not keys.refresh(CHECK_EVERY_NS - 1)
    assert keys.get("a")
    assert keys.refresh(CHECK_EVERY_NS)
    assert keys.get("a") is None
    assert keys.get("b") == bytes.fromhex(KEY)


def test_a_file_that_could_not_be_read_for_a_moment_is_read_later(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker without a descriptor left must not go on with the key of a drone that was lost."""
    path = key_file(tmp_path, f"a {KEY}")
    keys = KeyFile(path)
    other = tmp_path / "new"
    other.write_text(f"b {KEY}", encoding="ascii")
    other.chmod(0o600)
    other.replace(path)

    def fails(path: Path) -> dict[str, bytes]:
        raise KeyFileError("too many open files")

    with monkeypatch.context() as for_a_moment:
        for_a_moment.setattr("rgbd_wire.tunnel.keys.load_keys", fails)
        for n in range(3):
            assert not keys.refresh(n * CHECK_EVERY_NS)
    assert caplog.text.count("the keys stay as they were") == 1
    assert keys.refresh(3 * CHECK_EVERY_NS)
    assert keys.get("a") is None


def test_a_wrong_new_file_changes_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A file that is damaged or gone while the worker runs is logged; the old keys stay."""
    path = key_file(tmp_path, f"a {KEY}")
    keys = KeyFile(path)
    path.write_text("a nonsense", encoding="ascii")
    assert not keys.refresh(0)
    path.unlink()
    assert not keys.refresh(CHECK_EVERY_NS)
    assert keys.get("a") == bytes.fromhex(KEY)
    assert "the keys stay as they were" in caplog.text
