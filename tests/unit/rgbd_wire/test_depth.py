"""Depth: lossless for every 16-bit picture, and bounded against files that lie."""

from __future__ import annotations

import resource
import tracemalloc
from fractions import Fraction

import imagecodecs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rgbd_wire.depth import (
    MAX_DEPTH_UNITS,
    STEPS,
    CodedDepth,
    DepthPlan,
    DepthTable,
    decode_depth,
    encode_depth,
    lattice_values,
)
from rgbd_wire.errors import DecodeError, Reject

D455_LATTICE_M = 380.0 * 0.095 * 32
MILLIMETRE = 0.001

sizes = st.tuples(st.integers(1, 40), st.integers(1, 40))
any_picture = hnp.arrays(np.uint16, sizes)
lattices = st.sampled_from([0.0, 1e-9, 0.3, 57.0 * 0.05 * 32, D455_LATTICE_M, 1e5])
scales = st.sampled_from([1e-5, 0.0002, 0.001, 0.1])


def round_trip(picture, lattice_m, scale_m):
    coded = encode_depth(picture, lattice_m, scale_m)
    height, width = picture.shape
    return coded.table, decode_depth(coded, width, height, lattice_m, scale_m)


def whole(data, table=DepthTable.IDENTITY):
    """A depth picture that was sent as it is."""
    return CodedDepth(table, 1, data, None, b"")


def refusal(data, table=DepthTable.IDENTITY, width=64, height=48, lattice_m=0.0):
    with pytest.raises(DecodeError) as caught:
        decode_depth(whole(data, table), width, height, lattice_m, MILLIMETRE)
    assert caught.value.reason is Reject.BAD_DEPTH
    return caught.value.detail


def jxl(picture):
    return bytes(imagecodecs.jpegxl_encode(picture, lossless=True, effort=1, numthreads=1))


def ramp(width=64, height=48):
    v, u = np.mgrid[:height, :width]
    return (1000 + 10 * u + v).astype(np.uint16)


@given(any_picture, lattices, scales)
def test_any_picture_is_lossless(picture, lattice_m, scale_m):
    """Whatever the values and whatever lattice was claimed, every bit comes back."""
    _, decoded = round_trip(picture, lattice_m, scale_m)
    np.testing.assert_array_equal(decoded, picture)


@given(st.data(), st.sampled_from([(D455_LATTICE_M, 0.001), (91.2, 0.0002), (0.3, 0.001)]))
def test_pictures_on_the_lattice_go_out_as_ranks(data, lattice):
    """A picture of lattice values alone takes the rank table, and is lossless under it."""
    values = lattice_values(*lattice)
    ranks = data.draw(hnp.arrays(np.int64, sizes, elements=st.integers(0, values.size - 1)))
    table, decoded = round_trip(values[ranks], *lattice)
    assert table is DepthTable.LATTICE
    np.testing.assert_array_equal(decoded, values[ranks])


def test_one_value_off_the_lattice_sends_the_picture_as_it_is():
    """A rank can stand for lattice values alone; otherwise nothing is coded."""
    values = lattice_values(D455_LATTICE_M, MILLIMETRE)
    picture = np.resize(values[-500:], (48, 64))
    off = np.setdiff1d(np.arange(values[-500], values[-1]), values)[0]
    picture[20, 30] = off
    table, decoded = round_trip(picture, D455_LATTICE_M, MILLIMETRE)
    assert table is DepthTable.IDENTITY
    np.testing.assert_array_equal(decoded, picture)


def test_ranks_pay(rng):
    """Four metres away, the same noisy wall weighs a third less with ranks than without."""
    values = lattice_values(D455_LATTICE_M, MILLIMETRE)
    disparity = np.linspace(230, 330, 640) + rng.integers(-3, 4, (120, 640))
    picture = np.rint(D455_LATTICE_M / MILLIMETRE / np.rint(disparity)).astype(np.uint16)
    assert np.isin(picture, values).all()
    ranked = encode_depth(picture, D455_LATTICE_M, MILLIMETRE)
    plain = encode_depth(picture, 0.0, MILLIMETRE)
    assert ranked.size_bytes < 0.7 * plain.size_bytes


sides = st.integers(-8, 48)
plans = st.builds(
    DepthPlan,
    st.sampled_from(STEPS),
    st.none() | st.tuples(sides, sides, sides, sides),
    st.none() | st.floats(0.001, 100),
)


@given(any_picture, lattices, scales, plans)
def test_exactly_what_the_plan_says_arrives_and_without_loss(picture, lattice_m, scale_m, plan):
    """Pixel by pixel: in the region, or on the step, and in range, as it was; elsewhere 0."""
    height, width = picture.shape
    coded = encode_depth(picture, lattice_m, scale_m, plan)
    decoded = decode_depth(coded, width, height, lattice_m, scale_m)
    v, u = np.mgrid[:height, :width]
    sent = (u % plan.step == 0) & (v % plan.step == 0)
    if plan.region is not None:
        x0, y0, x1, y1 = plan.region
        sent |= (x0 <= u) & (u < x1) & (y0 <= v) & (v < y1)
    if plan.range_max_m is not None:
        sent &= picture <= plan.range_max_m / scale_m
    np.testing.assert_array_equal(decoded, np.where(sent, picture, 0))
    assert coded.size_bytes == len(coded.coarse) + len(coded.fine)


def test_a_region_saves_bytes(rng):
    """Half outside, quarter outside: each less than the one before, and the region whole."""
    values = lattice_values(D455_LATTICE_M, MILLIMETRE)
    disparity = np.linspace(230, 330, 640) + rng.integers(-3, 4, (480, 640))
    picture = np.rint(D455_LATTICE_M / MILLIMETRE / np.rint(disparity)).astype(np.uint16)
    assert np.isin(picture, values).all()
    sizes = [
        encode_depth(picture, D455_LATTICE_M, MILLIMETRE, DepthPlan(step, (260, 180, 380, 300)))
        for step in STEPS
    ]
    full, half, quarter = (coded.size_bytes for coded in sizes)
    assert half < 0.5 * full
    assert quarter < 0.6 * half


def test_a_region_that_is_everything_is_one_picture(rng):
    """Then nothing is coded twice."""
    picture = rng.integers(0, 2**16, (12, 16), dtype=np.uint16)
    coded = encode_depth(picture, 0.0, MILLIMETRE, DepthPlan(4, (-3, 0, 16, 99)))
    assert coded == encode_depth(picture, 0.0, MILLIMETRE)


@pytest.mark.parametrize("plan", [{"step": 3}, {"step": 0}, {"range_max_m": 0.0}])
def test_plans_that_cannot_be(plan):
    """A step that is no step, a range that is none."""
    with pytest.raises(ValueError, match=r"step|range"):
        DepthPlan(**plan)


@pytest.mark.parametrize(
    ("step", "region", "fine"),
    [
        (1, (0, 0, 8, 8), b"x"),
        (2, (0, 0, 8, 8), b""),
        (2, None, b"x"),
        (2, (8, 0, 8, 8), b"x"),
        (2, (0, 0, 65, 8), b"x"),
        (2, (0, 0, 8, 49), b"x"),
        (2, (0, 0, 8, 8), b"x"),
    ],
)
def test_regions_that_cannot_be(step, region, fine):
    """Outside the picture, empty, without bytes, bytes without it, at full resolution."""
    coarse = jxl(np.ascontiguousarray(ramp()[::step, ::step]))
    with pytest.raises(DecodeError) as caught:
        decode_depth(
            CodedDepth(DepthTable.IDENTITY, step, coarse, region, fine), 64, 48, 0.0, MILLIMETRE
        )
    assert caught.value.reason is Reject.BAD_DEPTH


def test_parts_of_another_size():
    """The coarse picture and the region have the sizes that follow from the header."""
    half, part = jxl(ramp(32, 24)), jxl(ramp(8, 8))
    good = CodedDepth(DepthTable.IDENTITY, 2, half, (8, 8, 16, 16), part)
    assert decode_depth(good, 64, 48, 0.0, MILLIMETRE).shape == (48, 64)
    for bad in (
        CodedDepth(DepthTable.IDENTITY, 4, half, (8, 8, 16, 16), part),
        CodedDepth(DepthTable.IDENTITY, 2, half, (8, 8, 17, 16), part),
        CodedDepth(DepthTable.IDENTITY, 2, part, (8, 8, 16, 16), half),
    ):
        with pytest.raises(DecodeError):
            decode_depth(bad, 64, 48, 0.0, MILLIMETRE)


@pytest.mark.parametrize("a_units", [0.3, 0.5, 1.0, 7.3, 100.0, 3141.59, 20_000.5, 65_535.0])
def test_lattice_against_brute_force(a_units):
    """The values are those that exact arithmetic gives for every disparity, and 0."""
    a = Fraction(a_units)
    expected = {0} | {round(a / n) for n in range(1, int(2 * a_units) + 3)}
    expected.add(round(a))
    values = lattice_values(a_units, 1.0)
    assert values.tolist() == sorted(v for v in expected if v <= MAX_DEPTH_UNITS)


def test_lattice_of_a_real_sensor():
    """A D455: eleven to twelve bits of values instead of sixteen, all the far ones exact.

    The search ends after 4 x 65535 disparities: nearer than that, no stereo camera measures.
    """
    values = lattice_values(D455_LATTICE_M, MILLIMETRE)
    a = Fraction(D455_LATTICE_M / MILLIMETRE)
    far = sorted({round(a / n) for n in range(18, 40_000)})
    assert 2**10 < values.size <= 2**12
    assert values[np.searchsorted(values, far[0]) :].tolist() == far
    assert values[1] <= 5


@given(st.floats(0, 1e5, exclude_min=True), st.floats(1e-5, 0.1))
def test_lattice_is_bounded_for_any_camera(lattice_m, scale_m):
    """Whatever a header may claim: strictly ascending 16-bit values from 0, read-only."""
    values = lattice_values(lattice_m, scale_m)
    assert values.dtype == np.uint16
    assert values[0] == 0
    assert values.size <= MAX_DEPTH_UNITS + 1
    assert (np.diff(values.astype(int)) > 0).all()
    assert not values.flags.writeable


def test_a_rank_that_does_not_exist():
    """A rank past the last value is refused, and the last one is not."""
    values = lattice_values(0.3, MILLIMETRE)
    picture = np.full((48, 64), values.size - 1, np.uint16)
    decoded = decode_depth(whole(jxl(picture), DepthTable.LATTICE), 64, 48, 0.3, MILLIMETRE)
    assert (decoded == values[-1]).all()
    picture[47, 63] = values.size
    assert "rank" in refusal(jxl(picture), DepthTable.LATTICE, lattice_m=0.3)


@pytest.mark.parametrize("lattice_m", [0.0, -0.0])
def test_ranks_without_a_lattice(lattice_m):
    """The rank table needs a lattice to rank."""
    assert "lattice" in refusal(jxl(ramp()), DepthTable.LATTICE, lattice_m=lattice_m)


@pytest.mark.parametrize("size", [(48, 64), (63, 48), (128, 96), (1, 1)])
def test_a_size_that_the_header_did_not_announce(size):
    """A picture of another size is refused, not cropped or stretched."""
    refusal(jxl(ramp()), width=size[0], height=size[1])


@pytest.mark.parametrize(
    "picture",
    [
        ramp().astype(np.uint8),
        (ramp() / 65535).astype(np.float32),
        np.dstack([ramp()] * 2),
        np.dstack([ramp()] * 3),
        np.stack([ramp()] * 3),
    ],
    ids=["8-bit", "float", "with alpha", "colour", "three layers"],
)
def test_other_kinds_of_pictures(picture):
    """Depth is one grey picture of 16 bits."""
    refusal(jxl(picture))


def test_a_lossy_file():
    """A file that was coded with loss is not the depth that the sensor gave."""
    refusal(bytes(imagecodecs.jpegxl_encode(ramp(), lossless=False, distance=1.0, effort=1)))


def test_cut_off_at_every_length():
    """No part of a file passes for the file."""
    data = jxl(ramp())
    for length in range(len(data)):
        refusal(data[:length])


def test_a_small_file_that_claims_a_huge_picture():
    """The claim is compared before anything of that size is allocated (20000 x 20000: 0.8 GB)."""
    bomb = claiming(20_000)
    resident_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tracemalloc.start()
    detail = refusal(bomb)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "20000" in detail
    assert peak < 1_000_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident_kib < 64 * 1024


@given(st.binary(max_size=100))
def test_garbage(data):
    """Bytes that are no JPEG XL: bare, behind its signature, behind a whole and plain header."""
    good = jxl(ramp())
    header = good[good.index(b"\xff\x0a") :][:12]
    for start in (b"", b"\xff\x0a", header):
        refusal(start + data)


@given(st.data())
def test_damaged_files_decode_or_are_refused(data):
    """Whatever bytes change, there is a picture of the right size or a ``BAD_DEPTH``."""
    damaged = bytearray(jxl(ramp()))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        decoded = decode_depth(whole(bytes(damaged)), 64, 48, 0.0, MILLIMETRE)
    except DecodeError as error:
        decoded = error.reason
    assert decoded is Reject.BAD_DEPTH or decoded.shape == (48, 64)


def claiming(side):
    """A bare codestream whose size header says ``side`` x ``side``, with groups that are empty.

    Size header: "not small" (0), then 2 bits that select the length of the height, the height
    less one, and 3 bits of aspect ratio (1: square). 33 bits about the picture follow, then the
    frame's header, from a whole byte on, and the length of each group, 12 bits of zeros.
    """
    data = jxl(ramp(50, 50))
    codestream = data[data.index(b"\xff\x0a") :]
    about = int.from_bytes(codestream[2:8], "little") >> (1 + 2 + 9 + 3)
    size, bits = 2 << 1 | (side - 1) << 3 | 1 << 21, 1 + 2 + 18 + 3
    head = (size | about << bits).to_bytes(8, "little")
    return b"\xff\x0a" + head + codestream[8:12] + bytes(20_000)
