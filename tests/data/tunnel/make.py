"""Write the test vectors of the UDP tunnel beside this file.

``python tests/data/tunnel/make.py`` rewrites them; that is called for only when the version of the
tunnel changes. All that is random in flight is fixed here, so that another implementation can
compute every byte: keys, nonces, X25519 private keys, and a message that is a formula.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from rgbd_wire.tunnel.handshake import (
    COOKIE_BUCKET_NS,
    answer_hello,
    make_cookie,
    pack_cookie,
    pack_hello,
    pack_init,
    parse_hello,
)
from rgbd_wire.tunnel.inner import Goodbye, Nack, Ping, Report, pack_word
from rgbd_wire.tunnel.packet import Type, pack_reset
from rgbd_wire.tunnel.seal import Cipher, Sealer
from rgbd_wire.tunnel.shards import Outgoing

HERE = Path(__file__).parent
PSK = bytes(range(32))
COOKIE_SECRET = bytes(range(32, 64))
NONCE = bytes(range(64, 80))
DRONE_PRIVATE = bytes(range(96, 128))
WORKER_PRIVATE = bytes(range(128, 160))
SESSION = 0x0123_4567_89AB_CDEF
ADDRESS = b"('192.0.2.7', 40000)"
NOW_NS = 5 * COOKIE_BUCKET_NS + 1
BOTH = Cipher.AES_256_GCM | Cipher.CHACHA20_POLY1305
MESSAGE_BYTES, MESSAGE_ID, PARITY = 3000, 0x0A0B0C, 2
WORDS = {
    "nack": Nack(MESSAGE_ID, 1, 7, 3),
    "report": Report(MESSAGE_ID, True, 5, 1, 2456, 4000),
    "goodbye": Goodbye(),
    "ping": Ping(False, 123_456_789_012_345, 20_500, 1000, 990),
    "pong": Ping(True, 123_456_789_012_345, 20_500, 2000, 1980),
}


def message() -> bytes:
    """Byte i is 7 i + floor(i / 256), modulo 256."""
    return bytes((7 * i + i // 256) % 256 for i in range(MESSAGE_BYTES))


def build() -> tuple[dict[str, bytes], dict[str, Any]]:
    """Every file's bytes, and what the JSON says of them."""
    drone, worker = (
        X25519PrivateKey.from_private_bytes(key) for key in (DRONE_PRIVATE, WORKER_PRIVATE)
    )
    cookie = make_cookie(COOKIE_SECRET, ADDRESS, NONCE, NOW_NS)
    public_key = drone.public_key().public_bytes_raw()
    hello = pack_hello("drone-1", PSK, NONCE, cookie, public_key, BOTH)
    files = {
        "init": pack_init(NONCE),
        "cookie": pack_cookie(NONCE, cookie),
        "hello": hello,
        "reset": pack_reset(SESSION),
    }
    described: dict[str, Any] = {
        "psk": PSK.hex(),
        "nonce": NONCE.hex(),
        "drone_private_key": DRONE_PRIVATE.hex(),
        "worker_private_key": WORKER_PRIVATE.hex(),
        "session": f"{SESSION:016x}",
        "drone": "drone-1",
        "worker": "worker-a",
        "ciphers_offered": int(BOTH),
        "message": {
            "formula": message.__doc__,
            "bytes": MESSAGE_BYTES,
            "message_id": MESSAGE_ID,
            "parity": PARITY,
        },
        "words": {n: {"kind": type(w).__name__, **asdict(w)} for n, w in WORDS.items()},
        "sealed": "UP, AES-256-GCM: packets 0 to 4 are shards 0 to 4 of the message",
        "keys": {},
    }
    for cipher in (Cipher.AES_256_GCM, Cipher.CHACHA20_POLY1305):
        name = cipher.name.lower() if cipher.name else ""
        packet, keys = answer_hello(parse_hello(hello), PSK, "worker-a", SESSION, cipher, worker)
        files[f"welcome_{name}"] = packet
        described["keys"][name] = {
            "up_key": keys.up.key.hex(),
            "up_nonce_prefix": keys.up.nonce_prefix.hex(),
            "down_key": keys.down.key.hex(),
            "down_nonce_prefix": keys.down.nonce_prefix.hex(),
        }
        files[f"down_goodbye_{name}"] = Sealer(Type.DOWN, SESSION, cipher, keys.down).seal(
            pack_word(Goodbye())
        )
        if cipher is Cipher.AES_256_GCM:
            sealer = Sealer(Type.UP, SESSION, cipher, keys.up)
    outgoing = Outgoing(message(), MESSAGE_ID, PARITY, 0, 0)
    shards = outgoing.take(outgoing.symbols) + outgoing.take(PARITY)
    for i, shard in enumerate(shards):
        files[f"shard_{i}"] = shard
        files[f"up_{i}"] = sealer.seal(shard)
    files |= {f"word_{name}": pack_word(word) for name, word in WORDS.items()}
    return files, described


def main() -> None:
    """Write every vector and their description."""
    files, described = build()
    for name, data in files.items():
        (HERE / f"{name}.bin").write_bytes(data)
    described["files"] = {f"{name}.bin": len(data) for name, data in files.items()}
    (HERE / "vectors.json").write_text(json.dumps(described, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
