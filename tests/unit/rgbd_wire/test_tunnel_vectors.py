"""The test vectors in ``tests/data/tunnel``: what other implementations are held against."""

from __future__ import annotations

import json
import random

import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from rgbd_wire.tunnel.errors import Counters
from rgbd_wire.tunnel.handshake import check_hello, open_welcome, parse_hello
from rgbd_wire.tunnel.inner import parse_word
from rgbd_wire.tunnel.packet import Type
from rgbd_wire.tunnel.partials import Partials
from rgbd_wire.tunnel.seal import Opener
from tests.data.tunnel import make

DESCRIBED = json.loads((make.HERE / "vectors.json").read_text(encoding="utf-8"))


def read(name: str) -> bytes:
    return (make.HERE / f"{name}.bin").read_bytes()


def test_this_version_writes_the_vectors() -> None:
    """Every byte of every file is what the code makes of the fixed inputs."""
    files, described = make.build()
    assert {name: read(name) for name in files} == files
    assert {path.stem for path in make.HERE.glob("*.bin")} == set(files)
    described["files"] = DESCRIBED["files"]
    assert described == DESCRIBED


@pytest.mark.parametrize("cipher", ["aes_256_gcm", "chacha20_poly1305"])
def test_a_drone_reads_the_handshake(cipher: str) -> None:
    """From the private key and the packets alone: the keys that the JSON gives."""
    hello = parse_hello(read("hello"))
    psk = bytes.fromhex(DESCRIBED["psk"])
    check_hello(hello, psk)
    private = X25519PrivateKey.from_private_bytes(bytes.fromhex(DESCRIBED["drone_private_key"]))
    welcome = open_welcome(read(f"welcome_{cipher}"), hello, psk, private)
    keys = DESCRIBED["keys"][cipher]
    assert welcome.worker == DESCRIBED["worker"]
    assert welcome.keys.up.key.hex() == keys["up_key"]
    assert welcome.keys.down.nonce_prefix.hex() == keys["down_nonce_prefix"]
    opener = Opener(Type.DOWN, make.SESSION, welcome.keys.cipher, welcome.keys.down)
    goodbye = memoryview(read(f"down_goodbye_{cipher}"))
    assert opener.open_all(goodbye, len(goodbye), Counters()) == [read("word_goodbye")]


def test_a_worker_reads_the_message_with_two_datagrams_lost() -> None:
    """Three symbols of data, two of parity; any order; the message is the formula."""
    hello, psk = parse_hello(read("hello")), bytes.fromhex(DESCRIBED["psk"])
    private = X25519PrivateKey.from_private_bytes(make.DRONE_PRIVATE)
    keys = open_welcome(read("welcome_aes_256_gcm"), hello, psk, private).keys
    opener = Opener(Type.UP, keys.session, keys.cipher, keys.up)
    partials = Partials(Counters())
    order = [4, 3, 1]
    random.Random(1).shuffle(order)
    messages = []
    for i in order:
        datagram = memoryview(read(f"up_{i}"))
        (inner,) = opener.open_all(datagram, len(datagram), Counters())
        assert inner == read(f"shard_{i}")
        messages.append(partials.add(inner, 0))
    assert messages[:2] == [None, None]
    assert messages[2] == make.message()


@pytest.mark.parametrize("name", list(make.WORDS))
def test_words(name: str) -> None:
    """Each word reads as the JSON describes it."""
    assert parse_word(read(f"word_{name}")) == make.WORDS[name]
