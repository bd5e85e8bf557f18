"""Mutated datagrams for both ends of the tunnel; anything but an answer or a count is a bug.

A part comes as from somebody without a key: every type of datagram, flipped, cut, made longer, sent
again, sent to the wrong end. A part is signed or sealed with the true key after it was made up, as
by a peer gone mad, so that it reaches the layers behind the seal: shards, NACK, REPORT, PING.
"""

from __future__ import annotations

import random
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from rgbd_wire.tunnel.handshake import (
    HELLO_BYTES,
    MAC_BYTES,
    NONCE_BYTES,
    WELCOME_BYTES,
    _mac,
    make_cookie,
    pack_cookie,
    pack_hello,
)
from rgbd_wire.tunnel.inner import Nack, Ping, Report, pack_word
from rgbd_wire.tunnel.packet import MAX_PACKET_NUMBER
from rgbd_wire.tunnel.seal import Cipher
from rgbd_wire.tunnel.shards import MAX_SYMBOLS, SHARD_HEAD, SYMBOL_BYTES, Outgoing
from tests.data.tunnel import make
from tests.perf.fuzz_ends import DRONE, WORKER, Ends

MS = 1_000_000
BLOCK = 20_000
"""Datagrams thrown at one pair of ends; then come fresh ones, so that a block can be repeated."""
EDGES = (0, 1, 2, 7, 8, 127, 128, 255)
NUMBERS = (0, 1, 2, 1159, 1160, 1161, 2320, 60_000, 8_388_624, 8_388_625, 2**24 - 1)
SIZES = (1, 1160, 1161, 5000, 20_000)
SMALL_ORDER = (bytes(32), bytes([1, *bytes(31)]), b"\xec" + b"\xff" * 30 + b"\x7f", b"\xff" * 32)
WORDS = [(make.HERE / f"word_{name}.bin").read_bytes() for name in make.WORDS]
VECTORS = [path.read_bytes() for path in sorted(make.HERE.glob("*.bin"))]


class TunnelBlock:
    """One pair of ends and what is thrown at them, all of it by one seed.

    Args:
        seed: of everything but the keys of the session.
    """

    def __init__(self, seed: str) -> None:
        self.rng = random.Random(seed)
        self.outcomes: Counter[str] = Counter()
        self.ends = Ends(make.PSK, self._on_message)
        self.ends.connect()
        self.thrown = 0
        self._ways: tuple[tuple[float, Callable[[], int]], ...] = (
            (0.30, self._unsealed_up),
            (0.30, self._unsealed_down),
            (0.68, self._sealed),
            (0.02, self._signed_hello),
            (0.01, self._answered),
            (0.05, self._honest),
        )

    def throw(self) -> int:
        """One batch; how many datagrams it was.

        Raises:
            AssertionError: a bound does not hold.
            Exception: whatever the two ends let out.
        """
        rng, ends = self.rng, self.ends
        if ends.session is None or not ends.line.up or rng.random() < 0.0005:
            ends.connect()
        if ends.sealers[0].used_up or ends.sealers[1].used_up:
            ends.connect()
        weights, ways = zip(*self._ways, strict=True)
        count = rng.choices(ways, weights)[0]()
        ends.step(rng.choice((0, 1000, MS, MS, 2 * MS, 30 * MS)))
        if rng.random() < 0.2:
            ends.deliver()
        else:
            ends.forget()
        ends.check()
        self.thrown += count
        return count

    def close(self) -> None:
        """Count what the ends counted, and let them go."""
        self.outcomes.update(self.ends.refused())
        self.ends.close()

    def _on_message(self, message: bytes) -> None:
        self.outcomes["message"] += 1
        if self.rng.random() < 0.2:
            self.ends.worker.send(DRONE, message[:500] or b"x")

    def _segment(self, datagrams: Sequence[bytes]) -> int:
        if self.rng.random() < 0.9:
            return max(1, len(datagrams[0]))
        return self.rng.randrange(1, 1300)

    def _raw(self) -> list[bytes]:
        rng, recorded = self.rng, self.ends.recorded
        known = recorded if recorded and rng.random() < 0.7 else VECTORS
        return [mutant(rng.choice(known), rng) for _ in range(rng.choice((1, 1, 2, 5)))]

    def _unsealed_up(self) -> int:
        """From anywhere; the answers are never longer than what they answer."""
        rng, ends = self.rng, self.ends
        datagrams = self._raw()
        stranger = (f"192.0.2.{rng.randrange(256)}", rng.randrange(65_536))
        place = ends.line.sock.place if rng.random() < 0.3 else stranger  # type: ignore[attr-defined]
        ends.wire.sent.clear()
        ends.to_worker(datagrams, self._segment(datagrams), place)
        if place is stranger:
            answered = sum(len(data) for data, to in ends.wire.sent if to == place)
            assert answered <= sum(map(len, datagrams)), "amplification"
        self.outcomes["unsealed, to the worker"] += len(datagrams)
        return len(datagrams)

    def _unsealed_down(self) -> int:
        """At the socket of the session, or at that of a handshake that is under way."""
        rng, ends = self.rng, self.ends
        if rng.random() < 0.03:
            ends.drone.unheard(WORKER)
            ends.step(0)
        datagrams = self._raw()
        ends.to_drone(datagrams, self._segment(datagrams), rng.choice(ends.endpoint.sockets()))
        self.outcomes["unsealed, to the drone"] += len(datagrams)
        return len(datagrams)

    def _sealed(self) -> int:
        """What somebody with the keys of the session may say."""
        rng, ends = self.rng, self.ends
        to_worker = rng.random() < 0.5
        sealer = ends.sealers[0 if to_worker else 1]
        if rng.random() < 0.0005:
            far = sealer.number + rng.choice((1, 1000, 1024, 2**20, 2**32, 2**39))
            sealer.number = min(far, MAX_PACKET_NUMBER - 65_536)
        datagrams = sealer.seal_all(inners(rng))
        if rng.random() < 0.1:
            datagrams[-1] = mutant(datagrams[-1], rng)
        if rng.random() < 0.1:
            rng.shuffle(datagrams)
        if to_worker:
            place: Any = ends.line.sock.place  # type: ignore[attr-defined]
            if rng.random() < 0.05:
                place = ("192.0.2.9", rng.randrange(65_536))
            ends.to_worker(datagrams, self._segment(datagrams), place)
        else:
            ends.to_drone(datagrams, self._segment(datagrams), ends.line.sock)
        self.outcomes["sealed"] += len(datagrams)
        return len(datagrams)

    def _signed_hello(self) -> int:
        """A HELLO with a good cookie and a good MAC, and anything between them."""
        rng, ends = self.rng, self.ends
        nonce, place = rng.randbytes(NONCE_BYTES), ("192.0.2.8", rng.randrange(65_536))
        text = repr(place).encode()
        cookie = make_cookie(ends.worker._secret, text, nonce, ends.clock.ns)
        public = rng.choice((*SMALL_ORDER, rng.randbytes(32), rng.randbytes(32)))
        head = bytearray(
            pack_hello(DRONE, make.PSK, nonce, cookie, public, Cipher(rng.randrange(1, 4)))
        )[: HELLO_BYTES - MAC_BYTES]
        if rng.random() < 0.5:
            head[rng.randrange(37, len(head))] = rng.choice(EDGES)
        hello = bytes(head) + _mac(make.PSK, b"hello", bytes(head))
        datagrams = [hello] * rng.choice((1, 1, 3))
        ends.to_worker(datagrams, len(hello), place)
        self.outcomes["signed HELLO"] += len(datagrams)
        return len(datagrams)

    def _answered(self) -> int:
        """A handshake of the drone's, answered by a worker that signs anything."""
        rng, ends = self.rng, self.ends
        ends.endpoint.redial()
        ends.step(600 * MS)
        attempt = ends.endpoint.attempt
        if attempt is None:
            return 0
        sock, sent = attempt.sock, 2
        ends.to_drone([mutant(pack_cookie(attempt.nonce, rng.randbytes(20)), rng)], 37, sock)
        if ends.endpoint.attempt is attempt and attempt.hello is None:
            ends.to_drone([pack_cookie(attempt.nonce, rng.randbytes(20))], 37, sock)
            sent = 3
        if ends.endpoint.attempt is not attempt or attempt.hello is None:
            return sent
        public = rng.choice((*SMALL_ORDER, _PUBLIC, _PUBLIC))
        name = rng.choice((b"worker-a", b"worker-b", rng.randbytes(8)))
        head = bytearray(
            struct.pack(
                "<B16sQ32sBB32s",
                0x14,
                attempt.nonce,
                rng.randrange(2**64),
                public,
                rng.choice((1, 1, 2, 2, 0, 3, 255)),
                len(name),
                name,
            )
        )
        if rng.random() < 0.5:
            head[rng.randrange(1, len(head))] = rng.choice(EDGES)
        mac = _mac(make.PSK, b"welcome", attempt.hello.packet + bytes(head))
        ends.to_drone([bytes(head) + mac], WELCOME_BYTES, sock)
        self.outcomes["signed WELCOME"] += 1
        return sent

    def _honest(self) -> int:
        """Frames that are true, so that there is something to ask for and to report."""
        rng, ends = self.rng, self.ends
        if rng.random() < 0.5:
            ends.drone.send(WORKER, rng.randbytes(rng.choice(SIZES)), rng.choice((1, 10**9)))
        else:
            ends.worker.send(DRONE, rng.randbytes(rng.choice(SIZES)))
        return 0


_PUBLIC = X25519PrivateKey.from_private_bytes(make.WORKER_PRIVATE).public_key().public_bytes_raw()


def mutant(data: bytes, rng: random.Random) -> bytes:
    """Bits flipped, bytes replaced, cut, made longer, or left as it is."""
    out = bytearray(data)
    for _ in range(rng.choice((0, 1, 1, 2, 5))):
        if not out:
            break
        place = rng.randrange(min(len(out), rng.choice((16, len(out)))))
        match rng.randrange(4):
            case 0:
                out[place] ^= 1 << rng.randrange(8)
            case 1:
                out[place] = rng.choice(EDGES)
            case 2:
                del out[rng.randrange(len(out)) :]
            case 3:
                out += rng.randbytes(rng.choice((1, 2, 40)))
    return bytes(out)


def inners(rng: random.Random) -> list[bytes]:
    """What goes into the sealed datagrams of one batch."""
    match rng.randrange(4):
        case 0:
            made = [made_shard(rng) for _ in range(rng.randrange(1, 6))]
        case 1:
            made = [mutant(s, rng) for s in true_shards(rng)]
        case 2:
            made = true_shards(rng)
        case _:
            made = [word(rng) for _ in range(rng.choice((1, 1, 4)))]
    return [i for i in made if 0 < len(i) <= 1300] or [b"\x04"]


def made_shard(rng: random.Random) -> bytes:
    """A shard that is well formed, of a message that may be any."""
    length = rng.choice((*NUMBERS, rng.randrange(1, 9000), 3000, 3000))
    symbol = rng.choice((0, 1, 2, 3, 4, 5, rng.randrange(MAX_SYMBOLS), MAX_SYMBOLS - 1))
    number = rng.choice((make.MESSAGE_ID, rng.randrange(8), rng.randrange(2**24)))
    size = min(SYMBOL_BYTES, max(0, length - symbol * SYMBOL_BYTES)) or SYMBOL_BYTES
    head = SHARD_HEAD.pack(1 | length << 8, symbol, number | rng.choice(EDGES) << 24)
    return head + rng.choice((bytes, rng.randbytes))(size)


def true_shards(rng: random.Random) -> list[bytes]:
    """A message of somebody honest, with some of its shards missing and in any order."""
    message = rng.randbytes(rng.choice(SIZES))
    out = Outgoing(message, rng.randrange(2**24), rng.randrange(4), 0, 0)
    shards = out.take(out.symbols) + out.take(out.parity) + out.take_fresh(rng.randrange(3))
    return rng.sample(shards, rng.randrange(1, len(shards) + 1))


def word(rng: random.Random) -> bytes:
    """A word of the tunnel, mutated, or one with numbers of its own."""
    few, many = (0, 1, 9, 5000), 65_535
    match rng.randrange(6):
        case 0:
            number = rng.choice((0, 1, make.MESSAGE_ID, rng.randrange(64)))
            wanted, expected = rng.choice((1, 9, many)), rng.choice((*few, many))
            return pack_word(Nack(number, rng.choice((1, 2)), wanted, expected))
        case 1:
            lost, got = rng.choice((*few, many)), rng.choice((*few, many))
            size, us = (rng.choice((*few, 2**32 - 1)) for _ in range(2))
            return pack_word(Report(rng.randrange(64), rng.random() < 0.8, got, lost, size, us))
        case 2:
            stamp, srtt = rng.choice((0, 1, 10**9, 2**64 - 1)), rng.choice((0, 1, 2**32 - 1))
            newest, came = (rng.choice((*few, 2**40 - 1)) for _ in range(2))
            return pack_word(Ping(rng.random() < 0.5, stamp, srtt, newest, came))
    return mutant(rng.choice(WORDS), rng)


def fuzz(count: int, seed: int) -> Counter[str]:
    """Throw so many datagrams on this thread, for the short test; what became of them."""
    block = TunnelBlock(f"{seed}")
    try:
        while block.thrown < count:
            block.throw()
    finally:
        block.close()
    return block.outcomes
