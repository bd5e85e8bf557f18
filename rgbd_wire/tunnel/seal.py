"""Sealing and opening datagrams: AES-256-GCM, or ChaCha20-Poly1305 where the CPU has no AES."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntFlag
from functools import cache
from pathlib import Path
from typing import TypeAlias

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM, ChaCha20Poly1305

from rgbd_wire.tunnel.errors import Counters, Refusal, TunnelError
from rgbd_wire.tunnel.packet import (
    MAX_PACKET_NUMBER,
    OUTER_BYTES,
    TAG_BYTES,
    Type,
    outer_prefix,
)
from rgbd_wire.tunnel.replay_window import ReplayWindow

KEY_BYTES = 32
NONCE_PREFIX_BYTES = 7
Aead: TypeAlias = AESGCM | ChaCha20Poly1305


class Cipher(IntFlag):
    """What seals a session; a HELLO offers a set of them."""

    AES_256_GCM = 1
    CHACHA20_POLY1305 = 2


@dataclass(frozen=True, slots=True)
class DirectionKey:
    """What seals one direction of one session."""

    key: bytes
    """32 bytes."""
    nonce_prefix: bytes
    """7 bytes; the nonce is these and the 5 bytes of the packet number as on the wire."""

    def __repr__(self) -> str:
        """Keys never show."""
        return "DirectionKey(...)"


def make_aead(cipher: Cipher, key: bytes) -> Aead:
    """The cipher with its key."""
    return AESGCM(key) if cipher is Cipher.AES_256_GCM else ChaCha20Poly1305(key)


@cache
def offered_ciphers() -> Cipher:
    """What a HELLO of this machine offers: AES only if the CPU computes it in hardware."""
    try:
        words = set(Path("/proc/cpuinfo").read_text(encoding="utf-8").lower().split())
    except (OSError, UnicodeDecodeError):
        words = {"aes"}
    both = Cipher.AES_256_GCM | Cipher.CHACHA20_POLY1305
    return both if "aes" in words else Cipher.CHACHA20_POLY1305


def choose_cipher(offered: int, wanted: Cipher) -> Cipher:
    """The cipher of a session: AES if both sides compute it in hardware, else ChaCha.

    Args:
        offered: bits of the HELLO; unknown ones are left out.
        wanted: what this side would offer itself.

    Raises:
        TunnelError: NO_CIPHER, none that this side knows.
    """
    if Cipher.AES_256_GCM & offered & wanted:
        return Cipher.AES_256_GCM
    if Cipher.CHACHA20_POLY1305 & offered:
        return Cipher.CHACHA20_POLY1305
    if Cipher.AES_256_GCM & offered:
        return Cipher.AES_256_GCM
    raise TunnelError(Refusal.NO_CIPHER, f"offered {offered:#x}")


class Sealer:
    """Seals one direction; every packet has the next number and so its own nonce."""

    def __init__(self, kind: Type, session: int, cipher: Cipher, key: DirectionKey) -> None:
        self.prefix = outer_prefix(kind, session)
        self.nonce_prefix = key.nonce_prefix
        self.encrypt = make_aead(cipher, key.key).encrypt
        self.number = 0
        """Number of the next packet."""

    @property
    def used_up(self) -> bool:
        """No numbers are left; nothing may be sealed any more."""
        return self.number > MAX_PACKET_NUMBER - 65536

    def seal(self, inner: bytes) -> bytes:
        """A whole datagram around an inner message of at most 1170 bytes."""
        tail = self.number.to_bytes(5, "little")
        self.number += 1
        outer = self.prefix + tail
        return outer + self.encrypt(self.nonce_prefix + tail, inner, outer)

    def seal_all(self, inners: Iterable[bytes]) -> list[bytes]:
        """Datagrams around inner messages: the loop over a whole frame, so all in locals."""
        number, prefix, nonce, encrypt = self.number, self.prefix, self.nonce_prefix, self.encrypt
        sealed = []
        for inner in inners:
            tail = number.to_bytes(5, "little")
            outer = prefix + tail
            sealed.append(outer + encrypt(nonce + tail, inner, outer))
            number += 1
        self.number = number
        return sealed


class Opener:
    """Opens one direction: each number once, marked only after it proved authentic."""

    def __init__(self, kind: Type, session: int, cipher: Cipher, key: DirectionKey) -> None:
        self.prefix = outer_prefix(kind, session)
        self.nonce_prefix = key.nonce_prefix
        self.decrypt = make_aead(cipher, key.key).decrypt
        self.window = ReplayWindow()

    def open_all(self, data: memoryview, segment: int, counters: Counters) -> list[bytes]:
        """The inner messages of datagrams that came at once; what is refused is counted.

        Args:
            data: the datagrams.
            segment: length of each, but the last.
            counters: where NOT_AUTHENTIC, REPLAYED, UNKNOWN_SESSION and MALFORMED are counted.
        """
        # The loop over all datagrams of a frame: locals, and no call but the cipher's
        prefix, nonce, decrypt, window = self.prefix, self.nonce_prefix, self.decrypt, self.window
        from_bytes = int.from_bytes
        newest, in_order = window.newest, 0
        inners = []
        size = len(data)
        for start in range(0, size, segment):
            outer = bytes(data[start : start + OUTER_BYTES])
            tail = outer[9:]
            number = from_bytes(tail, "little")
            end = min(start + segment, size)
            if outer[:9] != prefix or end - start <= OUTER_BYTES + TAG_BYTES:
                short = end - start <= OUTER_BYTES + TAG_BYTES
                counters.count(Refusal.MALFORMED if short else Refusal.UNKNOWN_SESSION)
                continue
            if number != newest + 1:
                window.mark_next(in_order)
                in_order = 0
                if not window.is_new(number):
                    counters.count(Refusal.REPLAYED)
                    continue
            try:
                inner = decrypt(nonce + tail, data[start + OUTER_BYTES : end], outer)
            except InvalidTag:
                counters.count(Refusal.NOT_AUTHENTIC)
                continue
            if number == newest + 1:
                in_order += 1
                newest = number
            else:
                window.mark(number)
                newest = window.newest
            inners.append(inner)
        window.mark_next(in_order)
        return inners
