"""The handshake: sizes, transcripts, cookies, words."""

from __future__ import annotations

import contextlib

import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from hypothesis import given, settings
from hypothesis import strategies as st

from rgbd_wire.tunnel.endpoint import parse_endpoint
from rgbd_wire.tunnel.errors import EndpointError, TunnelError
from rgbd_wire.tunnel.handshake import (
    COOKIE_BUCKET_NS,
    HELLO_BYTES,
    INIT_BYTES,
    WELCOME_BYTES,
    Hello,
    answer_hello,
    check_cookie,
    check_hello,
    make_cookie,
    open_welcome,
    pack_cookie,
    pack_hello,
    pack_init,
    parse_cookie,
    parse_hello,
    parse_init,
)
from rgbd_wire.tunnel.inner import Goodbye, Nack, Ping, Report, Word, pack_word, parse_word
from rgbd_wire.tunnel.seal import Cipher

KEY, SECRET, NONCE, PLACE = b"k" * 32, b"s" * 32, b"n" * 16, b"('192.0.2.7', 4000)"
BOTH = Cipher.AES_256_GCM | Cipher.CHACHA20_POLY1305
DRONE_PRIVATE = X25519PrivateKey.from_private_bytes(b"d" * 32)
WORKER_PRIVATE = X25519PrivateKey.from_private_bytes(b"w" * 32)


def hello_packet() -> bytes:
    public_key = DRONE_PRIVATE.public_key().public_bytes_raw()
    return pack_hello("drone-1", KEY, NONCE, make_cookie(SECRET, PLACE, NONCE, 0), public_key, BOTH)


def welcome_packet(hello: Hello) -> bytes:
    return answer_hello(hello, KEY, "worker-a", 99, Cipher.AES_256_GCM, WORKER_PRIVATE)[0]


def test_both_sides_get_the_same_keys() -> None:
    """A whole handshake ends with equal keys on both sides, another one for each direction."""
    nonce = parse_init(pack_init(NONCE))
    said, cookie = parse_cookie(pack_cookie(nonce, make_cookie(SECRET, PLACE, nonce, 0)))
    assert said == NONCE
    public_key = DRONE_PRIVATE.public_key().public_bytes_raw()
    hello = parse_hello(pack_hello("drone-1", KEY, NONCE, cookie, public_key, BOTH))
    assert hello.drone == "drone-1"
    check_cookie(SECRET, PLACE, hello, 0)
    check_hello(hello, KEY)
    packet, keys = answer_hello(
        hello, KEY, "worker-a", 99, Cipher.CHACHA20_POLY1305, WORKER_PRIVATE
    )
    welcome = open_welcome(packet, hello, KEY, DRONE_PRIVATE)
    assert welcome.worker == "worker-a"
    assert welcome.keys == keys
    assert keys.up != keys.down


def test_no_answer_is_longer_than_what_it_answers() -> None:
    """COOKIE is shorter than INIT, WELCOME than HELLO: nothing to amplify with."""
    assert len(pack_cookie(NONCE, bytes(20))) < INIT_BYTES == len(pack_init(NONCE))
    assert WELCOME_BYTES < HELLO_BYTES == len(hello_packet())


def test_every_flipped_bit_of_a_hello_is_refused() -> None:
    """A HELLO is taken whole or not at all."""
    packet = hello_packet()
    for bit in range(8, 8 * len(packet)):
        damaged = bytearray(packet)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(TunnelError):
            check_hello(parse_hello(bytes(damaged)), KEY)


def test_every_flipped_bit_of_a_welcome_is_refused() -> None:
    """A WELCOME is taken whole or not at all."""
    hello = parse_hello(hello_packet())
    packet = welcome_packet(hello)
    for bit in range(8, 8 * len(packet)):
        damaged = bytearray(packet)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(TunnelError):
            open_welcome(bytes(damaged), hello, KEY, DRONE_PRIVATE)


def test_a_welcome_answers_one_hello_only() -> None:
    """A recorded WELCOME is no answer to the next HELLO, nor one under another key."""
    hello = parse_hello(hello_packet())
    packet = welcome_packet(hello)
    public_key = DRONE_PRIVATE.public_key().public_bytes_raw()
    other = parse_hello(pack_hello("drone-1", KEY, b"m" * 16, bytes(20), public_key, BOTH))
    for asked, key in ((other, KEY), (hello, b"x" * 32)):
        with pytest.raises(TunnelError, match="bad_mac"):
            open_welcome(packet, asked, key, DRONE_PRIVATE)


def test_a_cipher_that_was_not_offered_is_refused() -> None:
    """A worker cannot choose what the drone did not offer."""
    public_key = DRONE_PRIVATE.public_key().public_bytes_raw()
    offered = Cipher.CHACHA20_POLY1305
    hello = parse_hello(pack_hello("drone-1", KEY, NONCE, bytes(20), public_key, offered))
    with pytest.raises(TunnelError, match="no_cipher"):
        open_welcome(welcome_packet(hello), hello, KEY, DRONE_PRIVATE)


def test_a_public_key_of_small_order_is_refused() -> None:
    """A shared secret that everybody knows never comes about."""
    hello = parse_hello(pack_hello("drone-1", KEY, NONCE, bytes(20), bytes(32), BOTH))
    with pytest.raises(TunnelError, match="bad_mac"):
        welcome_packet(hello)


@pytest.mark.parametrize("now_buckets", [2, 3, 1 << 20])
def test_an_old_cookie_is_refused(now_buckets: int) -> None:
    """A cookie is good in its own bucket of time and in the next one."""
    hello = parse_hello(hello_packet())
    check_cookie(SECRET, PLACE, hello, COOKIE_BUCKET_NS * 2 - 1)
    with pytest.raises(TunnelError, match="too long ago"):
        check_cookie(SECRET, PLACE, hello, COOKIE_BUCKET_NS * now_buckets)


def test_a_cookie_is_of_one_address_one_nonce_and_one_worker() -> None:
    """Somebody else's cookie is refused."""
    hello = parse_hello(hello_packet())
    for secret, place in ((SECRET, b"elsewhere"), (b"x" * 32, PLACE)):
        with pytest.raises(TunnelError, match="bad_cookie"):
            check_cookie(secret, place, hello, 0)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_packet_or_refused(data: bytes) -> None:
    """No datagram makes a parser fail in another way than by its own error."""
    for parse in (parse_init, parse_cookie, parse_hello):
        with contextlib.suppress(TunnelError):
            parse(data)


@settings(max_examples=200)
@given(st.binary(min_size=HELLO_BYTES, max_size=HELLO_BYTES))
def test_any_hello_of_the_right_size_is_refused(data: bytes) -> None:
    """Only who holds the key makes one that is taken."""
    with pytest.raises(TunnelError):
        check_hello(parse_hello(data), KEY)


U24, U16, U32, U40 = (st.integers(0, 2**n - 1) for n in (24, 16, 32, 40))
WORDS: st.SearchStrategy[Word] = st.one_of(
    st.builds(Nack, U24, st.integers(1, 2), st.integers(1, 65535), U16),
    st.builds(Report, U24, st.booleans(), U16, U16, U32, U32),
    st.builds(Ping, st.booleans(), st.integers(0, 2**64 - 1), U32, U40, U40),
    st.just(Goodbye()),
)


@given(WORDS)
def test_words_come_back(word: Word) -> None:
    """Every word of the tunnel reads back as it was."""
    assert parse_word(pack_word(word)) == word


@given(st.binary(min_size=1, max_size=40))
def test_any_inner_bytes_are_a_word_or_refused(data: bytes) -> None:
    """What is parsed packs to the same bytes; everything else is refused."""
    with contextlib.suppress(TunnelError):
        assert pack_word(parse_word(data)) == data


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("udp/192.0.2.7:7448", ("192.0.2.7", 7448)),
        ("udp/[2001:db8::7]:1", ("2001:db8::7", 1)),
        ("udp/worker.example:65535", ("worker.example", 65535)),
    ],
)
def test_endpoints(text: str, place: tuple[str, int]) -> None:
    """Numbers of both families and names are endpoints."""
    assert parse_endpoint(text) == place


@pytest.mark.parametrize("text", ["", "tcp/a:1", "udp/a", "udp/a:65536", "udp/:1", "udp/a b:1"])
def test_what_is_no_endpoint_is_told_how_one_looks(text: str) -> None:
    """The error says what an endpoint looks like."""
    with pytest.raises(EndpointError, match=r"is not udp/HOST:PORT; such as udp/192\.0\.2\.7:7448"):
        parse_endpoint(text)
    with pytest.raises(EndpointError, match=r"did you mean udp/192\.0\.2\.7:1\?"):
        parse_endpoint("192.0.2.7:1")
