"""Rectification: points of space come to one row, at the disparity that their depth says."""

import cv2
import numpy as np
import pytest

from modules.rectification.rectify import (
    RectificationError,
    already_rectified,
    max_ray_tangent,
    plan_rectification,
    rectification_map,
    rectified_points,
    rectify_images,
)
from modules.types import Calibration, Camera, Rectification, StereoRig

RADTAN = (-0.3, 0.12, 0.001, -0.0015, -0.02)
FISHEYE = (-0.02, 0.005, -0.001, 0.0002)


def turn(x_deg: float, y_deg: float, z_deg: float) -> np.ndarray:
    return np.asarray(cv2.Rodrigues(np.radians([x_deg, y_deg, z_deg]))[0])


def rig(left="radtan", right="radtan", width=640, height=480) -> StereoRig:
    coefficients = {"radtan": RADTAN, "equidistant": FISHEYE, "none": ()}
    cameras = [
        Camera((f, f + 1.0), (width / 2 + 3, height / 2 - 4), width, height, coefficients[name],
               "equidistant" if name == "equidistant" else "radtan")
        for f, name in ((420.0, left), (425.0, right))
    ]  # fmt: skip
    return StereoRig(cameras[0], cameras[1], turn(0.8, -1.5, 0.6), (-0.12, 0.003, -0.002))


def test_a_lens_of_more_than_180_degrees_is_rectified_within_what_a_plane_can_hold():
    """The border of these images lies 101 degrees from the axis, where a tangent has the other sign."""
    lens = Camera((180.0, 180.0), (319.5, 239.5), 640, 480, FISHEYE, "equidistant")
    plan = plan_rectification(StereoRig(lens, lens, turn(0.5, -1.0, 0.4), (-0.1, 0.001, 0.002)))
    c = plan.calibration
    left, right = -c.cx_px / c.focal_px, (639 - c.cx_px) / c.focal_px
    assert left < -2.0  # 63 degrees to both sides
    assert right > 2.0
    for rotation in (plan.left_rotation, plan.right_rotation):
        assert rectification_map(lens, rotation, c, c.cx_px)[2].all()


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Project points (N, 3) of the camera's optical frame, by OpenCV's own models."""
    zero, k = np.zeros(3), np.array(camera.distortion or (0.0,) * 4)
    if camera.model == "equidistant":
        return cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), zero, zero, camera.matrix, k)[0].reshape(-1, 2)
    return cv2.projectPoints(points, zero, zero, camera.matrix, k)[0].reshape(-1, 2)


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(
    ("left", "right"),
    [("radtan", "radtan"), ("equidistant", "equidistant"), ("radtan", "equidistant"), ("none", "none")],
)
def test_points_of_space_come_to_one_row_at_their_disparity(left, right, alpha):
    stereo = rig(left, right)
    plan = plan_rectification(stereo, alpha)
    c = plan.calibration
    space = np.random.default_rng(1).uniform([-2, -1.5, 3], [2, 1.5, 8], (200, 3))
    in_right = space @ stereo.rotation.T + stereo.translation_m
    xl = rectified_points(project(stereo.left, space), stereo.left, plan.left_rotation, c, c.cx_px)
    xr = rectified_points(project(stereo.right, in_right), stereo.right, plan.right_rotation, c, c.cx_px)
    np.testing.assert_allclose(xl[:, 1], xr[:, 1], atol=1e-4)
    depth = (space @ plan.left_rotation.T)[:, 2]
    np.testing.assert_allclose(xl[:, 0] - xr[:, 0], c.focal_px * c.baseline_m / depth, atol=1e-4)
    assert c.baseline_m == pytest.approx(np.linalg.norm(stereo.translation_m))


@pytest.mark.parametrize("model", ["radtan", "equidistant"])
def test_the_map_is_the_inverse_of_rectifying_points(model):
    stereo = rig(model, model)
    plan = plan_rectification(stereo)
    c = plan.calibration
    x, y, seen = rectification_map(stereo.left, plan.left_rotation, c, c.cx_px)
    assert seen.all()
    v, u = np.mgrid[20:460:40, 20:620:40]
    raw = np.column_stack([x[v, u].ravel(), y[v, u].ravel()]).astype(np.float64)
    back = rectified_points(raw, stereo.left, plan.left_rotation, c, c.cx_px)
    np.testing.assert_allclose(back, np.column_stack([u.ravel(), v.ravel()]), atol=2e-3)  # the maps are float32


@pytest.mark.parametrize("model", ["radtan", "equidistant", "none"])
def test_alpha_0_keeps_only_valid_pixels_and_alpha_1_all_the_cameras_saw(model):
    stereo = rig(model, model)
    image = np.full((480, 640), 90, np.uint8)
    tight, loose = (rectify_images(image, image, stereo, alpha) for alpha in (0.0, 1.0))
    for mask in (tight.left_mask, tight.right_mask):
        assert mask.mean() > 0.9995  # a border pixel may fall a thousandth outside
    assert loose.left_mask.mean() < 0.97
    assert tight.rectification.calibration.focal_px > loose.rectification.calibration.focal_px
    corners = np.array([[0, 0], [639, 0], [0, 479], [639, 479]], float)
    plan = loose.rectification
    for camera, rotation in ((stereo.left, plan.left_rotation), (stereo.right, plan.right_rotation)):
        seen = rectified_points(corners, camera, rotation, plan.calibration, plan.calibration.cx_px)
        assert (seen > -0.01).all()
        assert (seen < [639.01, 479.01]).all()


def test_the_focal_length_of_alpha_1_agrees_with_opencv():
    """OpenCV looks at a 9x9 grid of the image and keeps the centre, so the two agree only roughly."""
    stereo = rig()
    reference = cv2.stereoRectify(
        stereo.left.matrix, np.array(RADTAN), stereo.right.matrix, np.array(RADTAN), (640, 480), stereo.rotation,
        np.reshape(stereo.translation_m, (3, 1)), alpha=1,
    )  # fmt: skip
    plan = plan_rectification(stereo, 1.0)
    np.testing.assert_allclose(plan.left_rotation, reference[0], atol=1e-12)
    assert plan.calibration.focal_px == pytest.approx(reference[2][0, 0], rel=0.05)


def test_an_image_of_a_board_comes_back_straight():
    """A raw image is made by looking up where each of its pixels lies on the rectified plane."""
    stereo = rig()
    plan = plan_rectification(stereo, 0.0)
    c = plan.calibration
    v, u = np.mgrid[0:480, 0:640].astype(np.float64)
    pattern = 127 + 60 * np.sin(u / 9) + 60 * np.sin(v / 7)
    target = rectified_points(np.column_stack([u.ravel(), v.ravel()]), stereo.left, plan.left_rotation, c, c.cx_px)
    x, y = (target[:, i].reshape(480, 640) for i in (0, 1))
    raw = np.clip(np.round(127 + 60 * np.sin(x / 9) + 60 * np.sin(y / 7)), 0, 255).astype(np.uint8)
    made = rectify_images(raw, raw, stereo).left
    error = np.abs(made[8:-8, 8:-8] - pattern[8:-8, 8:-8])
    assert np.median(error) < 1.0
    assert np.percentile(error, 99) < 3.0


@pytest.mark.parametrize(
    ("model", "coefficients"), [("radtan", (-0.4, 0.0, 0.0, 0.0)), ("equidistant", (-0.4, 0, 0, 0))]
)
def test_pixels_beyond_the_turn_of_the_distortion_are_masked(model, coefficients):
    """r - 0.4 r^3 turns at r = 0.913 (and theta alike at 52.3 deg): beyond it the image would appear a second time."""
    camera = Camera((300.0, 300.0), (319.5, 239.5), 640, 480, (-0.4, 0.0, 0.0, 0.0), model)
    turning = np.sqrt(1 / 1.2)
    expected = turning if model == "radtan" else np.tan(turning)
    assert max_ray_tangent(camera) == pytest.approx(expected, rel=0.005)
    wide = Calibration(150.0, 319.5, 239.5, 0.1, 640, 480)
    _, _, seen = rectification_map(camera, np.eye(3), wide, 319.5)
    column = np.arange(640) - 319.5
    np.testing.assert_array_equal(seen[240], np.hypot(column, 0.5) / 150.0 <= max_ray_tangent(camera))


def test_rays_behind_the_camera_are_masked():
    camera = Camera((300.0, 300.0), (319.5, 239.5), 640, 480)
    _, _, seen = rectification_map(camera, turn(0, 80, 0), Calibration(150.0, 319.5, 239.5, 0.1, 640, 480), 319.5)
    assert 0.0 < seen.mean() < 0.9


def test_a_rig_without_distortion_or_rotation_needs_no_rectification():
    camera = Camera((500.0, 500.0), (320.0, 240.0), 640, 480)
    right = Camera((500.0, 500.0), (330.0, 240.0), 640, 480)
    parallel = StereoRig(camera, right, np.eye(3), (-0.1, 0.0, 0.0))
    assert already_rectified(parallel) == Calibration(500.0, 320.0, 240.0, 0.1, 640, 480, 10.0)
    assert already_rectified(StereoRig(camera, right, turn(0.1, 0, 0), (-0.1, 0, 0))) is None
    assert already_rectified(rig()) is None


def test_a_prescribed_rectification_is_used_unless_alpha_is_given():
    stereo = rig("none", "none")
    plan = plan_rectification(stereo, 0.3)
    prescribed = StereoRig(
        stereo.left, stereo.right, stereo.rotation, stereo.translation_m,
        Rectification(plan.left_rotation, plan.right_rotation, plan.calibration),
    )  # fmt: skip
    image = np.zeros((480, 640, 3), np.uint16)
    made = rectify_images(image, image, prescribed)
    assert made.rectification.calibration == plan.calibration
    assert (made.left.dtype, made.left.shape) == (np.uint16, (480, 640, 3))
    assert rectify_images(image, image, prescribed, 0.0).rectification.calibration != plan.calibration


def test_what_cannot_be_rectified_is_named():
    stereo = rig()
    with pytest.raises(RectificationError, match=r"alpha is 1\.5 and must lie between 0 .only valid pixels. and 1"):
        plan_rectification(stereo, 1.5)
    apart = StereoRig(stereo.left, stereo.right, turn(75, 0, 0), (-0.1, 0.0, 0.0))
    with pytest.raises(RectificationError, match="the two cameras see nothing in common; check rotation"):
        plan_rectification(apart)
