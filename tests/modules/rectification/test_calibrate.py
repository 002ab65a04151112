"""Calibration from rendered chessboards with known cameras, and from a real set where it is there."""

import json
from dataclasses import replace
from pathlib import Path

import boards
import numpy as np
import pytest

from expert.cli import main
from modules.formats import FormatError, read_calibration, read_image, write_image
from modules.formats.pairs import find_pairs
from modules.rectification.calibrate import CalibrationFailed, calibrate_rig
from modules.rectification.chessboard import BoardView, Chessboard, count_corners, find_board, find_corners

REAL_SET = Path("/usr/share/doc/opencv-doc/examples/data")  # of Debian's package opencv-doc
SIZE = (320, 240)


@pytest.fixture(scope="module")
def images() -> list[tuple[np.ndarray, np.ndarray]]:
    return boards.pairs(8)


@pytest.fixture(scope="module")
def views(images) -> list[BoardView]:
    found = [find_board(f"{index:02d}", left, right, boards.BOARD) for index, (left, right) in enumerate(images)]
    return [view for view in found if view is not None]


@pytest.fixture
def folder(tmp_path, images) -> Path:
    (tmp_path / "boards").mkdir()
    for index, (left, right) in enumerate(images):
        write_image(tmp_path / "boards" / f"left{index:02d}.png", left)
        write_image(tmp_path / "boards" / f"right{index:02d}.png", right)
    return tmp_path / "boards"


def command(monkeypatch, capsys, *arguments: object) -> tuple[int, str, str]:
    monkeypatch.setattr("sys.argv", ["terrex", "calibrate", *(str(item) for item in arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    said = capsys.readouterr()
    return int(stop.value.code or 0), said.out, said.err


def test_corners_are_found_where_the_board_projects(images):
    import cv2

    rig, (rotation, translation) = boards.RIG, boards.poses(8)[1]
    true = cv2.projectPoints(
        boards.BOARD.points_m(), cv2.Rodrigues(rotation)[0], translation, rig.left.matrix, np.array(rig.left.distortion)
    )[0].reshape(-1, 2)
    found = find_corners(images[1][0], boards.BOARD)
    if np.linalg.norm(found[0] - true[0]) > np.linalg.norm(found[-1] - true[0]):
        found = found[::-1]  # a board of 7x5 corners looks the same upside down
    assert np.sqrt(np.mean(np.sum((found - true) ** 2, axis=1))) < 0.25


def test_the_cameras_that_rendered_the_board_are_recovered(views):
    assert len(views) >= 7
    made = calibrate_rig(views, boards.BOARD, SIZE)
    assert all(error.used for error in made.errors)
    assert made.total("reprojection_px") < 0.2
    assert made.total("epipolar_px") < 0.2
    for camera, truth in ((made.rig.left, boards.RIG.left), (made.rig.right, boards.RIG.right)):
        np.testing.assert_allclose(camera.focal_px, truth.focal_px, rtol=0.01)
        np.testing.assert_allclose(camera.centre_px, truth.centre_px, atol=2.5)
    assert np.linalg.norm(made.rig.translation_m) == pytest.approx(np.linalg.norm(boards.RIG.translation_m), rel=0.01)
    turn = made.rig.rotation @ boards.RIG.rotation.T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 0.3
    errors = made.rig.left.focal_px[0] - 330.0, made.rig.right.focal_px[0] - 332.0
    assert (np.abs(errors) < 4 * np.array(made.sigma_focal_px)).all()


def test_the_baseline_scales_with_the_square(views):
    once, twice = (
        calibrate_rig(views, replace(boards.BOARD, square_m=side), SIZE) for side in (0.04, 0.08)
    )  # fmt: skip
    ratio = np.linalg.norm(twice.rig.translation_m) / np.linalg.norm(once.rig.translation_m)
    assert ratio == pytest.approx(2.0, rel=1e-4)


def test_a_pair_out_of_step_is_dropped_and_named(views):
    """The board moved by 4 px between the shots of the second pair."""
    moved = replace(views[1], right_px=views[1].right_px + np.float32([1.0, 4.0]))
    made = calibrate_rig([views[0], moved, *views[2:]], boards.BOARD, SIZE)
    assert [error.name for error in made.errors if not error.used] == [views[1].name]
    dropped = made.errors[1]
    assert dropped.epipolar_px > 2.0
    assert dropped.reprojection_px > 1.0
    assert made.total("epipolar_px") < 0.25


def test_too_few_views_and_exchanged_images_are_named(views):
    with pytest.raises(CalibrationFailed, match="found in 4 pairs and calibration needs 5; 15 or more"):
        calibrate_rig(views[:4], boards.BOARD, SIZE)
    exchanged = [BoardView(view.name, view.right_px, view.left_px) for view in views]
    with pytest.raises(CalibrationFailed, match=r"stands 0\.10\d m to the left of the left one; exchange the images"):
        calibrate_rig(exchanged, boards.BOARD, SIZE)


def test_an_image_without_the_board_gives_no_corners(images):
    assert find_corners(images[0][0], Chessboard(8, 6, 0.04)) is None
    assert find_corners(np.full((240, 320), 128, np.uint8), boards.BOARD) is None


def test_the_command_writes_a_calibration_that_reads_back(folder, tmp_path, monkeypatch, capsys):
    write_image(folder / "left99.png", np.full((240, 320), 9, np.uint8))
    code, said, complaint = command(
        monkeypatch, capsys, folder, "--pattern", "7x5", "--square", "0.04", "--out", tmp_path / "out"
    )
    assert code in (0, 1)
    assert f"{folder / 'left99.png'} has no image of the other side and is left out" in complaint
    assert "pairs used; board 7x5, squares of 0.04 m" in said
    rig = read_calibration(tmp_path / "out" / "calibration.yaml").rig
    assert np.linalg.norm(rig.translation_m) == pytest.approx(0.1, rel=0.01)
    record = json.loads((tmp_path / "out" / "errors.json").read_text())
    assert record["reprojection_px"] < 0.2
    assert len(record["views"]) >= 7
    picture = read_image(tmp_path / "out" / "calibration.png")
    assert picture.shape[1] == 2 * 560 + 3 * 12
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--pattern", "9"), "--pattern is '9' and must be like 9x6: inner corners, 3x3 at least"),
        (("--square", "25"), "--square is 25 m and must lie between 0.001 and 2 m; is it in mm? divide by 1000"),
        (("--pattern", "9x6"), "the board was found in 0 pairs and calibration needs 5"),
    ],
)
def test_wrong_usage_is_refused_and_nothing_is_written(folder, tmp_path, monkeypatch, capsys, options, words):
    code, _, complaint = command(monkeypatch, capsys, folder, *options, "--out", tmp_path / "out")
    assert code == 2
    assert words in complaint
    assert not (tmp_path / "out").exists()


def test_the_size_of_another_board_is_named(folder, tmp_path, monkeypatch, capsys):
    code, _, complaint = command(monkeypatch, capsys, folder, "--pattern", "9x6", "--out", tmp_path / "out")
    assert code == 2
    assert "The images seem to show a board of 7x5 inner corners; try --pattern 7x5" in complaint


def test_a_board_is_counted_where_one_is_shown(images):
    assert count_corners(left for left, _ in images[:3]) == (7, 5)
    assert count_corners([left.T for left, _ in images[:3]]) == (7, 5)
    assert count_corners([np.full((240, 320), 128, np.uint8)] * 3) is None
    assert count_corners([images[0][0]]) is None  # one image may show a part of a board


def test_corners_of_the_image_that_no_board_came_near_are_named():
    everywhere = [
        (x, y, z) for z in (0.6, 0.9) for x in (-0.3, -0.15, 0.0, 0.15, 0.3, 0.4) for y in (-0.2, -0.1, 0.0, 0.1, 0.2)
    ]
    above = [place for place in everywhere if place[1] <= 0.0]
    whole, upper = (
        calibrate_rig(boards.projected(boards.RIG, p, 0.05), boards.BOARD, SIZE) for p in (everywhere, above)
    )
    assert whole.blind == ((), ())
    assert upper.blind == (("bottom left", "bottom right"),) * 2
    assert upper.coverage[0] < 0.7 < whole.coverage[0]


FISHEYE_PLACES = [(x, y, z) for z in (0.22, 0.3) for x in (-0.25, -0.1, 0.05, 0.2, 0.35) for y in (-0.15, 0.0, 0.15)]


def test_fisheye_cameras_are_recovered_where_browns_model_cannot_follow():
    views = boards.projected(boards.FISHEYE_RIG, FISHEYE_PLACES, 0.05)
    assert len(views) >= 15
    made = calibrate_rig(views, boards.BOARD, SIZE, "equidistant")
    for side, truth in (("left", boards.FISHEYE_RIG.left), ("right", boards.FISHEYE_RIG.right)):
        camera = getattr(made.rig, side)
        assert camera.model == "equidistant"
        np.testing.assert_allclose(camera.focal_px, truth.focal_px, rtol=0.003)
        np.testing.assert_allclose(camera.centre_px, truth.centre_px, atol=0.3)
    np.testing.assert_allclose(made.rig.translation_m, boards.RIG.translation_m, atol=0.0005)
    np.testing.assert_allclose(made.rig.rotation, boards.RIG.rotation, atol=0.002)
    off = made.rig.left.focal_px[0] - 110.0, made.rig.right.focal_px[0] - 111.0
    assert (np.abs(off) < 4 * np.array(made.sigma_focal_px)).all()
    assert made.total("reprojection_px") == pytest.approx(0.05 * np.sqrt(2), rel=0.15)  # the noise that was added
    assert made.total("epipolar_px") < 0.15
    other = calibrate_rig(views, boards.BOARD, SIZE)
    assert other.total("reprojection_px") > 3 * made.total("reprojection_px")


def test_a_fisheye_pair_out_of_step_is_dropped():
    views = boards.projected(boards.FISHEYE_RIG, FISHEYE_PLACES, 0.05)
    views[3] = replace(views[3], right_px=views[3].right_px + np.float32([1.0, 4.0]))
    made = calibrate_rig(views, boards.BOARD, SIZE, "equidistant")
    assert [error.name for error in made.errors if not error.used] == [views[3].name]
    assert made.errors[3].reprojection_px > 1.0


def test_a_fisheye_set_is_named_calibrated_and_rectified(tmp_path, monkeypatch, capsys):
    (tmp_path / "boards").mkdir()
    places = [(x, y, 0.24) for x in (-0.15, 0.05, 0.25) for y in (-0.12, 0.0, 0.12)]
    for index, (rotation, place) in enumerate(boards.at(places)):
        rig = boards.FISHEYE_RIG
        left = boards.render(rig.left, rotation, place)
        right = boards.render(rig.right, rig.rotation @ rotation, rig.rotation @ place + rig.translation_m)
        write_image(tmp_path / "boards" / f"left{index:02d}.png", left)
        write_image(tmp_path / "boards" / f"right{index:02d}.png", right)
    usual = (tmp_path / "boards", "--pattern", "7x5", "--square", "0.04")
    code, said, _ = command(monkeypatch, capsys, *usual, "--out", tmp_path / "wrong")
    assert code == 1
    assert "use --model fisheye" in said
    code, said, _ = command(monkeypatch, capsys, *usual, "--model", "fisheye", "--out", tmp_path / "right")
    assert "use --model" not in said
    assert "note: the board was never seen in the top left" in said
    assert json.loads((tmp_path / "right" / "errors.json").read_text())["epipolar_px"] < 0.3
    found = read_calibration(tmp_path / "right" / "calibration.yaml").rig
    assert (found.left.model, found.right.model) == ("equidistant", "equidistant")
    np.testing.assert_allclose(found.left.focal_px, (110.0, 110.5), rtol=0.02)


def test_the_command_prints_its_schema(monkeypatch, capsys):
    code, said, _ = command(monkeypatch, capsys, "--schema")
    assert code == 0
    assert json.loads(said)["title"] == "Calibration of a stereo pair for terrex"


@pytest.mark.parametrize(
    ("left", "right", "name"),
    [
        ("left01.jpg", "right01.jpg", "01"),
        ("a_left.png", "a_right.png", "a"),
        ("left/7.png", "right/7.png", "7"),
        ("Left.PNG", "Right.PNG", "pair"),
    ],
)
def test_pairs_are_found_by_their_names(tmp_path, left, right, name):
    for path in (left, right, "leftover.png", "notes.txt"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).touch()
    pairs, lonely = find_pairs(tmp_path)
    assert [(pair.name, pair.left, pair.right) for pair in pairs] == [(name, tmp_path / left, tmp_path / right)]
    assert lonely == []


def test_a_folder_without_pairs_is_refused(tmp_path):
    (tmp_path / "left1.png").touch()
    with pytest.raises(FormatError, match=r"holds no pair of images \(1 of one side only\); name them left01.png and"):
        find_pairs(tmp_path)
    with pytest.raises(FormatError, match="is no folder; give the folder that holds left01"):
        find_pairs(tmp_path / "none")


@pytest.mark.skipif(not (REAL_SET / "left01.jpg").exists(), reason="needs the images of Debian's package opencv-doc")
def test_a_real_set_is_calibrated(tmp_path, monkeypatch, capsys):
    """13 pairs of a 9x6 board. OpenCV's own example gives a mean epipolar error of 0.2 to 0.3 px on them."""
    code, _, _ = command(monkeypatch, capsys, REAL_SET, "--out", tmp_path / "out")
    assert code == 0
    record = json.loads((tmp_path / "out" / "errors.json").read_text())
    assert sum(view["used"] for view in record["views"]) >= 12
    assert record["reprojection_px"] < 0.35
    assert record["epipolar_px"] < 0.25
