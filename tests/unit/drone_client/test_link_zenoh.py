"""The Zenoh link against real sessions on loopback: found, served, lost, found again."""

from __future__ import annotations

import itertools
import queue

import pytest
import zenoh

from drone_client.airframe import Airframe
from drone_client.errors import LinkError
from drone_client.gate import GateSettings
from drone_client.link import zenoh as link_zenoh
from drone_client.link.zenoh import (
    MAX_MESSAGE_BYTES,
    MAX_STATUS_BYTES,
    MAX_WORKERS,
    ZenohLink,
    check_endpoint,
)
from drone_client.reception import Receiver
from rgbd_wire.clock import MonotonicClock
from rgbd_wire.errors import Reject
from tests.unit.drone_client.builders import eventually
from tests.unit.drone_client.zenoh_worker import ZenohWorker

CLOCK = MonotonicClock()
BUDGET_NS = 250_000_000
NUMBERS = itertools.count(1)


class Drone:
    """A started link and what came in over it."""

    def __init__(self, *endpoints: str, name: str) -> None:
        self.name = name
        self.link = ZenohLink(name, endpoints, CLOCK)
        self.got: queue.Queue[tuple[bytes, int]] = queue.Queue()
        self.seen: queue.Queue[tuple[str, ...]] = queue.Queue()
        """The workers at each change of them."""
        self.link.start(
            lambda message, t4_ns: self.got.put((message, t4_ns)),
            lambda: self.seen.put(self.link.workers()),
        )

    def sees(self, *workers: str) -> bool:
        """Whether these workers, and no other, are alive before long."""
        return eventually(lambda: self.link.workers() == workers, timeout_s=20)


def reversing(name: str = "w1") -> ZenohWorker:
    """A worker that sends each frame back, reversed."""
    return ZenohWorker(name, answer=lambda worker, frame: (frame[::-1],))


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    """A machine that stands still for a second loses no link here; a process that ends, does."""
    monkeypatch.setitem(link_zenoh._CONFIG, "transport/link/tx/lease", 60_000)


@pytest.fixture(scope="module")
def worker():
    """A worker that lives."""
    worker = reversing()
    yield worker
    worker.close()


@pytest.fixture
def start_worker():
    """Starts workers that a test may close and open; a session that is left open never ends."""
    started: list[ZenohWorker] = []

    def start(name: str = "w1") -> ZenohWorker:
        started.append(reversing(name))
        return started[-1]

    yield start
    for worker in started:
        worker.close()


@pytest.fixture
def start_drone():
    """Starts drones, and closes their links whatever becomes of the test."""
    started: list[Drone] = []

    def start(*endpoints: str) -> Drone:
        # The link of the test before may still be closing: its name would answer for this one's
        started.append(Drone(*endpoints, name=f"drone-{next(NUMBERS)}"))
        return started[-1]

    yield start
    for drone in started:
        drone.link.close()


@pytest.fixture
def drone(worker, start_drone):
    """A drone connected to the worker that lives."""
    return start_drone(worker.endpoint)


@pytest.fixture
def reached(worker, drone):
    """The same drone, when a reply that follows no frame gets to it, too."""
    assert drone.sees("w1")
    assert worker.reaches(drone.name)
    return drone


def test_a_frame_goes_to_its_worker_and_the_answer_comes_back_with_its_time(worker, drone):
    """The very bytes both ways; t4 lies between the sending and now, on the drone's clock."""
    assert drone.sees("w1")
    before_ns = CLOCK.now_ns()
    frame = bytes(range(256)) * 150  # one batch of Zenoh's: a busy machine drops no part of it
    drone.link.send("w1", frame, BUDGET_NS)
    assert worker.frames.get(timeout=10) == frame
    message, t4_ns = drone.got.get(timeout=10)
    assert message == frame[::-1][: MAX_MESSAGE_BYTES + 1]
    assert before_ns < t4_ns <= CLOCK.now_ns()
    assert drone.link.send_errors == 0


def test_every_worker_whose_token_is_up_is_known_and_no_other(worker, drone):
    """Those that were there before, those that come and those that go."""
    assert drone.sees("w1")
    other = worker.announce("a-worker")
    assert drone.sees("a-worker", "w1")
    other.undeclare()
    assert drone.sees("w1")
    worker.token.undeclare()
    assert drone.sees()
    worker.token = worker.announce("w1")
    assert drone.sees("w1")


def test_a_worker_that_dies_is_gone_and_is_served_again_when_it_is_back(start_worker, start_drone):
    """The same port, another session: the link reconnects by itself, the publisher still works."""
    mortal = start_worker()
    drone = start_drone(mortal.endpoint)
    assert drone.sees("w1")
    drone.link.send("w1", b"first", BUDGET_NS)
    assert mortal.frames.get(timeout=10) == b"first"
    mortal.close()
    assert drone.sees()
    drone.link.send("w1", b"into the void", BUDGET_NS)  # neither blocks nor raises
    mortal.open()
    assert drone.sees("w1")
    drone.link.send("w1", b"again", BUDGET_NS)
    assert mortal.frames.get(timeout=10) == b"again"
    messages = [drone.got.get(timeout=10)[0] for _ in range(2)]
    assert messages == [b"tsrif", b"niaga"]


def test_a_worker_that_is_not_there_yet_is_found_when_it_comes(start_worker, start_drone):
    """The drone may start first."""
    mortal = start_worker()
    mortal.close()
    drone = start_drone(mortal.endpoint)
    assert drone.link.workers() == ()
    mortal.open()
    assert drone.sees("w1")


def test_a_drone_is_at_home_with_two_workers_at_once(worker, start_worker, start_drone):
    """Each has its own endpoint; when one dies the other is still there."""
    second = start_worker("w2")
    drone = start_drone(worker.endpoint, second.endpoint)
    assert drone.sees("w1", "w2")
    second.close()
    assert drone.sees("w1")
    drone.link.send("w1", b"still here", BUDGET_NS)
    assert worker.frames.get(timeout=10) == b"still here"


def test_a_worker_that_is_down_does_not_keep_the_drone_from_the_others(
    worker, start_worker, start_drone
):
    """The first endpoint answers nobody; the second serves; the first comes later."""
    late = start_worker("w0")
    late.close()
    drone = start_drone(late.endpoint, worker.endpoint)
    assert drone.sees("w1")
    late.open()
    assert drone.sees("w0", "w1")


def test_results_for_another_drone_do_not_come_in(worker, reached):
    """Keys are directed."""
    worker.reply("another", b"not for us")
    worker.reply(reached.name, b"for us")
    assert reached.got.get(timeout=10)[0] == b"for us"


def test_a_message_that_is_too_long_is_cut_and_counted(worker, reached):
    """Fifty kilobytes where sixteen may be: one reject, no exception, and life goes on."""
    receiver = Receiver("d", 1, GateSettings(1, 1), Airframe(), lambda *_: None, lambda _: None)
    for message in (bytes(50_000), b"AERC\x01\x02\0\0" + bytes(50_000), b"short"):
        worker.reply(reached.name, message)
        received, t4_ns = reached.got.get(timeout=10)
        assert len(received) == min(len(message), MAX_MESSAGE_BYTES + 1)
        receiver.on_message(received, t4_ns)
    assert receiver.rejects == {Reject.WRONG_MAGIC: 1, Reject.WRONG_SIZE: 1, Reject.TRUNCATED: 1}


def test_a_message_of_megabytes_is_dropped_on_the_link(worker, reached):
    """It is never put together, and what comes after it comes."""
    worker.reply(reached.name, bytes(5_000_000))
    worker.reply(reached.name, b"after it")
    assert reached.got.get(timeout=10)[0] == b"after it"


def test_a_status_comes_in_and_one_that_is_too_long_is_cut(worker, reached):
    """From any worker, on a key of its own."""
    worker.say(b"fine")
    assert reached.got.get(timeout=10)[0] == b"fine"
    worker.say(bytes(50_000))
    assert len(reached.got.get(timeout=10)[0]) == MAX_STATUS_BYTES + 1


def test_a_probe_goes_before_all_frames_and_is_dropped_rather_than_waited_for(worker, drone):
    """To the worker that it is for, with the urgency of the stream table."""
    assert drone.sees("w1")
    drone.link.send_urgent("w1", b"probe")
    sample = worker.probes.get(timeout=10)
    assert sample.payload.to_bytes() == b"probe"
    assert str(sample.key_expr) == f"aerial/v1/{drone.name}/probe/w1"
    assert (sample.priority, sample.express) == (zenoh.Priority.REAL_TIME, True)
    assert sample.congestion_control == zenoh.CongestionControl.DROP
    drone.link.unheard("w1")  # there is no other way to try
    assert drone.link.send_errors == 0


def test_every_change_of_the_workers_is_told_after_it_happened(worker, drone):
    """Once for each that comes or goes, and never for a name that is none."""
    assert drone.seen.get(timeout=20) == ("w1",)
    stranger = worker.announce("NO NAME")
    other = worker.announce("w2")
    assert drone.seen.get(timeout=20) == ("w1", "w2")
    other.undeclare()
    assert drone.seen.get(timeout=20) == ("w1",)
    stranger.undeclare()
    assert drone.seen.empty()


def test_names_that_come_and_go_leave_a_bounded_number_of_publishers(worker, drone):
    """A drone that has sent to hundreds of workers still reaches the one that is there."""
    for i in range(5 * MAX_WORKERS):
        drone.link.send(f"gone-{i}", b"nobody", BUDGET_NS)
    assert len(drone.link._publishers) <= 2 * MAX_WORKERS
    assert drone.sees("w1")
    drone.link.send("w1", b"still", BUDGET_NS)
    assert worker.frames.get(timeout=10) == b"still"


@pytest.mark.parametrize(
    ("endpoint", "algorithm", "warns"),
    [
        ("tcp/192.0.2.7:7447", "cubic\n", True),
        ("tcp/192.0.2.7:7447", "bbr\n", False),
        ("tcp/127.0.0.1:7447", "cubic\n", False),
        ("tcp/[::1]:7447", "cubic\n", False),
        ("tcp/192.0.2.7:7447", None, False),
    ],
)
def test_a_congestion_control_that_is_not_bbr_is_warned_of(
    monkeypatch, tmp_path, endpoint, algorithm, warns
):
    """One sentence that says what to do; none for a loopback, or where nobody can know."""
    file = tmp_path / "tcp_congestion_control"
    if algorithm is not None:
        file.write_text(algorithm)
    monkeypatch.setattr(link_zenoh, "CONGESTION_CONTROL_FILE", file)
    link = ZenohLink("d", (endpoint,), CLOCK)
    link.close()
    assert len(link.warnings) == warns
    assert all("'cubic'" in w and "sysctl -w" in w for w in link.warnings)


def test_a_rogue_that_announces_thousands_of_workers_fills_no_memory(worker, reached):
    """At most so many are known."""
    tokens = [worker.announce(f"rogue-{i}") for i in range(MAX_WORKERS + 20)]
    assert eventually(lambda: len(reached.link.workers()) == MAX_WORKERS)
    marker = worker.announce("w1")  # what comes after them all has been looked at
    worker.reply(reached.name, b"end")
    assert reached.got.get(timeout=10)[0] == b"end"
    assert len(reached.link.workers()) == MAX_WORKERS
    for token in (*tokens, marker):
        token.undeclare()


def test_a_closed_link_drops_frames_and_counts_them(worker, drone):
    """The last frames of a run find the session gone; closing twice is no harm."""
    assert drone.sees("w1")
    drone.link.close()
    drone.link.send("w1", b"late", BUDGET_NS)
    drone.link.send("never-seen", b"late", BUDGET_NS)
    assert drone.link.send_errors == 2


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/127.0.0.1:7447", "tls/edge.example:65535", "tcp/[::1]:1", "tcp/under_score-host:7447"],
)
def test_an_endpoint_is_taken_as_it_is(endpoint):
    """Names, IPv4, IPv6 in brackets."""
    assert check_endpoint(endpoint) == endpoint


@pytest.mark.parametrize(
    ("endpoint", "says"),
    [
        ("127.0.0.1:7447", "did you mean tcp/127.0.0.1:7447?"),
        ("edge", "such as tcp/192.0.2.7:7447"),
        ("tcp/edge", "such as"),
        ("tcp/edge:0", "such as"),
        ("tcp/edge:65536", "such as"),
        ("tcp/edge:\u0667", "such as"),
        ("tcp/::1:7447", "such as"),
        ("udp/edge:7447", "(protocols: tcp, tls)"),
        ("http://edge:7447", "such as"),
        ("tcp/edge:7447\n", "such as"),
        ("tcp/edge:7447#iface=eth0", "such as"),
        ("", "such as"),
    ],
)
def test_what_is_no_endpoint_is_told_with_one_that_is(endpoint, says):
    """Before a session is opened, in one line."""
    with pytest.raises(LinkError) as caught:
        ZenohLink("d", ("tcp/127.0.0.1:7447", endpoint), CLOCK)
    assert str(caught.value).startswith(f"endpoint {endpoint!r} is not PROTOCOL/HOST:PORT")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_drone_cannot_be_called_as_the_workers_keys_begin():
    """Its keys would be theirs."""
    with pytest.raises(LinkError, match="cannot be called 'workers'"):
        ZenohLink("workers", ("tcp/127.0.0.1:7447",), CLOCK)


def test_a_link_to_nowhere_is_refused():
    """An empty list of endpoints would wait for ever."""
    with pytest.raises(LinkError, match="no endpoint to connect to"):
        ZenohLink("d", (), CLOCK)
