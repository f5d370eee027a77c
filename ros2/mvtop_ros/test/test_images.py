import io

import numpy as np
import pytest
from mvtop_ros import images
from PIL import Image as Picture
from sensor_msgs.msg import CompressedImage, Image

RGB = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)


def raw(array, encoding, padding=0):
    height, width = array.shape[:2]
    rows = np.pad(array.reshape(height, -1), ((0, 0), (0, padding)), constant_values=255)
    return Image(
        height=height, width=width, encoding=encoding, step=rows.shape[1], data=rows.tobytes()
    )


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "written"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[..., ::-1]),
        ("rgba8", np.dstack([RGB, RGB[..., 0]])),
        ("bgra8", np.dstack([RGB[..., ::-1], RGB[..., 0]])),
        ("8UC3", RGB[..., ::-1]),
    ],
)
def test_colors_come_out_as_rgb(encoding, written, padding):
    got = images.of_raw(raw(written, encoding, padding), (3, 2))
    assert got.dtype == np.uint8 and got.flags.c_contiguous
    assert np.array_equal(got, RGB)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_is_spread_over_three_channels(encoding):
    got = images.of_raw(raw(RGB[..., 1], encoding))
    assert np.array_equal(got, np.repeat(RGB[..., 1:2], 3, axis=2))


@pytest.mark.parametrize(
    "lie",
    [
        {"height": 3},
        {"width": 4},
        {"width": 0},
        {"step": 8},
        {"step": 2**31},
        {"height": 2**31, "step": 2**31},
        {"data": b""},
        {"encoding": "mono16"},
        {"encoding": "bayer_rggb8"},
        {"encoding": ""},
    ],
)
def test_messages_that_lie_are_refused_in_one_sentence(lie):
    message = raw(RGB, "rgb8")
    for name, value in lie.items():
        setattr(message, name, value)
    with pytest.raises(ValueError, match="expected") as refusal:
        images.of_raw(message)
    assert "\n" not in str(refusal.value)


def test_another_size_than_calibrated_is_refused():
    with pytest.raises(ValueError, match="expected 4x2 px as calibrated, got 3x2"):
        images.of_raw(raw(RGB, "rgb8"), (4, 2))


def compressed(array, kind):
    written = io.BytesIO()
    Picture.fromarray(array).save(written, kind)
    return CompressedImage(format=kind.lower(), data=written.getvalue())


def test_png_and_jpeg_are_decoded():
    assert np.array_equal(images.of_compressed(compressed(RGB, "PNG"), (3, 2)), RGB)
    flat = np.full((16, 16, 3), 100, np.uint8)
    got = images.of_compressed(compressed(flat, "JPEG"))
    assert got.shape == flat.shape and np.abs(got.astype(int) - 100).max() < 5
    grey = images.of_compressed(compressed(RGB[..., 0], "PNG"))
    assert np.array_equal(grey, np.repeat(RGB[..., :1], 3, axis=2))


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "JPEG or PNG"),
        (b"GIF89a" + bytes(20), "JPEG or PNG"),
        (compressed(RGB, "PNG").data[:40], "expected"),
        (compressed(np.zeros((2, 3), np.uint16), "PNG").data, "8 bits"),
    ],
)
def test_what_is_no_picture_is_refused(data, sentence):
    with pytest.raises(ValueError, match=sentence):
        images.of_compressed(CompressedImage(format="png", data=bytes(data)), None)


def test_compressed_pictures_of_another_size_are_refused_before_they_are_decoded():
    large = compressed(np.zeros((2000, 2000, 3), np.uint8), "PNG")
    truncated = CompressedImage(format="png", data=bytes(large.data)[:60])
    with pytest.raises(ValueError, match="got 2000x2000"):
        images.of_compressed(truncated, (3, 2))
