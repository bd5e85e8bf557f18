"""What a JPEG XL file says of itself, read before its decoder runs.

JPEG XL can do far more than a depth picture needs: hidden layers, animations, patches. A layer of
1 kB costs the decoder a fifth of a second on the largest picture, so 50 kB can hold a worker for
ten seconds. Here the bits up to "this frame is the last" are read, and all but one plain 16-bit
grey picture in one modular frame is refused (ISO/IEC 18181-1, image and frame header).
"""

from __future__ import annotations

from rgbd_wire.errors import DecodeError, Reject

_BARE = b"\xff\x0a"
_PLAIN_BOXES = (b"JXL ", b"ftyp", b"jxll")
_CODESTREAM_BOX = b"jxlc"
_HEADER_BYTES = 64
_SIDE_BITS = (9, 13, 18, 30)
_ANY = None

# Field, bits, what it may hold. A length of two bits often selects how a value goes on; what is
# allowed here never goes on.
_IMAGE_FIELDS: tuple[tuple[str, int, tuple[int, ...] | None], ...] = (
    ("all_default", 1, (0,)),
    ("extra_fields", 1, (0,)),  # orientation, preview, animation
    ("float_sample", 1, (0,)),
    ("bits_per_sample", 8, (15 << 2 | 3,)),  # 16 bits
    ("modular_16bit_buffers", 1, _ANY),
    ("num_extra_channels", 2, (0,)),
    ("xyb_encoded", 1, (0,)),
    ("colour_encoding.all_default", 1, (0,)),
    ("want_icc", 1, (0,)),
    ("colour_space", 2, (1,)),  # grey
    ("white_point", 2, (1,)),  # D65
    ("have_gamma", 1, (0,)),
    ("transfer_function", 6, tuple(n << 2 | 2 for n in range(16))),  # any of 2 to 17
    ("rendering_intent", 2, (0, 1)),
    ("extensions", 2, (0,)),
    ("default_m", 1, (1,)),
)
_FRAME_FIELDS: tuple[tuple[str, int, tuple[int, ...] | None], ...] = (
    ("frame.all_default", 1, (0,)),
    ("frame_type", 2, (0,)),  # regular
    ("encoding", 1, (1,)),  # modular
    ("flags", 2, (0,)),  # no noise, patches, splines
    ("do_ycbcr", 1, (0,)),
    ("upsampling", 2, (0,)),
    ("group_size_shift", 2, _ANY),
    ("num_passes", 2, (0,)),  # one
    ("have_crop", 1, (0,)),
    ("blending", 2, (0,)),  # replace
    ("is_last", 1, (1,)),
)


def check_plain_picture(data: bytes | memoryview) -> None:
    """Refuse a JPEG XL file that is more than one plain 16-bit grey picture in a single frame.

    Raises:
        DecodeError: BAD_DEPTH, with the field at fault.
    """
    bits = _Bits(_codestream(memoryview(data))[:_HEADER_BYTES])
    bits.skip(8 * len(_BARE))
    _skip_size(bits)
    bits.check(_IMAGE_FIELDS)
    bits.align()
    bits.check(_FRAME_FIELDS)


class _Bits:
    """Bits of a header, the lowest of each byte first; zeros past its end."""

    def __init__(self, data: memoryview) -> None:
        self._value = int.from_bytes(data, "little")
        self._at = 0

    def read(self, count: int) -> int:
        value = self._value >> self._at & ((1 << count) - 1)
        self._at += count
        return value

    def skip(self, count: int) -> None:
        self._at += count

    def align(self) -> None:
        self._at = (self._at + 7) // 8 * 8

    def check(self, fields: tuple[tuple[str, int, tuple[int, ...] | None], ...]) -> None:
        for name, count, allowed in fields:
            value = self.read(count)
            if allowed is not None and value not in allowed:
                raise _refusal(f"{name} is {value:#x}")


def _skip_size(bits: _Bits) -> None:
    """Pass over the picture's size, which the codec compares with the one announced."""
    small = bits.read(1)
    for ratio_follows in (True, False):
        bits.skip(5 if small else _SIDE_BITS[bits.read(2)])
        if ratio_follows and bits.read(3) != 0:  # the width follows from the height
            return


def _codestream(view: memoryview) -> memoryview:
    """The codestream, bare or as the last box of a container that holds no other pictures."""
    if view[:2] == _BARE:
        return view
    at = 0
    for _ in range(len(_PLAIN_BOXES) + 1):
        length, kind = int.from_bytes(view[at : at + 4], "big"), bytes(view[at + 4 : at + 8])
        if (
            kind == _CODESTREAM_BOX
            and length in (0, len(view) - at)
            and view[at + 8 :][:2] == _BARE
        ):
            return view[at + 8 :]
        if kind not in _PLAIN_BOXES or length < 8:
            break
        at += length
    raise _refusal(f"no codestream where one is expected, byte {at}")


def _refusal(detail: str) -> DecodeError:
    return DecodeError(Reject.BAD_DEPTH, f"not a plain 16-bit grey JPEG XL: {detail}")
