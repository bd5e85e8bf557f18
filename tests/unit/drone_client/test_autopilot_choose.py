"""Addresses, parameter files, and what a line that cannot be opened says."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drone_client.autopilot.ardupilot import ARDUPILOT
from drone_client.autopilot.choose import open_autopilot, parse_address
from drone_client.autopilot.line import SerialLine
from drone_client.autopilot.parameter_reader import parameter_value
from drone_client.autopilot.parameters import (
    load_parameter_file,
    packaged_parameters,
    parse_parameters,
)
from drone_client.autopilot.px4 import PX4
from drone_client.autopilot.settings import AutopilotSettings
from drone_client.errors import AutopilotError
from rgbd_wire.clock import MonotonicClock


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("udp/127.0.0.1:14540", ("PX4", "udp", "127.0.0.1", 14540)),
        ("udpout/drone.local:14550", ("PX4", "udpout", "drone.local", 14550)),
        ("udp/[::1]:14540", ("PX4", "udp", "::1", 14540)),
        ("serial//dev/ttyACM0:921600", ("PX4", "serial", "/dev/ttyACM0", 921600)),
        ("px4+serial//dev/ttyS1:57600", ("PX4", "serial", "/dev/ttyS1", 57600)),
        ("ardupilot+udp/127.0.0.1:14550", ("ArduPilot", "udp", "127.0.0.1", 14550)),
    ],
)
def test_addresses(address: str, expected: tuple[str, str, str, int]) -> None:
    """Flavour, kind of line, place and number."""
    flavour, *rest = parse_address(address)
    assert (flavour.name, *rest) == expected


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("", "is no address"),
        ("127.0.0.1:14540", "is no address"),
        ("tcp/127.0.0.1:14540", "is no address"),
        ("udp/127.0.0.1", "is no port"),
        ("udp/127.0.0.1:0", "is no port"),
        ("udp/127.0.0.1:99999", "is no port"),
        ("udp/:14540", "is no host"),
        ("udp/a b:14540", "is no host"),
        ("serial/dev/ttyACM0:921600", "two strokes"),
        ("serial//dev/ttyACM0", "baud"),
        ("serial//dev/ttyACM0:12", "baud"),
        ("betaflight+udp/127.0.0.1:1", "px4\\+ or ardupilot\\+"),
        ("udp/" + "1" * 1000, "is no address"),
    ],
)
def test_a_malformed_address_says_what_is_wrong(address: str, words: str) -> None:
    """One line, with an example, and short whatever was given."""
    with pytest.raises(AutopilotError, match=words) as caught:
        parse_address(address)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@given(st.text(max_size=60))
def test_any_text_is_an_address_or_an_error(text: str) -> None:
    """No other exception."""
    try:
        parse_address(text)
    except AutopilotError:
        return


def test_a_port_that_is_taken_and_a_foreign_address_are_told() -> None:
    """What to do is in the message."""
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(AutopilotError, match="taken"):
            open_autopilot(f"udp/127.0.0.1:{other.getsockname()[1]}", MonotonicClock())
    with pytest.raises(AutopilotError, match=r"a\.\.b cannot be resolved .*not a host name"):
        open_autopilot("udpout/a..b:14540", MonotonicClock())
    with pytest.raises(AutopilotError, match="udpout/192.0.2.1:14540"):
        open_autopilot("udp/192.0.2.1:14540", MonotonicClock())
    with pytest.raises(AutopilotError, match="dialout"):
        open_autopilot("serial//dev/no-such-device:57600", MonotonicClock())


def test_opened_and_closed_without_anybody_there() -> None:
    """No state, no exception, and both threads end."""
    autopilot = open_autopilot("udpout/127.0.0.1:9", MonotonicClock())
    try:
        assert autopilot.state() is None
        assert autopilot.read_parameters(["EKF2_EV_CTRL"], 0.01) == {}
        autopilot.engage()
        assert autopilot.phase == "warming"
        autopilot.release()
    finally:
        autopilot.close()
    assert not any(thread.is_alive() for thread in autopilot._threads)


def test_a_serial_line_that_is_full_drops_whole_messages() -> None:
    """Nobody reads the other end: writing returns, and what came through is whole."""
    ours, theirs = os.openpty()
    line = SerialLine(os.ttyname(theirs), 57600)
    try:
        message = bytes(range(200))
        sent = 0
        for _ in range(2000):
            sent += line.write(message)
        assert line.dropped > 0
        assert sent < 2000
        os.set_blocking(ours, False)
        came = os.read(ours, 1_000_000)
        assert len(came) <= sent * len(message)
        assert message.startswith(came[-(len(came) % 200) :] if len(came) % 200 else b"")
    finally:
        line.close()
        os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 5.0}, {"rate_hz": 500.0}, {"system": 0}, {"own_component": 300}]
)
def test_settings_are_bounded(wrong: dict[str, float]) -> None:
    """Rates from 20 to 100 Hz, ids from 1 to 255."""
    with pytest.raises(ValueError, match=next(iter(wrong))):
        AutopilotSettings(**wrong)


def test_the_packaged_parameters_have_values_and_reasons() -> None:
    """What the design rests on is in the file, each with a why."""
    parameters = packaged_parameters()
    assert parameters["EKF2_HGT_REF"].value == 2
    assert parameters["EKF2_RNG_CTRL"].value == 2
    assert parameters["EKF2_EV_CTRL"].value == 9
    assert parameters["COM_OF_LOSS_T"].value == 0.5
    assert all(len(p.why) > 20 for p in parameters.values())
    assert isinstance(parameters["EKF2_EV_CTRL"].value, int)
    assert parameters["EKF2_EVP_NOISE"].matches(float(np.float32(0.03)))
    assert not parameters["EKF2_EV_CTRL"].matches(11)


def test_every_flavour_has_its_packaged_parameters() -> None:
    """ArduPilot flies its last velocity on for GUID_TIMEOUT: no longer than PX4 waits."""
    for flavour in (PX4, ARDUPILOT):
        assert all(len(p.why) > 20 for p in packaged_parameters(flavour.parameter_file).values())
    timeout = packaged_parameters(ARDUPILOT.parameter_file)["GUID_TIMEOUT"]
    assert timeout.value == packaged_parameters(PX4.parameter_file)["COM_OF_LOSS_T"].value
    assert not timeout.matches(3.0)


def test_the_example_is_the_packaged_file() -> None:
    """One truth: the file that people load is the one that is compared."""
    example = Path(__file__).parents[3] / "examples" / "px4" / "aerial-contact.params"
    assert load_parameter_file(example) == packaged_parameters()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no parameter"),
        ("1 1 A 2 6", "5 with tabs"),
        ("1\t1\tA\tx\t6", "is no number"),
        ("1\t1\tA\tnan\t9", "cannot be"),
        ("1\t1\tA\t2\t60", "cannot be"),
        ("1\t1\tA\t2.5\t6", "whole type"),
        ("1\t1\t" + "A" * 17 + "\t2\t6", "no name"),
        ("1\t1\tA\t2\t6\n1\t1\tA\t3\t6", "twice"),
    ],
)
def test_a_bad_parameter_file_names_the_line(text: str, words: str) -> None:
    """Where, what, and what was expected."""
    with pytest.raises(AutopilotError, match=words):
        parse_parameters(text, "some.params")


def test_a_missing_or_binary_file_is_one_line(tmp_path: Path) -> None:
    """Not a traceback."""
    binary = tmp_path / "b.params"
    binary.write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.params", binary):
        with pytest.raises(AutopilotError, match="cannot be read"):
            load_parameter_file(path)


@given(st.integers(-(2**31), 2**31 - 1))
def test_whole_parameters_survive_the_floats_place(value: int) -> None:
    """PX4 sends their bytes."""
    raw = struct.unpack("<f", struct.pack("<i", value))[0]
    if not np.isnan(raw):
        assert parameter_value(raw, 6, bytewise=True) == value
    assert parameter_value(float(value % 1000), 6, bytewise=False) == value % 1000


def test_parameters_of_a_kind_that_does_not_fit_are_none() -> None:
    """A 64-bit number has no place there."""
    assert parameter_value(1.0, 10, bytewise=True) is None
    assert parameter_value(1e30, 6, bytewise=False) is None
