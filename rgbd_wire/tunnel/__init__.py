"""The UDP tunnel: sealed datagrams, erasure coding, one handshake (docs/protocol.md).

Everything here but ``datagrams`` and ``channel`` is pure: bytes and times in, bytes out.
"""
