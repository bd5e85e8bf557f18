"""Throw mutated datagrams at both ends of the tunnel; anything but an answer or a count is a bug.

``python -m tests.perf.fuzz_tunnel --count 10000000`` starts from the test vectors. Half of the
mutants are of whole datagrams, as somebody without a key would send them; the other half is sealed
with the true key after the mutation, as a peer gone mad would, so that they reach the layers behind
the seal. A short run is part of the test suite.
"""

from __future__ import annotations

import argparse
import random
import resource
import struct
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from rgbd_wire.tunnel.channel import Channel, Side
from rgbd_wire.tunnel.errors import Counters, TunnelError
from rgbd_wire.tunnel.handshake import (
    SessionKeys,
    check_cookie,
    check_hello,
    open_welcome,
    parse_cookie,
    parse_hello,
    parse_init,
)
from rgbd_wire.tunnel.packet import Type, parse_reset, type_of
from rgbd_wire.tunnel.partials import MAX_OPEN_BYTES
from rgbd_wire.tunnel.seal import Sealer
from rgbd_wire.tunnel.shards import MAX_SYMBOLS, SHARD_HEAD, SYMBOL_BYTES, Outgoing
from tests.data.tunnel import make

MS = 1_000_000
EDGES = (0, 1, 2, 7, 8, 127, 128, 255)
NUMBERS = (0, 1, 2, 1159, 1160, 1161, 2320, 60_000, 8_388_624, 8_388_625, 2**24 - 1)
MAX_GROWTH_BYTES = 96 * 1024 * 1024
"""Of the whole process after its first tenth: both sessions full of pieces of messages, and what
the allocator keeps."""


@dataclass
class Outcome:
    """What became of the mutants."""

    counts: Counter[str]
    slowest_s: float = 0.0
    growth_bytes: int = 0


class Target:
    """Both ends of one session, and the worker's side of the handshake."""

    def __init__(self) -> None:
        self.hello = parse_hello(vector("hello"))
        self.private = X25519PrivateKey.from_private_bytes(make.DRONE_PRIVATE)
        welcome = open_welcome(vector("welcome_aes_256_gcm"), self.hello, make.PSK, self.private)
        self.keys: SessionKeys = welcome.keys
        self.counters = Counters()
        self.now_ns = 0
        self.reopen()

    def reopen(self) -> None:
        """Fresh channels, as after another handshake."""
        self.ends = {
            side: Channel(self.keys, side, len, self.counters, self.now_ns) for side in Side
        }
        self.sealers = {
            Side.WORKER: Sealer(Type.UP, self.keys.session, self.keys.cipher, self.keys.up),
            Side.DRONE: Sealer(Type.DOWN, self.keys.session, self.keys.cipher, self.keys.down),
        }
        for end in self.ends.values():  # something that a NACK or a REPORT can be about
            end.send(make.message(), 100 * MS, self.now_ns)

    def receive(self, datagrams: Sequence[bytes], segment: int) -> str:
        """Do all that both ends do with what came; say what became of it."""
        data = memoryview(b"".join(datagrams))
        try:
            kind = type_of(data)
            match kind:
                case Type.INIT:
                    parse_init(data)
                case Type.COOKIE:
                    parse_cookie(data)
                case Type.HELLO:
                    hello = parse_hello(data)
                    check_cookie(make.COOKIE_SECRET, make.ADDRESS, hello, make.NOW_NS)
                    check_hello(hello, make.PSK)
                case Type.WELCOME:
                    open_welcome(data, self.hello, make.PSK, self.private)
                case Type.RESET:
                    parse_reset(data)
                case Type.UP:
                    return self._sealed(Side.WORKER, data, segment)
                case Type.DOWN:
                    return self._sealed(Side.DRONE, data, segment)
        except TunnelError as error:
            return error.reason.value
        return f"{kind.name} accepted"

    def _sealed(self, side: Side, data: memoryview, segment: int) -> str:
        end = self.ends[side]
        messages = end.receive(data, segment, self.now_ns)
        end.settle(self.now_ns)
        end.tick(self.now_ns)
        assert end._partials.open_bytes <= MAX_OPEN_BYTES
        assert not end._partials.words
        return "message" if messages else "taken in"


def vector(name: str) -> bytes:
    """A test vector."""
    return (make.HERE / f"{name}.bin").read_bytes()


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
    message = rng.randbytes(rng.choice((1, 1160, 1161, 5000, 20_000)))
    out = Outgoing(message, rng.randrange(2**24), rng.randrange(4), 0, 0)
    shards = out.take(out.symbols) + out.take(out.parity) + out.take_fresh(rng.randrange(3))
    return rng.sample(shards, rng.randrange(1, len(shards) + 1))


def word(rng: random.Random) -> bytes:
    """A word of the tunnel, mutated, or one with numbers of its own."""
    name = rng.choice(list(make.WORDS))
    if rng.random() < 0.2:
        number = rng.choice((0, make.MESSAGE_ID, rng.randrange(2**24)))
        return struct.pack("<IBH", 2 | number << 8, rng.choice((1, 2)), rng.choice((1, 9, 65535)))
    return mutant(vector(f"word_{name}"), rng)


def fuzz(count: int, seed: int) -> Outcome:
    """Throw ``count`` datagrams.

    Raises:
        AssertionError: something grew past its bound.
    """
    rng, target, outcome = random.Random(seed), Target(), Outcome(Counter())
    raw = [path.read_bytes() for path in sorted(make.HERE.glob("*.bin"))]
    thrown, warm_bytes, opened = 0, 0, 0
    while thrown < count:
        target.now_ns += rng.choice((0, 1000, MS, 30 * MS))
        if rng.random() < 0.5:
            datagrams = [mutant(rng.choice(raw), rng)]
        else:
            match rng.randrange(4):
                case 0:
                    inners = [made_shard(rng) for _ in range(rng.randrange(1, 6))]
                case 1:
                    inners = [mutant(s, rng) for s in true_shards(rng)]
                case 2:
                    inners = true_shards(rng)
                case _:
                    inners = [word(rng)]
            sealer = target.sealers[rng.choice(list(Side))]
            datagrams = sealer.seal_all([i for i in inners if 0 < len(i) <= 1300] or [b"\x04"])
            if rng.random() < 0.1:
                datagrams[-1] = mutant(datagrams[-1], rng)
        segment = max(1, len(datagrams[0])) if rng.random() < 0.9 else rng.randrange(1, 1300)
        began_s = time.perf_counter()
        outcome.counts[target.receive(datagrams, segment)] += 1
        outcome.slowest_s = max(outcome.slowest_s, time.perf_counter() - began_s)
        thrown += len(datagrams)
        if thrown - opened > 100_000:
            opened = thrown
            target.reopen()
        if not warm_bytes and thrown >= count // 10:
            warm_bytes = resident_bytes()
    outcome.growth_bytes = max(0, resident_bytes() - warm_bytes)
    assert outcome.growth_bytes < MAX_GROWTH_BYTES, f"{outcome.growth_bytes} bytes more"
    for name, number in target.counters.snapshot().items():
        outcome.counts[name] += number
    return outcome


def resident_bytes() -> int:
    """Memory of this process that is in use."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    began_s = time.perf_counter()
    outcome = fuzz(args.count, args.seed)
    took_s = time.perf_counter() - began_s
    for name, number in outcome.counts.most_common():
        print(f"{number:10d}  {name}")
    print(f"{args.count} datagrams in {took_s:.0f} s")
    print(f"slowest batch {outcome.slowest_s * 1e3:.1f} ms")
    print(f"{outcome.growth_bytes / 2**20:.1f} MiB more memory after the first tenth")
    return 0


if __name__ == "__main__":
    sys.exit(main())
