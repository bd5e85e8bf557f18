"""Fuzzing that is guided by which code an input reaches: ``scripts/fuzz atheris``.

The corpus stays in the folder for temporary files, so that the next run goes on from it. An input
of the target ``tunnel`` is a little program: each step is a byte that says which end gets what,
sealed or not, a byte of length, and the bytes. Its ends live on over many inputs; the inputs since
they were made are kept and written beside the corpus when something is found.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(
    include=["rgbd_wire", "edge_service.transport", "drone_client.link"]
):
    from rgbd_wire.envelope import Kind, seal, unseal
    from tests.data.tunnel import make
    from tests.perf.fuzz_ends import DRONE, Ends
    from tests.perf.fuzz_tunnel import true_shards
    from tests.perf.fuzz_wire import mutant, receive, seeds

MS = 1_000_000
INPUTS_PER_ENDS = 2000
MAX_STEPS = 32
RSS_LIMIT_MB = 1024
TIMEOUT_S = 10


class Tunnel:
    """Plays inputs to a pair of ends."""

    max_bytes = 4096

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._ends: Ends | None = None
        self._played: list[bytes] = []

    def seeds(self) -> list[bytes]:
        """Words and shards for each end, and what nobody sealed."""
        rng = random.Random(1)
        programs = []
        for path in sorted(make.HERE.glob("*.bin")):
            data = path.read_bytes()[:255]
            programs += [bytes([op, len(data)]) + data for op in (0, 1)]
        for name in make.WORDS:
            inner = (make.HERE / f"word_{name}.bin").read_bytes()
            programs += [bytes([op, len(inner)]) + inner for op in (2, 3)]
        for op in (4, 5):
            programs += [bytes([op, 8]) + rng.randbytes(8) for _ in range(4)]
        return [p + b"\x06\x01\x20" for p in programs]

    def play(self, data: bytes) -> None:
        """One input; time passes after it.

        Raises:
            BaseException: what was looked for.
        """
        if self._ends is None or len(self._played) >= INPUTS_PER_ENDS:
            if self._ends is not None:
                self._ends.close()
            self._ends = Ends(make.PSK, self._on_message)
            self._played = []
        ends = self._ends
        self._played.append(data)
        if ends.session is None or not ends.line.up:
            ends.connect()
        at = 0
        for _ in range(MAX_STEPS):
            if at + 2 > len(data) or ends.session is None:
                break
            op, size = data[at], data[at + 1]
            self._step(ends, op % 8, data[at + 2 : at + 2 + size])
            at += 2 + size
        ends.step(MS)
        ends.deliver()
        ends.check()

    def save(self) -> Path:
        """All inputs since the ends were made."""
        path = self._folder / "played.bin"
        path.write_bytes(b"".join(len(d).to_bytes(4, "little") + d for d in self._played))
        return path

    def _step(self, ends: Ends, op: int, what: bytes) -> None:
        if not what:
            return
        session = ends.session
        if session is None or op < 2:
            if op % 2:
                ends.to_drone([what], len(what))
            else:
                ends.to_worker([what], len(what), ("192.0.2.1", what[-1]))
            return
        up, down = ends.sealers
        place = ends.line.sock.place  # type: ignore[attr-defined]
        match op:
            case 2:
                ends.to_worker([up.seal(what)], 1200, place)
            case 3:
                ends.to_drone([down.seal(what)], 1200, ends.line.sock)
            case 4 | 5:  # a message of somebody honest, pieces of it, in an order
                shards = true_shards(random.Random(what))
                sealer = up if op == 4 else down
                datagrams = sealer.seal_all(shards)
                if op == 4:
                    ends.to_worker(datagrams, len(datagrams[0]), place)
                else:
                    ends.to_drone(datagrams, len(datagrams[0]), ends.line.sock)
            case 6:
                ends.step(what[0] * MS)
                ends.deliver()
            case 7:
                ends.drone.send("worker-a", what * 20, 10**9)
                ends.step(0)
                ends.forget()  # lost, to be asked for

    def _on_message(self, message: bytes) -> None:
        assert self._ends is not None
        self._ends.worker.send(DRONE, message[:500])


class Messages:
    """Gives messages to a receiver."""

    max_bytes = 200_000

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._last = b""

    def seeds(self) -> list[bytes]:
        """The test vectors."""
        return seeds()

    def play(self, data: bytes) -> None:
        """One message."""
        self._last = data
        receive(data)

    def save(self) -> Path:
        """The last one."""
        path = self._folder / "message.bin"
        path.write_bytes(self._last)
        return path


def resealed(data: bytes, max_bytes: int, seed: int) -> bytes:
    """A mutant whose checksum is right, unless the library's own mutation spoils it."""
    rng = random.Random(seed)
    try:
        kind, body = unseal(data, *Kind)
        if rng.random() < 0.5:
            return mutant(data, rng)[:max_bytes]
        return seal(kind, atheris.Mutate(bytes(body), max(1, max_bytes - 64)))[:max_bytes]
    except Exception:  # what is mutated already may be no message, or no MessagePack
        return bytes(atheris.Mutate(data, max_bytes))


def main() -> None:
    """``TARGET SECONDS SEED``."""
    name, seconds, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    folder = Path(tempfile.gettempdir()) / "aerial-fuzz" / name
    corpus = folder / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    target = Tunnel(folder) if name == "tunnel" else Messages(folder)
    for number, data in enumerate(target.seeds()):
        (corpus / f"seed-{number}").write_bytes(data)

    def one(data: bytes) -> None:
        try:
            target.play(data)
        except BaseException as error:  # a panic of a library in Rust is no Exception
            raise RuntimeError(f"found; see {target.save()}") from error

    options = [
        f"-max_total_time={seconds}",
        f"-seed={seed + 1}",
        f"-max_len={target.max_bytes}",
        f"-rss_limit_mb={RSS_LIMIT_MB}",
        f"-timeout={TIMEOUT_S}",
        f"-artifact_prefix={folder}/",
        "-print_final_stats=1",
    ]
    mutator: dict[str, Callable[[bytes, int, int], bytes]] = {}
    if name == "messages":
        mutator["custom_mutator"] = resealed
    atheris.Setup([sys.argv[0], *options, str(corpus)], one, **mutator)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
