"""Raw pairs of a calibrated rig are rectified on loading, and their terrain is that of the rectified pair."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from expert import ExpertSystem, StereoPair
from expert.cli import main
from expert.pair import PairError
from modules.formats import write_calibration, write_image
from modules.rectification.rectify import rectified_points
from modules.simulation import TerrainParams, render_terrain
from modules.simulation.terrain import RenderedPair
from modules.types import Attitude, Calibration, Camera, Invalid, StereoRig

SIZE = (320, 240)
# The scene is rendered with a wide rectified rig, from which the images of two raw cameras are looked up.
WIDE = TerrainParams(seed=5, width_px=440, height_px=340, focal_px=250.0, roll_deg=2.0, pitch_deg=-4.0)


def turn(x_deg: float, y_deg: float, z_deg: float) -> NDArray[np.float64]:
    return np.asarray(cv2.Rodrigues(np.radians([x_deg, y_deg, z_deg]))[0])


def look_up(
    image: NDArray[np.uint8], wide: Calibration, camera: Camera, rotation: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """Return what a raw camera sees: `rotation` takes its optical axes to those of the rendered rig."""
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    seen = rectified_points(pixels, camera, rotation, wide, wide.cx_px).reshape(camera.height_px, camera.width_px, 2)
    return np.asarray(cv2.remap(image, *np.moveaxis(seen.astype(np.float32), 2, 0), cv2.INTER_CUBIC))


@pytest.fixture(scope="module")
def rendered() -> RenderedPair:
    return render_terrain(WIDE)


def raw_rig(model: str) -> tuple[StereoRig, list[NDArray[np.float64]]]:
    """Return a rig of two distorted cameras, each turned a little, and the rotations to the rendered rig."""
    coefficients = (-0.28, 0.09, 0.0008, -0.0006) if model == "radtan" else (-0.03, 0.01, 0.0, 0.0)
    cameras = [
        Camera((245.0 + 2 * i, 246.0 + i), (161.0 - 2 * i, 118.5 + i), *SIZE, coefficients, model)  # type: ignore[arg-type]
        for i in (0, 1)
    ]
    rotations = [turn(0.6, -0.8, 0.5), turn(-0.5, 1.0, -0.9)]
    pose = rotations[1].T @ rotations[0]
    x, y, z = (float(value) for value in -rotations[1].T @ [WIDE.baseline_m, 0.0, 0.0])
    return StereoRig(cameras[0], cameras[1], pose, (x, y, z)), rotations


def raw_pair(rendered: RenderedPair, model: str) -> tuple[StereoPair, StereoRig]:
    rig, rotations = raw_rig(model)
    left, right = (
        look_up(image, rendered.calibration, camera, rotation)
        for image, camera, rotation in zip(
            (rendered.left, rendered.right), (rig.left, rig.right), rotations, strict=True
        )
    )
    # Level from raw optical is level from rendered optical after the camera's own turn.
    mount = replace(rendered.mount, rotation=rendered.mount.rotation @ rotations[0])
    return StereoPair(left, right, attitude=rendered.attitude, mount=mount, name=model), rig


def elevation_error_m(rendered: RenderedPair, result) -> NDArray[np.float64]:
    grid = result.elevation
    truth = rendered.true_elevation(grid.x0_m, grid.y0_m, grid.cell_m, grid.shape).layers["elevation"]
    rows, columns = grid.shape
    x = grid.x0_m + (np.arange(columns) + 0.5) * grid.cell_m
    y = grid.y0_m + (np.arange(rows) + 0.5) * grid.cell_m
    near = np.hypot(x[None, :], y[:, None]) <= 5.0
    error = np.abs(grid.layers["elevation"] - truth)
    return error[near & np.isfinite(error)]


@pytest.mark.parametrize(("model", "alpha"), [("radtan", None), ("equidistant", 1.0)])
def test_the_terrain_of_a_raw_pair_is_right(rendered, model, alpha):
    raw, rig = raw_pair(rendered, model)
    pair = raw.rectify(rig, alpha=alpha)
    result = ExpertSystem(engine="compiled").reconstruct(pair)
    assert result.decision.status == "reconstructed"
    errors = elevation_error_m(rendered, result)
    assert len(errors) > 500
    assert np.median(errors) < 0.03  # half the focal length of the paper's rig: twice its error
    rig_fact = next(record.fields for record in result.decision.facts if record.template == "rig")
    assert rig_fact["rectified_here"] is True
    assert "MEA100" not in result.decision.rules_fired
    assert "the images were rectified here with the calibration; " in result.decision.text()
    if alpha == 1.0:
        assert rig_fact["valid_fraction"] < 0.97
        assert (result.validity[~pair.left_mask] & Invalid.MASKED).all()
        assert not np.isfinite(result.disparity_px[~pair.left_mask]).any()


def test_a_pair_that_was_rectified_before_is_noticed(rendered):
    """The rendered pair is rectified; taken as raw, the rig's distortion and turns spoil its rows."""
    rig, _ = raw_rig("radtan")
    left, right = (image[50:290, 60:380] for image in (rendered.left, rendered.right))
    decision = ExpertSystem(engine="compiled").decide(StereoPair(left, right).rectify(rig))
    assert "MEA100" in decision.rules_fired
    assert any("--rectified" in finding.sentence for finding in decision.findings)


def test_a_right_camera_that_was_knocked_is_realigned(rendered):
    """A pair said to be rectified whose right camera is rolled and tilted: rows are measured and repaired."""
    wide = rendered.calibration
    camera = Camera((250.0, 250.0), (wide.cx_px, wide.cy_px), wide.width_px, wide.height_px)
    right = look_up(rendered.right, wide, camera, turn(0.25, 0.0, 0.4))  # 1.1 px up, 1.5 px at the sides
    system = ExpertSystem(engine="compiled")
    errors = []
    for image in (rendered.right, right):
        pair = StereoPair(
            rendered.left, image, calibration=wide, attitude=rendered.attitude, mount=rendered.mount
        )  # fmt: skip
        result = system.reconstruct(pair)
        errors.append(np.median(elevation_error_m(rendered, result)))
        seen = rendered.nonocc & np.isfinite(result.disparity_px)
        wrong = np.abs(result.disparity_px - rendered.disparity_px)[seen] > 1.0
        assert wrong.mean() < 0.08
    assert "COR001" in result.decision.rules_fired
    assert errors[1] < 2 * errors[0] + 0.005


def test_the_command_takes_raw_images_and_says_so(rendered, tmp_path: Path, monkeypatch, capsys):
    raw, rig = raw_pair(rendered, "radtan")
    write_image(tmp_path / "left.png", raw.left)
    write_image(tmp_path / "right.png", raw.right)
    write_calibration(tmp_path / "rig.yaml", rig, raw.mount)
    monkeypatch.chdir(tmp_path)
    command = ["terrex", "decide", "left.png", "right.png", "--calibration", "rig.yaml"]
    monkeypatch.setattr("sys.argv", [*command, "--json"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    assert '"rectified_here": true' in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", [*command, "--rectified"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "describes raw cameras and no rectified pair; leave out --rectified" in capsys.readouterr().err


def test_the_uncertainty_of_a_fitted_level_is_said_aloud(rendered):
    pair = StereoPair(rendered.left, rendered.right, calibration=rendered.calibration, mount=rendered.mount)
    said = ExpertSystem(engine="compiled").reconstruct(pair).decision.text()
    assert "level comes from the ground itself: roll and pitch are uncertain by 2." in said
    assert "cm of height for every metre of distance" in said


def test_a_mount_on_an_inertial_unit_needs_its_attitude(rendered, tmp_path):
    """An inertial unit may look anywhere: here its z axis looks ahead, as that of a camera."""
    rows = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    shared = "camera_model: pinhole, distortion_model: none, intrinsics: [250, 250, 220, 170], resolution: [440, 340]"
    pose = rows.replace("[1, 0, 0, 0]", "[1, 0, 0, -0.09]")
    (tmp_path / "camchain-imucam.yaml").write_text(
        f"cam0: {{{shared}, T_cam_imu: {rows}}}\ncam1: {{{shared}, T_cn_cnm1: {pose}}}\n"
    )
    write_image(tmp_path / "left.png", rendered.left)
    write_image(tmp_path / "right.png", rendered.right)
    files = (tmp_path / "left.png", tmp_path / "right.png")
    pair = StereoPair.load(*files, calibration=tmp_path / "camchain-imucam.yaml")
    assert pair.mount is None
    assert pair.calibration.baseline_m == pytest.approx(0.09)
    assert not pair.preparation.rectified_here  # parallel cameras without distortion
    pair = StereoPair.load(*files, calibration=tmp_path / "camchain-imucam.yaml", attitude=Attitude())
    np.testing.assert_array_equal(pair.mount.rotation, np.eye(3))


def test_a_wrong_doffs_that_puts_points_behind_the_camera_is_found(rendered):
    """Sky and far hills scatter about infinity without a word; six px beyond it are told."""
    found = []
    for doffs_px in (0.0, -6.0):
        calibration = replace(rendered.calibration, doffs_px=doffs_px)
        pair = StereoPair(
            rendered.left, rendered.right, calibration=calibration, attitude=rendered.attitude, mount=rendered.mount
        )  # fmt: skip
        findings = ExpertSystem(engine="compiled").reconstruct(pair).decision.findings
        found.append([finding.sentence for finding in findings if finding.name == "points-behind-camera"])
    assert found[0] == []
    assert "doffs is missing or wrong" in found[1][0]


def test_pairs_that_cannot_be_rectified_are_named(rendered):
    rig, _ = raw_rig("radtan")
    small = StereoPair(rendered.left[:200, :300], rendered.right[:200, :300])
    with pytest.raises(PairError, match="the rig is of 320x240 px and the images are 300x200 px; use the"):
        small.rectify(rig)
    masked = StereoPair(
        rendered.left[:240, :320], rendered.right[:240, :320], left_mask=np.ones((240, 320), bool)
    )  # fmt: skip
    with pytest.raises(PairError, match="has masks of its raw images; rectify it first"):
        masked.rectify(rig)
    with pytest.raises(PairError, match=r"left_mask is uint8 of shape \(9, 9\); expected bool of shape \(240, 320\)"):
        replace(masked, left_mask=np.zeros((9, 9), np.uint8))
