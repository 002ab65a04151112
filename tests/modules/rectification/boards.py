"""Chessboards rendered through two distorted cameras, for tests."""

from __future__ import annotations

import cv2
import numpy as np

from modules.rectification.chessboard import BoardView, Chessboard
from modules.rectification.rectify import project_points
from modules.types import Camera, StereoRig

BOARD = Chessboard(7, 5, 0.04)
RIG = StereoRig(
    Camera((330.0, 331.0), (161.0, 118.5), 320, 240, (-0.25, 0.08, 0.0005, -0.0008, 0.0)),
    Camera((332.0, 332.5), (158.0, 121.0), 320, 240, (-0.24, 0.07, -0.0005, 0.0005, 0.0)),
    np.asarray(cv2.Rodrigues(np.radians([0.5, -1.0, 0.4]))[0]),
    (-0.1, 0.001, 0.002),
)
FISHEYE_RIG = StereoRig(
    Camera((110.0, 110.5), (161.0, 118.5), 320, 240, (-0.02, 0.005, -0.001, 0.0002), "equidistant"),
    Camera((111.0, 111.5), (158.0, 121.0), 320, 240, (-0.015, 0.003, -0.001, 0.0001), "equidistant"),
    RIG.rotation,
    RIG.translation_m,
)  # 166 degrees wide
SUPERSAMPLE = 3


def render(camera: Camera, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return the gray image of the board at `p_camera = rotation p_board + translation`, by ray casting."""
    scale = SUPERSAMPLE
    v, u = np.mgrid[0 : camera.height_px * scale, 0 : camera.width_px * scale]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64) / scale - (scale - 1) / (2 * scale)
    undistort = cv2.fisheye.undistortPoints if camera.model == "equidistant" else cv2.undistortPoints
    normal = undistort(pixels.reshape(-1, 1, 2), camera.matrix, np.array(camera.distortion)).reshape(-1, 2)
    rays = np.column_stack([normal, np.ones(len(normal))]) @ rotation
    eye = -rotation.T @ translation
    reach = -eye[2] / rays[:, 2]
    x, y = (eye[:2] + rays[:, :2] * reach[:, None]).T / BOARD.square_m
    dark = (np.floor(x).astype(int) + np.floor(y).astype(int)) % 2 == 0
    on_squares = (x > -1) & (x < BOARD.columns) & (y > -1) & (y < BOARD.rows)
    on_board = (x > -2) & (x < BOARD.columns + 1) & (y > -2) & (y < BOARD.rows + 1)
    value = np.where(on_squares & dark, 40.0, np.where(on_board, 215.0, 120.0))
    fine = value.reshape(camera.height_px, scale, camera.width_px, scale)
    return np.round(fine.mean(axis=(1, 3))).astype(np.uint8)


def poses(count: int, seed: int = 3) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return poses of the board against the left camera: tilted, and spread over the image."""
    rng = np.random.default_rng(seed)
    middle = np.array([(BOARD.columns - 1) / 2, (BOARD.rows - 1) / 2, 0.0]) * BOARD.square_m
    made = []
    for index in range(count):
        rotation = cv2.Rodrigues(np.radians([rng.uniform(-35, 35), rng.uniform(-35, 35), rng.uniform(-20, 20)]))[0]
        place = np.array([((index % 3) - 1) * 0.05 + 0.05, ((index // 3) % 3 - 1) * 0.04, rng.uniform(0.5, 0.6)])
        made.append((rotation, place - rotation @ middle))
    return made


def pairs(count: int, rig: StereoRig = RIG) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return rendered pairs of images."""
    return [
        (render(rig.left, r, t), render(rig.right, rig.rotation @ r, rig.rotation @ t + rig.translation_m))
        for r, t in poses(count)
    ]


def at(places: list[tuple[float, float, float]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return poses of the board, tilted, with its middle at these places in the left camera, m."""
    rng = np.random.default_rng(5)
    middle = BOARD.points_m().mean(axis=0).astype(np.float64)
    turns = [np.asarray(cv2.Rodrigues(np.radians(rng.uniform((-35, -35, -20), (35, 35, 20))))[0]) for _ in places]
    return [(turn, np.array(place) - turn @ middle) for turn, place in zip(turns, places, strict=True)]


def projected(rig: StereoRig, places: list[tuple[float, float, float]], noise_px: float = 0.0) -> list[BoardView]:
    """Return views of the board with its middle at these places, m, tilted, by projection; all whole in both images."""
    rng = np.random.default_rng(5)
    points = BOARD.points_m().astype(np.float64)
    made = []
    for index, (turn, place) in enumerate(at(places)):
        in_left = points @ turn.T + place
        in_right = in_left @ rig.rotation.T + rig.translation_m
        seen = [
            (project_points(points_m, camera) + rng.normal(0.0, noise_px, (len(points), 2))).astype(np.float32)
            for points_m, camera in ((in_left, rig.left), (in_right, rig.right))
        ]
        if all((xy >= 0).all() and (xy <= (rig.left.width_px - 1, rig.left.height_px - 1)).all() for xy in seen):
            made.append(BoardView(f"{index:02d}", seen[0], seen[1]))
    return made
