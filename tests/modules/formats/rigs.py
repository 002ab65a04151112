"""A rig and its calibration files, for the tests of their formats."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from modules import formats as f
from modules.types import Camera, StereoRig

# Right camera 0.12 m to the right of the left one, turned by 1 degree about its row axis.
TURN = cv2.Rodrigues(np.array([0.0, np.radians(1.0), 0.0]))[0]


RIG = StereoRig(
    Camera((500.0, 501.0), (319.0, 239.0), 640, 480, (-0.3, 0.1, 0.001, -0.002, 0.0)),
    Camera((502.0, 503.0), (321.0, 241.0), 640, 480, (-0.29, 0.09, 0.0, 0.0, 0.01)),
    TURN,
    (-0.12, 0.001, 0.002),
)


SHAPE = (480, 640)


def storage(path: Path, **nodes: object) -> Path:
    """Write an OpenCV storage file; the suffix decides between YAML and XML."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in nodes.items():
        file.write(name, value)
    file.release()
    return path


def intrinsics(rig: StereoRig = RIG) -> dict[str, np.ndarray]:
    distortions = {f"D{i}": np.array([c.distortion]) for i, c in ((1, rig.left), (2, rig.right))}
    return {"M1": rig.left.matrix, "M2": rig.right.matrix, **distortions}


def extrinsics(rig: StereoRig = RIG) -> dict[str, np.ndarray]:
    return {"R": rig.rotation, "T": np.array([rig.translation_m]).T}


def same_rig(found: StereoRig, rig: StereoRig = RIG, tolerance: float = 1e-12) -> None:
    for a, b in ((found.left, rig.left), (found.right, rig.right)):
        np.testing.assert_allclose((*a.focal_px, *a.centre_px), (*b.focal_px, *b.centre_px), rtol=tolerance)
        np.testing.assert_allclose(a.distortion, b.distortion, rtol=tolerance)
        assert (a.model, a.width_px, a.height_px) == (b.model, b.width_px, b.height_px)
    np.testing.assert_allclose(found.rotation, rig.rotation, atol=tolerance)
    np.testing.assert_allclose(found.translation_m, rig.translation_m, atol=tolerance)


def camera_info(path: Path, camera: Camera, rotation: np.ndarray, projection: np.ndarray, model="plumb_bob") -> Path:
    def block(matrix: np.ndarray) -> dict[str, object]:
        rows, columns = np.atleast_2d(matrix).shape
        return {"rows": rows, "cols": columns, "data": [float(value) for value in np.ravel(matrix)]}

    content = {
        "image_width": camera.width_px,
        "image_height": camera.height_px,
        "camera_name": path.stem,
        "camera_matrix": block(camera.matrix),
        "distortion_model": model,
        "distortion_coefficients": block(np.array(camera.distortion)),
        "rectification_matrix": block(rotation),
        "projection_matrix": block(projection),
    }
    path.write_text(yaml.safe_dump(content))
    return path


def ros_files(folder: Path, **changes: object) -> list[Path]:
    r1, r2, p1, p2 = cv2.stereoRectify(
        RIG.left.matrix, np.array(RIG.left.distortion), RIG.right.matrix, np.array(RIG.right.distortion), (640, 480),
        RIG.rotation, np.array(RIG.translation_m).reshape(3, 1), alpha=0,
    )[:4]  # fmt: skip
    return [
        camera_info(folder / "left.yaml", RIG.left, r1, p1, **changes),
        camera_info(folder / "right.yaml", RIG.right, r2, p2, **changes),
    ]


def refused(paths: Path | list[Path], shape=SHAPE) -> str:
    with pytest.raises(f.FormatError) as error:
        f.read_calibration(paths, shape)
    return str(error.value)


CHAIN = """
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.001]
  distortion_model: equidistant
  intrinsics: [400.0, 401.0, 370.0, 240.0]
  resolution: [752, 480]
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.05]
  - [0.0, 0.0, -1.0, 0.0]
  - [1.0, 0.0, 0.0, -0.2]
  - [0.0, 0.0, 0.0, 1.0]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.3, 0.1, 0.001, 0.0]
  distortion_model: radtan
  intrinsics: [402.0, 402.0, 372.0, 241.0]
  resolution: [752, 480]
"""
