"""The expert system in the place of cv2.StereoSGBM."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_pairs import SHIFT_PX, shifted, texture

from expert import PairError
from expert.opencv import create_matcher

WIDTH, HEIGHT = 160, 120


def opencv_script(
    create: Any, left: NDArray[np.uint8], right: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Match, turn into a point cloud and a view as programs around cv2.StereoSGBM do; only `create` is exchanged."""
    least, count, block = 0, 32, 5
    stereo = create(
        minDisparity=least,
        numDisparities=count,
        blockSize=block,
        P1=8 * 3 * block**2,
        P2=32 * 3 * block**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
    )
    stereo.setBlockSize(7)
    stereo.setMode(cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    assert stereo.getBlockSize() == 7
    raw = stereo.compute(left, right)
    assert raw.dtype == np.int16
    disparity = raw.astype(np.float32) / 16.0
    view = (disparity - stereo.getMinDisparity()) / stereo.getNumDisparities()
    height, width = left.shape[:2]
    to_depth = np.float32([[1, 0, 0, -0.5 * width], [0, -1, 0, 0.5 * height], [0, 0, 0, -200], [0, 0, 1, 0]])
    points = cv2.reprojectImageTo3D(disparity, to_depth)
    mask = disparity > disparity.min()
    return points[mask], view


def colour_pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a BGR pair at a disparity of `SHIFT_PX`."""
    scene = np.dstack([texture(seed, WIDTH + SHIFT_PX, HEIGHT) for seed in (1, 2, 3)])
    return scene[:, :WIDTH].copy(), scene[:, SHIFT_PX:].copy()


def test_an_opencv_script_runs_with_one_line_changed() -> None:
    left, right = colour_pair()
    plain, _ = opencv_script(cv2.StereoSGBM.create, left, right)
    points, view = opencv_script(create_matcher, left, right)
    assert len(points) > 0.95 * len(plain)
    assert np.median(points[:, 2]) == pytest.approx(np.median(plain[:, 2]), rel=0.01)
    assert np.median(view) == pytest.approx(SHIFT_PX / 32, rel=0.02)


def test_invalid_pixels_carry_opencvs_number_and_valid_ones_sixteenths() -> None:
    left, right = shifted()
    matcher = create_matcher(minDisparity=-4, numDisparities=40)
    fixed = matcher.compute(left, right)
    assert matcher.result is not None
    found = matcher.result.disparity_px
    valid = np.isfinite(found)
    assert valid.any()
    assert not valid.all()
    np.testing.assert_array_equal(fixed[~valid], (-4 - 1) * 16)
    np.testing.assert_array_equal(fixed[valid], np.rint(found[valid] * 16))


def test_the_range_is_estimated_where_none_is_given() -> None:
    left, right = shifted()
    matcher = create_matcher()
    assert matcher.getNumDisparities() == 0
    fixed = matcher.compute(left, right)
    low, count = matcher.getMinDisparity(), matcher.getNumDisparities()
    assert low <= SHIFT_PX < low + count
    assert np.median(fixed) == pytest.approx(SHIFT_PX * 16, abs=1)
    assert matcher.decision is not None
    assert "disparity_range" in {fact.template for fact in matcher.decision.facts}
    matcher.setNumDisparities(24)
    assert matcher.getNumDisparities() == 24


def test_the_given_array_is_filled_as_opencv_does() -> None:
    left, right = shifted()
    matcher = create_matcher(numDisparities=16)
    out = np.zeros(left.shape, np.int16)
    assert matcher.compute(left, right, out) is out
    assert np.median(out) == pytest.approx(SHIFT_PX * 16, abs=1)
    with pytest.raises(PairError, match=r"disparity is \(3, 3\) int16; give an int16 array of shape \(120, 160\)"):
        matcher.compute(left, right, np.zeros((3, 3), np.int16))


def test_the_channel_order_reaches_the_system() -> None:
    left, right = colour_pair()
    bgr, rgb = create_matcher(0, 16), create_matcher(0, 16, channel_order="rgb")
    bgr.compute(left, right)
    rgb.compute(left, right)
    assert bgr.result is not None
    assert rgb.result is not None
    np.testing.assert_array_equal(bgr.result.views.left, left[..., ::-1])
    np.testing.assert_array_equal(rgb.result.views.left, left)


def test_an_image_without_content_gives_no_disparity_and_says_why() -> None:
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    matcher = create_matcher(numDisparities=16)
    np.testing.assert_array_equal(matcher.compute(flat, flat), -16)
    assert matcher.decision is not None
    assert matcher.decision.status == "failed"
    assert "image-constant" in {finding.name for finding in matcher.decision.findings}


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ValueError, match="numDisparities -16 is negative"):
        create_matcher(numDisparities=-16)
    with pytest.raises(ValueError, match="numDisparities -1 is negative"):
        create_matcher().setNumDisparities(-1)
    with pytest.raises(ValueError, match="channel_order 'gbr' is unknown"):
        create_matcher(channel_order="gbr")  # type: ignore[arg-type]
