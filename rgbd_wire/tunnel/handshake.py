"""The handshake: INIT, COOKIE, HELLO, WELCOME; every answer is shorter than what it answers.

::

    INIT    u8 type, 16 nonce, zeros up to 64 bytes
    COOKIE  u8 type, 16 nonce, 20 cookie (u32 time bucket, 16 MAC)               37 bytes
    HELLO   u8 type, 16 nonce, 20 cookie, 32 X25519 public key, u8 ciphers,
            u8 length of the name, 32 name, zeros, 32 MAC                       160 bytes
    WELCOME u8 type, 16 nonce, u64 session, 32 X25519 public key, u8 cipher,
            u8 length of the worker's name, 32 name, 32 MAC                     123 bytes

A worker keeps nothing until the MAC of a HELLO has proved that its sender holds the drone's key.
The keys of a session need both the drone's key and the X25519 secret, which both sides forget:
whoever steals the key file later cannot read what was recorded.
"""

from __future__ import annotations

import hmac
import re
import struct
from dataclasses import dataclass, field
from hashlib import sha256

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from rgbd_wire.tunnel.errors import Refusal, TunnelError
from rgbd_wire.tunnel.packet import Type, first_byte
from rgbd_wire.tunnel.seal import KEY_BYTES, NONCE_PREFIX_BYTES, Cipher, DirectionKey

NONCE_BYTES = 16
INIT_BYTES = 64
COOKIE_BUCKET_NS = 4_000_000_000
"""A cookie is taken in the bucket that made it and in the next one: for 4 to 8 s."""
COOKIE_AGE_NS = 2 * COOKIE_BUCKET_NS
MAC_BYTES = 32
HELLO_BYTES = 160
NAME_BYTES = 32
_COOKIE = struct.Struct("<I16s")
_COOKIE_PACKET = struct.Struct("<B16s20s")
_HELLO = struct.Struct("<B16s20s32sBB32s")
_WELCOME = struct.Struct("<B16sQ32sBB32s")
WELCOME_BYTES = _WELCOME.size + MAC_BYTES
assert _COOKIE_PACKET.size <= INIT_BYTES
assert WELCOME_BYTES <= HELLO_BYTES
_NAME = re.compile(rb"[a-z0-9][a-z0-9_-]{0,31}")


@dataclass(frozen=True, slots=True)
class SessionKeys:
    """What both sides hold after the handshake."""

    session: int
    cipher: Cipher
    up: DirectionKey
    down: DirectionKey


@dataclass(frozen=True, slots=True)
class Hello:
    """A HELLO that is well formed; nothing in it is proved yet."""

    nonce: bytes
    cookie: bytes
    public_key: bytes
    ciphers: int
    drone: str
    packet: bytes = field(repr=False)
    """The whole datagram: its MAC covers all but the MAC itself."""


@dataclass(frozen=True, slots=True)
class Welcome:
    """What a WELCOME says, proved."""

    worker: str
    keys: SessionKeys


def pack_init(nonce: bytes) -> bytes:
    """An INIT; it has a length that its answer stays under."""
    return (bytes([first_byte(Type.INIT)]) + nonce).ljust(INIT_BYTES, b"\0")


def parse_init(datagram: bytes | memoryview) -> bytes:
    """The nonce of an INIT.

    Raises:
        TunnelError: MALFORMED.
    """
    if len(datagram) != INIT_BYTES:
        raise TunnelError(Refusal.MALFORMED, f"an INIT of {len(datagram)} bytes")
    return bytes(datagram[1 : 1 + NONCE_BYTES])


def make_cookie(secret: bytes, address: bytes, nonce: bytes, now_ns: int) -> bytes:
    """Proof for a while that a nonce came from an address; nothing is kept of it.

    Args:
        secret: the worker's own, random at each start.
        address: where the INIT came from.
        nonce: of the INIT.
        now_ns: worker's clock.
    """
    return _cookie_of_bucket(secret, address, nonce, now_ns // COOKIE_BUCKET_NS)


def check_cookie(secret: bytes, address: bytes, hello: Hello, now_ns: int) -> None:
    """Refuse a HELLO whose cookie is not of this address and nonce, or too old.

    Raises:
        TunnelError: BAD_COOKIE.
    """
    bucket = now_ns // COOKIE_BUCKET_NS
    given = _COOKIE.unpack(hello.cookie)[0]
    if given not in (bucket & 0xFFFFFFFF, bucket - 1 & 0xFFFFFFFF):
        raise TunnelError(Refusal.BAD_COOKIE, "made too long ago")
    expected = _cookie_of_bucket(secret, address, hello.nonce, given)
    if not hmac.compare_digest(expected, hello.cookie):
        raise TunnelError(Refusal.BAD_COOKIE, "not of this address and nonce")


def pack_cookie(nonce: bytes, cookie: bytes) -> bytes:
    """The answer to an INIT."""
    return _COOKIE_PACKET.pack(first_byte(Type.COOKIE), nonce, cookie)


def parse_cookie(datagram: bytes | memoryview) -> tuple[bytes, bytes]:
    """Nonce and cookie of a COOKIE.

    Raises:
        TunnelError: MALFORMED.
    """
    if len(datagram) != _COOKIE_PACKET.size:
        raise TunnelError(Refusal.MALFORMED, f"a COOKIE of {len(datagram)} bytes")
    _, nonce, cookie = _COOKIE_PACKET.unpack(datagram)
    return nonce, cookie


def pack_hello(
    drone: str, key: bytes, nonce: bytes, cookie: bytes, public_key: bytes, ciphers: Cipher
) -> bytes:
    """A HELLO, signed with the drone's key."""
    name = drone.encode("ascii")
    head = _HELLO.pack(
        first_byte(Type.HELLO), nonce, cookie, public_key, ciphers, len(name), name
    ).ljust(HELLO_BYTES - MAC_BYTES, b"\0")
    return head + _mac(key, b"hello", head)


def parse_hello(datagram: bytes | memoryview) -> Hello:
    """The fields of a HELLO.

    Raises:
        TunnelError: MALFORMED.
    """
    if len(datagram) != HELLO_BYTES:
        raise TunnelError(Refusal.MALFORMED, f"a HELLO of {len(datagram)} bytes")
    packet = bytes(datagram)
    _, nonce, cookie, public_key, ciphers, length, name = _HELLO.unpack_from(packet)
    return Hello(nonce, cookie, public_key, ciphers, _name_of(length, name), packet)


def check_hello(hello: Hello, key: bytes) -> None:
    """Refuse a HELLO that the drone's key did not sign; takes the same time for every MAC.

    Raises:
        TunnelError: BAD_MAC.
    """
    head, mac = hello.packet[:-MAC_BYTES], hello.packet[-MAC_BYTES:]
    if not hmac.compare_digest(_mac(key, b"hello", head), mac):
        raise TunnelError(Refusal.BAD_MAC, f"a HELLO in the name of {hello.drone}")


def answer_hello(
    hello: Hello, key: bytes, worker: str, session: int, cipher: Cipher, private: X25519PrivateKey
) -> tuple[bytes, SessionKeys]:
    """The WELCOME to a HELLO that was checked, and the session's keys.

    Args:
        hello: what is answered.
        key: the drone's.
        worker: this worker's name.
        session: random, of 64 bits, not in use.
        cipher: the chosen one.
        private: fresh, used once.

    Raises:
        TunnelError: BAD_MAC, the public key is of a small order.
    """
    name = worker.encode("ascii")
    head = _WELCOME.pack(
        first_byte(Type.WELCOME),
        hello.nonce,
        session,
        private.public_key().public_bytes_raw(),
        cipher,
        len(name),
        name,
    )
    packet = head + _mac(key, b"welcome", hello.packet + head)
    shared = _exchange(private, hello.public_key)
    return packet, _derive(key, shared, hello.packet + packet, session, cipher)


def open_welcome(
    datagram: bytes | memoryview, hello: Hello, key: bytes, private: X25519PrivateKey
) -> Welcome:
    """What a WELCOME says, once it proved to answer our HELLO.

    Raises:
        TunnelError: MALFORMED, BAD_MAC or NO_CIPHER (one that was not offered).
    """
    if len(datagram) != WELCOME_BYTES:
        raise TunnelError(Refusal.MALFORMED, f"a WELCOME of {len(datagram)} bytes")
    packet = bytes(datagram)
    head, mac = packet[:-MAC_BYTES], packet[-MAC_BYTES:]
    if not hmac.compare_digest(_mac(key, b"welcome", hello.packet + head), mac):
        raise TunnelError(Refusal.BAD_MAC, "a WELCOME that does not answer our HELLO")
    _, _, session, public_key, number, length, name = _WELCOME.unpack(head)
    if number not in (Cipher.AES_256_GCM, Cipher.CHACHA20_POLY1305) or not number & hello.ciphers:
        raise TunnelError(Refusal.NO_CIPHER, f"cipher {number}")
    shared = _exchange(private, public_key)
    keys = _derive(key, shared, hello.packet + packet, session, Cipher(number))
    return Welcome(_name_of(length, name), keys)


def _cookie_of_bucket(secret: bytes, address: bytes, nonce: bytes, bucket: int) -> bytes:
    bucket &= 0xFFFFFFFF
    text = b"cookie" + bucket.to_bytes(4, "little") + nonce + address
    return _COOKIE.pack(bucket, hmac.digest(secret, text, "sha256")[:16])


def _mac(key: bytes, purpose: bytes, text: bytes) -> bytes:
    # Its own key per purpose, so that no MAC can stand for another
    return hmac.digest(hmac.digest(key, b"aerial tunnel v1 " + purpose, "sha256"), text, "sha256")


def _name_of(length: int, padded: bytes) -> str:
    name = padded[:length]
    if length > NAME_BYTES or not _NAME.fullmatch(name) or padded[length:].strip(b"\0"):
        raise TunnelError(Refusal.MALFORMED, "a name that is none")
    return name.decode("ascii")


def _exchange(private: X25519PrivateKey, public_key: bytes) -> bytes:
    try:
        return private.exchange(X25519PublicKey.from_public_bytes(public_key))
    except ValueError:
        raise TunnelError(Refusal.BAD_MAC, "a public key of small order") from None


def _derive(
    key: bytes, shared: bytes, transcript: bytes, session: int, cipher: Cipher
) -> SessionKeys:
    one = KEY_BYTES + NONCE_PREFIX_BYTES
    okm = HKDF(
        SHA256(), 2 * one, salt=sha256(transcript).digest(), info=b"aerial tunnel v1 keys"
    ).derive(key + shared)
    up, down = okm[:one], okm[one:]
    return SessionKeys(
        session,
        cipher,
        DirectionKey(up[:KEY_BYTES], up[KEY_BYTES:]),
        DirectionKey(down[:KEY_BYTES], down[KEY_BYTES:]),
    )
