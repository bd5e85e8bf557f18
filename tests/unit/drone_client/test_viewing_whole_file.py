"""Files have their name only when they are whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from drone_client.errors import OutputError
from drone_client.viewing.whole_file import WholeFile, remove_if_empty, write_whole


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_file_gets_its_name_at_the_end(tmp_path: Path):
    """Until then nobody takes it for a result."""
    whole = WholeFile(tmp_path / "a.mcap")
    whole.file.write(b"all of it")
    assert list(files(tmp_path)) == [".a.part.mcap"]
    whole.keep()
    assert files(tmp_path) == {"a.mcap": b"all of it"}


def test_a_file_that_is_given_up_leaves_what_was_there(tmp_path: Path):
    """Also one that might have gone."""
    (tmp_path / "a.mcap").write_bytes(b"earlier")
    whole = WholeFile(tmp_path / "a.mcap", overwrite=True)
    whole.file.write(b"half")
    whole.discard()
    whole.discard()
    assert files(tmp_path) == {"a.mcap": b"earlier"}


def test_a_file_that_came_in_between_stays(tmp_path: Path):
    """It may not go, as it may not at the beginning."""
    whole = WholeFile(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").write_bytes(b"somebody else's")
    with pytest.raises(OutputError, match="is there already"):
        whole.keep()
    with pytest.raises(OutputError, match="is there already"):
        WholeFile(tmp_path / "a.mcap")
    assert files(tmp_path) == {"a.mcap": b"somebody else's"}


def test_a_full_disk_leaves_no_half_of_a_small_file(tmp_path: Path, monkeypatch):
    """Its error names the file that was to be; what was there stays."""

    def full(self: Path, data: bytes) -> int:
        self.touch()
        raise OSError(28, "No space left on device")

    path = tmp_path / "summary.json"
    write_whole(path, b"earlier")
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left on device") as told:
        write_whole(path, b"new")
    assert told.value.filename == str(path)
    assert files(tmp_path) == {"summary.json": b"earlier"}


def test_only_empty_files_are_taken_away(tmp_path: Path):
    """One that is not there is no error."""
    (tmp_path / "a").touch()
    (tmp_path / "b").write_bytes(b"x")
    for name in "abc":
        remove_if_empty(tmp_path / name)
    assert list(files(tmp_path)) == ["b"]
