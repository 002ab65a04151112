from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from synthetic_pairs import shifted, texture

from expert.cli import main
from modules.formats.disparity import read_pfm

CALIBRATION = "focal_px: 200\ncx_px: 80\ncy_px: 60\nbaseline_m: 0.1\nwidth_px: 160\nheight_px: 120\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give a folder with a small pair in it, and work there."""
    left, right = shifted()
    cv2.imwrite(str(tmp_path / "left.png"), left)
    cv2.imwrite(str(tmp_path / "right.png"), right)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def terrex(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Run the command in this process and return its exit code."""
    monkeypatch.setattr(sys, "argv", ["terrex", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def everything(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def refused(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that shall be refused; return what it says, and check that it wrote nothing."""
    before = everything(folder)
    assert terrex(monkeypatch, *arguments) == 2
    assert everything(folder) == before
    said = capsys.readouterr()
    assert said.out == ""
    assert "Traceback" not in said.err
    return said.err.strip()


BAD_IMAGES = {
    "missing": (None, "bad.png does not exist; check the path of the image"),
    "empty": (b"", "bad.png is empty (0 bytes); copy it again"),
    "text": (b"hello", "bad.png is not an image that can be read; use PNG, JPEG, TIFF or PGM"),
}


@pytest.mark.parametrize("command", ["run", "decide"])
@pytest.mark.parametrize("fault", BAD_IMAGES)
@pytest.mark.parametrize("side", [0, 1])
def test_a_file_that_is_no_image_is_refused_by_name(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    fault: str,
    side: int,
) -> None:
    content, expected = BAD_IMAGES[fault]
    if content is not None:
        (folder / "bad.png").write_bytes(content)
    names = ["left.png", "right.png"]
    names[side] = "bad.png"
    assert refused(folder, monkeypatch, capsys, command, *names) == expected


def test_a_truncated_image_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (folder / "left.png").read_bytes()
    (folder / "half.png").write_bytes(whole[: len(whole) // 2])
    assert refused(folder, monkeypatch, capsys, "run", "half.png", "right.png") == (
        f"half.png is truncated: {len(whole) // 2} bytes without the end mark of a PNG; copy it again"
    )


def test_images_of_different_size_are_refused_with_both_sizes(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite("small.png", texture(1, 150, 100))
    assert refused(folder, monkeypatch, capsys, "run", "left.png", "small.png") == (
        "left.png is 160x120 and small.png is 150x100; crop them to one size or rectify the pair first"
    )


def test_a_gray_and_a_colour_image_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite("colour.png", np.repeat(shifted()[1][..., None], 3, axis=2))
    assert refused(folder, monkeypatch, capsys, "run", "left.png", "colour.png") == (
        "one image is gray and the other is colour; convert both to gray or both to RGB"
    )


def test_an_image_of_one_pixel_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite("one.png", np.zeros((1, 1), np.uint8))
    assert refused(folder, monkeypatch, capsys, "run", "one.png", "one.png") == (
        "one.png is 1x1 px and needs at least 16 px a side; give a larger image"
    )


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "calib.yaml does not exist; check the path of the calibration"),
        ("hello world\n", "calib.yaml holds str and a calibration is a mapping; write lines of 'name: value'"),
        (
            "focal_px: 200\nbaseline_m: 0.1\n",
            "calib.yaml has no 'width_px', 'height_px', 'cx_px', 'cy_px'; add a line 'width_px: value' and so on",
        ),
        (
            CALIBRATION.replace("width_px: 160", "width_px: 320").replace("height_px: 120", "height_px: 240"),
            "the calibration is for 320x240 px and the images are 160x120 px; the aspect fits a scale of 0.5: "
            "if these are the whole images resampled, ask for it with --scale-calibration",
        ),
    ],
)
def test_a_wrong_calibration_is_refused(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    content: str | None,
    expected: str,
) -> None:
    if content is not None:
        (folder / "calib.yaml").write_text(content, encoding="utf-8")
    arguments = ("run", "left.png", "right.png", "--calibration", "calib.yaml")
    assert refused(folder, monkeypatch, capsys, *arguments) == expected


@pytest.mark.parametrize("baseline", ["-0.1", "0", "nan", "120", "wide"])
def test_an_impossible_baseline_is_refused_with_its_value(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], baseline: str
) -> None:
    text = CALIBRATION.replace("baseline_m: 0.1", f"baseline_m: {baseline}")
    (folder / "calib.yaml").write_text(text, encoding="utf-8")
    said = refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", "--calibration", "calib.yaml")
    assert said.startswith("calib.yaml")
    assert "baseline" in said
    assert baseline in said


@pytest.mark.parametrize(
    ("option", "value"), [("--roll", "200"), ("--pitch", "-91"), ("--yaw", "400"), ("--roll", "nan")]
)
def test_an_attitude_out_of_range_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], option: str, value: str
) -> None:
    limit = "360" if option == "--yaw" else "90"
    assert refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", option, value) == (
        f"the attitude given: {option[2:]}_deg is {value} deg, outside -{limit} to {limit} deg; "
        "check its unit and the order of angles"
    )


def test_an_attitude_file_out_of_range_is_refused_by_name(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "attitude.yaml").write_text("pitch_deg: 120\n", encoding="utf-8")
    said = refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", "--attitude", "attitude.yaml")
    assert said == (
        "attitude.yaml: pitch_deg is 120 deg, outside -90 to 90 deg; check its unit and the order of angles"
    )


IMU = "time_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,0\n0.4,0,8,0\n"


def test_the_attitude_of_a_log_is_used_at_the_time_of_the_pair(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "imu.csv").write_text(IMU, encoding="utf-8")
    arguments = ("decide", "left.png", "right.png", "--imu", "imu.csv", "--time", "0.1", "--json")
    monkeypatch.setattr("sys.argv", ["terrex", *arguments, "--convention", "aerospace"])
    with pytest.raises(SystemExit):
        main()
    assert '"pitch_deg": -2.0' in capsys.readouterr().out  # nose up 2 degrees


def test_a_gap_of_the_log_is_refused_with_the_option_that_allows_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "imu.csv").write_text(IMU, encoding="utf-8")
    arguments = ("decide", "left.png", "right.png", "--imu", "imu.csv", "--time", "0.1", "--max-gap")
    assert "has a gap of 0.400 s at 0.100 s, above 0.3 s" in refused(folder, monkeypatch, capsys, *arguments, "0.3")
    assert terrex(monkeypatch, *arguments, "0.4") == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--imu", "imu.csv"), "--imu LOG and --time T belong together; give both or neither"),
        (("--time", "1"), "--imu LOG and --time T belong together; give both or neither"),
        (
            ("--imu", "imu.csv", "--time", "0", "--pitch", "1"),
            "give --imu LOG --time T, --attitude FILE or --roll --pitch --yaw: one of them",
        ),
        (
            ("--imu", "imu.csv", "--time", "7"),
            "imu.csv runs from 0.000 to 0.400 s and 7.000 s is outside; "
            "check that the images and the log use one clock and unit",
        ),
        (("--alpha", "1"), "--rectified, --alpha and --scale-calibration say how to use --calibration; give it"),
    ],
)
def test_half_of_a_statement_is_refused(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    words: str,
) -> None:
    (folder / "imu.csv").write_text(IMU, encoding="utf-8")
    assert refused(folder, monkeypatch, capsys, "decide", "left.png", "right.png", *options) == words


def test_a_convention_beside_an_attitude_file_is_not_passed_over(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "attitude.yaml").write_text("pitch_deg: 1\n", encoding="utf-8")
    arguments = ("decide", "left.png", "right.png", "--attitude", "attitude.yaml", "--convention", "aerospace")
    assert refused(folder, monkeypatch, capsys, *arguments) == (
        "--convention is that of --imu and of --roll --pitch --yaw; write `convention: aerospace` into attitude.yaml "
        "instead"
    )


def test_an_attitude_given_twice_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "attitude.yaml").write_text("pitch_deg: 1\n", encoding="utf-8")
    arguments = ("run", "left.png", "right.png", "--attitude", "attitude.yaml", "--roll", "1")
    assert refused(folder, monkeypatch, capsys, *arguments) == (
        "give --attitude FILE or --roll --pitch --yaw, not both"
    )


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        (("30", "10"), "disparity range 30 10 is empty; the second number must be larger than the first"),
        (("0", "500"), "disparity range 0 500 is wider than the image (160 px); narrow it"),
    ],
)
def test_a_wrong_disparity_range_is_refused(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    bounds: tuple[str, str],
    expected: str,
) -> None:
    arguments = ("run", "left.png", "right.png", "--disparity-range", *bounds)
    assert refused(folder, monkeypatch, capsys, *arguments) == expected


def test_an_output_folder_that_is_a_file_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", "--out", "left.png")
    assert said == "left.png is a file and the results need a folder; choose another name"


def test_a_folder_with_files_of_another_origin_is_not_touched(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "thesis").mkdir()
    (folder / "thesis" / "chapter.tex").write_text("years of work", encoding="utf-8")
    assert refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", "--out", "thesis") == (
        "thesis holds 1 files that were not written by terrex (chapter.tex); "
        "choose a new or empty folder, nothing was changed"
    )


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that nobody can write to")
def test_an_unwritable_output_folder_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", "--out", "/proc/out")
    assert said.startswith("/proc/out cannot be written (")
    assert said.endswith("; choose a folder you may write to")


def test_a_wrong_rule_file_is_refused_with_every_position(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "rig.yaml").write_text("version: 1\nrules:\n  - id: RIG001\n", encoding="utf-8")
    said = refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", "--rules", "rig.yaml").splitlines()
    assert len(said) > 1
    assert all(re.match("rig.yaml:3:5: missing-[a-z]+: rule RIG001: ", line) for line in said), said


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--seed", "-1"), "--seed -1: Input should be greater than or equal to 0"),
        (("--roll", "90"), "--roll 90.0: Input should be less than or equal to 45"),
    ],
)
def test_impossible_parameters_of_the_simulator_are_refused(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    expected: str,
) -> None:
    assert refused(folder, monkeypatch, capsys, "simulate", "--out", "made", *arguments) == expected


def test_an_unknown_distortion_is_refused_with_the_known_ones(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(folder, monkeypatch, capsys, "simulate", "--out", "made", "--distortion", "rain")
    assert said.startswith("there is no distortion 'rain'; known: ")


def test_a_failure_while_writing_leaves_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from modules.formats import FormatError

    def full(*_: object) -> None:
        raise FormatError("disparity.pfm cannot be written (No space left on device)")

    monkeypatch.setattr("expert.result.write_pfm", full)
    said = refused(folder, monkeypatch, capsys, "run", "left.png", "right.png", "--out", "out")
    assert said == "disparity.pfm cannot be written (No space left on device)"


def test_a_run_writes_every_product_and_ends_with_zero(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "calib.yaml").write_text(CALIBRATION, encoding="utf-8")
    arguments = ("--calibration", "calib.yaml", "--roll", "0", "--out", "out")
    assert terrex(monkeypatch, "run", "left.png", "right.png", *arguments) == 0
    assert {path.name for path in (folder / "out").iterdir()} >= {
        ".terrex", "decision.json", "report.md", "left_corrected.png", "right_corrected.png", "validity.png",
        "disparity.pfm", "disparity.png", "points.ply", "elevation.tif", "elevation.png",
    }  # fmt: skip
    disparity = read_pfm(folder / "out" / "disparity.pfm")
    assert np.nanmedian(disparity) == pytest.approx(8.0, abs=0.1)
    stored = cv2.imread("out/disparity.png", cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint16
    good = np.isfinite(disparity)
    assert not stored[~good].any()
    # Half a step of the 16-bit image.
    assert np.abs(stored[good] / 256.0 - disparity[good]).max() <= 0.5 / 256.0 + 1e-6
    said = capsys.readouterr()
    assert said.out.endswith("\nwritten to out\n")
    assert said.err == ""


def test_without_a_calibration_the_report_says_what_3d_needs(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert terrex(monkeypatch, "run", "left.png", "right.png", "--out", "out") == 0
    assert "--calibration" in capsys.readouterr().out
    assert not (folder / "out" / "points.ply").exists()
    assert (folder / "out" / "disparity.pfm").exists()


def test_decide_prints_a_record_that_parses(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = everything(folder)
    assert terrex(monkeypatch, "decide", "left.png", "right.png", "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["status"] == "decided"
    assert list(record["plans"]) == ["correction", "matching", "reconstruction"]
    assert everything(folder) == before


CONSTANT = np.full((120, 160), 90, np.uint8)
BAD_SCENES = {
    "constant": ((CONSTANT, CONSTANT), "an image has no content"),
    "left covered": ((CONSTANT, shifted()[1]), "an image has no content"),
    "swapped": (shifted()[::-1], "left and right are swapped"),
    "unrelated": ((texture(5, 320, 240), texture(6, 320, 240)), "may not show one scene"),
    "unrelated and coarse": ((texture(7, 320, 240, 4.0), texture(8, 320, 240, 1.2)), "almost nothing could be matched"),
}


@pytest.mark.parametrize("engine", ["experta", "compiled"])
@pytest.mark.parametrize("scene", BAD_SCENES)
def test_a_scene_that_cannot_be_reconstructed_ends_with_one_and_a_report(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    scene: str,
    engine: str,
) -> None:
    (left, right), expected = BAD_SCENES[scene]
    cv2.imwrite("left.png", left)
    cv2.imwrite("right.png", right)
    assert terrex(monkeypatch, "run", "left.png", "right.png", "--engine", engine, "--out", "out") == 1
    assert expected in capsys.readouterr().out
    report = (folder / "out" / "report.md").read_text(encoding="utf-8")
    assert "could not be reconstructed" in report
    assert expected in report
    assert json.loads((folder / "out" / "decision.json").read_text(encoding="utf-8"))["status"] == "failed"
    assert not (folder / "out" / "elevation.tif").exists()


@pytest.mark.parametrize("engine", ["experta", "compiled"])
def test_the_decision_does_not_depend_on_the_order_of_hashes(folder: Path, engine: str) -> None:
    left, right = shifted(3)
    cv2.imwrite("right.png", (right * 0.5 + 10).astype(np.uint8))
    cv2.imwrite("left.png", left)
    program = "from expert.cli import main; main()"
    ids = set()
    for seed in ("1", "2"):
        said = subprocess.run(
            [sys.executable, "-c", program, "decide", "left.png", "right.png", "--json", "--engine", engine],
            capture_output=True,
            timeout=60,
            check=True,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONHASHSEED": seed},
        ).stdout
        ids.add(json.loads(said)["decision_id"])
    assert len(ids) == 1


def test_in_a_pipe_there_is_no_progress_and_no_colour(folder: Path) -> None:
    program = "from expert.cli import main; main()"
    ended = subprocess.run(
        [sys.executable, "-c", program, "decide", "left.png", "right.png"],
        capture_output=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "FORCE_COLOR": ""},
    )
    assert ended.returncode == 0, ended.stderr.decode()
    assert ended.stderr == b""
    assert b"\x1b" not in ended.stdout
    assert b"\r" not in ended.stdout.replace(os.linesep.encode(), b"\n")
