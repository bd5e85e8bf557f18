"""A camera that hangs: the last picture again, told from one that looks much the same."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drone_client.source.frozen import FrozenWatch

pictures = arrays(np.uint8, (4, 5, 3))


@given(pictures, st.integers(1, 5))
def test_the_same_picture_again_is_counted(picture, times: int) -> None:
    """A copy or the very same array; the first one is new."""
    watch = FrozenWatch()
    assert not watch.see(picture)
    for _ in range(times):
        assert watch.see(picture.copy())
        assert watch.see(watch._last)
    assert watch.frozen == 2 * times


@given(pictures, st.integers(0, 59))
def test_one_level_of_one_pixel_is_another_picture(picture, place: int) -> None:
    """Noise of a real sensor differs by far more."""
    watch = FrozenWatch()
    watch.see(picture)
    other = picture.copy()
    other.flat[place] ^= 1
    assert not watch.see(other)
    assert watch.frozen == 0


def test_another_size_is_another_picture() -> None:
    """A camera that was set anew."""
    watch = FrozenWatch()
    watch.see(np.zeros((4, 4, 3), np.uint8))
    assert not watch.see(np.zeros((8, 4, 3), np.uint8))
