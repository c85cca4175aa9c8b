"""PNG files that claim more than they hold are refused before a decoder makes room for it."""

import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.sensors.depth import read_depth_png, write_depth_png
from hypose.io.videos.video import decode, read_image


@pytest.fixture
def png(tmp_path):
    path = tmp_path / "depth.png"
    write_depth_png(path, np.random.default_rng(0).uniform(0.5, 4.0, (24, 32)))
    return path


@pytest.mark.parametrize("left", [8, 9, 33, 40, -13, -1])
def test_a_png_that_ends_early_is_cut(png, left):
    data = png.read_bytes()
    assert decode(data[:left]) is None and decode(data) is not None and decode(data + b"more") is not None


def test_a_piece_that_claims_half_a_gigabyte_is_refused(png, tmp_path):
    data = bytearray(png.read_bytes())
    data[33] = 0x20  # the length of the first piece after the header
    png.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_depth_png(png)
    with pytest.raises(InputError, match="damaged"):
        read_image(png)
