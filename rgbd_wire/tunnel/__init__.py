"""The UDP tunnel: sealed datagrams, erasure coding, one handshake (docs/protocol.md).

Pure, bytes and times in and bytes out, but for ``datagrams``, ``channel``, ``pump`` and ``keys``.
"""
