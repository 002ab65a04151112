"""Where the pairs of a batch come from."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from expert.batch import ManifestError, find_pairs, select
from expert.batch.item import BatchItem, Stated
from modules.formats import FormatError


def touch(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"image")


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["left_01.png", "right_01.png", "left_02.png"], ["01"]),
        (["001_left.jpg", "001_right.jpg", "002-left.jpg", "002-right.jpg"], ["001", "002"]),
        (["Left/a.png", "Right/a.png"], ["a"]),
        (["day 1/left/a.png", "day 1/right/a.png"], ["day 1/a"]),
        (["image_2/000000_10.png", "image_3/000000_10.png"], ["000000_10"]),
        (["mav0/cam0/data/140.png", "mav0/cam1/data/140.png"], ["mav0/data/140"]),
        (["Pipes/im0.png", "Pipes/im1.png", "Vintage/im0.png", "Vintage/im1.png"], ["Pipes", "Vintage"]),
        (["left01.jpg", "right01.jpg", "left14.jpg", "right14.jpg"], ["01", "14"]),
        (["sol 1/left\nhand.png", "sol 1/right\nhand.png"], ["sol 1/hand"]),
        (["Größe left ü.png", "Größe right ü.png"], ["Größe  ü"]),
    ],
)  # fmt: skip
def test_pairs_differ_in_the_name_of_the_camera_only(files: list[str], names: list[str], tmp_path: Path) -> None:
    touch(tmp_path, *files)
    found = find_pairs(tmp_path)
    assert [item.name.replace("\n", "") for item in found] == names
    assert all(item.left != item.right and item.left.is_file() and item.right.is_file() for item in found)


def test_words_that_hold_the_name_of_a_camera_are_no_cameras(tmp_path: Path) -> None:
    touch(tmp_path, "leftover.png", "rightover.png", "im01.png", "im11.png")
    with pytest.raises(FormatError, match="holds 4 images but no pair of files named left and right"):
        find_pairs(tmp_path)


def test_a_calibration_above_the_images_is_theirs(tmp_path: Path) -> None:
    touch(tmp_path, "a/left/1.png", "a/right/1.png", "b/left/1.png", "b/right/1.png", "calib.yaml", "a/calib.txt")
    assert [item.stated.calibration for item in find_pairs(tmp_path)] == [
        (tmp_path / "a/calib.txt",),
        (tmp_path / "calib.yaml",),
    ]


def test_own_patterns_pair_by_what_the_star_stands_for(tmp_path: Path) -> None:
    touch(tmp_path, "L/x1.png", "L/x2.png", "R/y1.png")
    found = find_pairs(tmp_path, ("L/x*.png", "R/y*.png"))
    assert [(item.name, item.right.name) for item in found] == [("1", "y1.png")]
    with pytest.raises(FormatError, match=r"--pattern 'L/x.png' has 0 stars; give one, e.g. 'left/\*.png'"):
        find_pairs(tmp_path, ("L/x.png", "R/y*.png"))


def test_results_in_the_source_are_no_pairs(tmp_path: Path) -> None:
    touch(tmp_path, "day/left.png", "day/right.png")
    touch(
        tmp_path,
        "day/out/.terrex",
        "day/out/decision.json",
        "day/out/left_corrected.png",
        "day/out/right_corrected.png",
    )
    touch(
        tmp_path, "results/run.sqlite", "results/pairs/day/left_corrected.png", "results/pairs/day/right_corrected.png"
    )
    assert [item.name for item in find_pairs(tmp_path)] == ["day"]


def test_no_pair_is_dropped_for_its_name(tmp_path: Path) -> None:
    touch(tmp_path, "a_left.png", "a_right.png", "left_a.png", "right_a.png")
    assert sorted(item.name for item in find_pairs(tmp_path)) == ["a", "left_a"]


def test_an_image_without_its_other_one_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    touch(tmp_path, "left_1.png", "right_1.png", "left_2.png", "map.png")
    assert [item.name for item in find_pairs(tmp_path)] == ["1"]
    assert "1 images have no partner of the other camera and are left out: 'left_2.png'" in caplog.text


def test_a_loop_of_links_ends(tmp_path: Path) -> None:
    touch(tmp_path, "a/left.png", "a/right.png")
    os.symlink(tmp_path, tmp_path / "a" / "loop")
    assert len(find_pairs(tmp_path)) == 1


def test_items_have_folders_of_their_own() -> None:
    names = ["a/b", "a%2Fb", "a b", "..", ".hidden", "new\nline", "x" * 400, "x" * 399 + "y", "ü"]
    folders = [BatchItem(name, Path("l"), Path("r")).folder for name in names]
    assert len(set(folders)) == len(names)
    for folder in folders:
        assert "/" not in folder
        assert "\n" not in folder
        assert not folder.startswith(".")
        assert len(folder.encode()) <= 120


def test_a_missing_source_is_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"gone is neither a folder nor a manifest \(.csv, .jsonl\); check the path"):
        find_pairs(tmp_path / "gone")


def test_a_csv_manifest_states_what_is_known(tmp_path: Path) -> None:
    touch(tmp_path, "l 1.png", "r,1.png", "c.yaml")
    (tmp_path / "m.csv").write_text(
        "name,left,right,calibration,pitch_deg,min_disparity_px,max_disparity_px\n"
        'first,l 1.png,"r,1.png",c.yaml,-8,0,64\n',
        encoding="utf-8",
    )
    (item,) = find_pairs(tmp_path / "m.csv")
    stated = Stated((tmp_path / "c.yaml",), angles_deg=(0.0, -8.0, None), disparity_range_px=(0, 64))
    assert item == BatchItem("first", tmp_path / "l 1.png", tmp_path / "r,1.png", stated)


def test_a_jsonl_manifest_is_read(tmp_path: Path) -> None:
    touch(tmp_path, "l\n.png", "r.png")
    (tmp_path / "m.jsonl").write_text(json.dumps({"left": "l\n.png", "right": "r.png"}) + "\n\n")
    (item,) = find_pairs(tmp_path / "m.jsonl")
    assert item.left.name == "l\n.png"


def test_all_errors_of_a_manifest_are_listed_by_line(tmp_path: Path) -> None:
    touch(tmp_path, "l.png", "r.png")
    (tmp_path / "m.csv").write_text(
        "left,right,roll_deg,min_disparity_px,max_disparity_px\n"
        "l.png,r.png,flat,,\n"
        "gone.png,r.png,,,\n"
        "l.png,r.png\n"
        ",r.png,,,\n"
        "l.png,r.png,,64,0\n"
        "l.png,r.png,,0.5,64\n"
    )
    with pytest.raises(ManifestError) as found:
        find_pairs(tmp_path / "m.csv")
    said = str(found.value).replace(f"{tmp_path / 'm.csv'}: ", "").splitlines()
    assert said == [
        "line 2: roll_deg 'flat' is no number",
        "line 3: left 'gone.png' is no file; paths are relative to the manifest",
        "line 4: 2 values and 5 columns; quote values with commas",
        "line 5: left is missing; give the path of the left image",
        "line 6: disparity range 64 0 is empty; the second number must be larger",
        "line 6: the name 'l' stands in line 2 already; give another name",
        "line 7: min_disparity_px '0.5' is no whole number of px",
        "line 7: the name 'l' stands in line 2 already; give another name",
    ]


def test_every_wrong_one_of_ten_thousand_lines_is_named(tmp_path: Path) -> None:
    touch(tmp_path, "l.png", "r.png")
    good, bad = "{i},l.png,r.png\n", "{i},l.png,gone.png\n"
    lines = "".join((bad if i % 3 == 0 else good).format(i=i) for i in range(10_000))
    (tmp_path / "m.csv").write_text("name,left,right\n" + lines)
    with pytest.raises(ManifestError) as found:
        find_pairs(tmp_path / "m.csv")
    said = str(found.value).splitlines()
    assert len(said) == 3334
    assert (
        said[-1] == f"{tmp_path / 'm.csv'}: line 10001: right 'gone.png' is no file; paths are relative to the manifest"
    )


def test_filters_and_limits_keep_the_order(tmp_path: Path) -> None:
    touch(tmp_path, *(f"d{day}/{side}_{i}.png" for day in (1, 2) for i in (1, 2) for side in ("left", "right")))
    items = find_pairs(tmp_path)
    assert [item.name for item in select(items, "d2/*", None)] == ["d2/1", "d2/2"]
    assert [item.name for item in select(items, None, 3)] == ["d1/1", "d1/2", "d2/1"]


def test_numbers_in_names_count_as_numbers(tmp_path: Path) -> None:
    touch(tmp_path, *(f"{side}_{i}.png" for i in (10, 9, 100) for side in ("left", "right")))
    assert [item.name for item in find_pairs(tmp_path)] == ["9", "10", "100"]


def test_the_calibrations_of_kitti_are_found_by_frame_and_by_day(tmp_path: Path) -> None:
    for number in ("000000", "000001"):
        touch(tmp_path, f"2015/image_2/{number}_10.png", f"2015/image_3/{number}_10.png", f"day/image_0/{number}.png")
        touch(tmp_path, f"2015/calib_cam_to_cam/{number}.txt", f"day/image_1/{number}.png")
    touch(tmp_path, "day/calib_cam_to_cam.txt")
    found = {item.name: item.stated.calibration for item in find_pairs(tmp_path)}
    frames = {f"2015/00000{i}_10": (tmp_path / f"2015/calib_cam_to_cam/00000{i}.txt",) for i in (0, 1)}
    assert found == frames | {f"day/00000{i}": (tmp_path / "day/calib_cam_to_cam.txt",) for i in (0, 1)}


@pytest.mark.parametrize(
    ("sides", "files"),
    [
        (("mav0/cam0/data", "mav0/cam1/data"), ("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml")),
        (("day/left", "day/right"), ("day/left.yaml", "day/right.yaml")),
        (("image_0", "image_1"), ("intrinsics.yml", "extrinsics.yml")),
    ],
)
def test_the_two_files_of_a_calibration_are_found(
    sides: tuple[str, str], files: tuple[str, str], tmp_path: Path
) -> None:
    touch(tmp_path, *(f"{side}/140.png" for side in sides), files[0])
    assert [item.stated.calibration for item in find_pairs(tmp_path)] == [()]
    touch(tmp_path, files[1])
    both = tuple(tmp_path / name for name in files)
    assert [item.stated.calibration for item in find_pairs(tmp_path)] == [both]
    touch(tmp_path, f"{sides[0]}/calib.txt")
    assert [item.stated.calibration for item in find_pairs(tmp_path)] == [(tmp_path / sides[0] / "calib.txt",)]


def test_two_files_of_one_calibration_and_a_log_with_a_time_are_read(tmp_path: Path) -> None:
    touch(tmp_path, "l.png", "r.png", "in.yml", "ex.yml", "imu.csv")
    (tmp_path / "m.csv").write_text(
        "left,right,calibration,calibration_2,imu,time_s\nl.png,r.png,in.yml,ex.yml,imu.csv,1.5\n"
    )
    (item,) = find_pairs(tmp_path / "m.csv")
    both = (tmp_path / "in.yml", tmp_path / "ex.yml")
    assert item.stated == Stated(both, imu=tmp_path / "imu.csv", time_s=1.5)


def test_the_place_and_the_mask_of_a_pair_are_read(tmp_path: Path) -> None:
    touch(tmp_path, "l.png", "r.png", "mask.png")
    head = "left,right,mask,latitude_deg,longitude_deg\n"
    (tmp_path / "m.csv").write_text(head + "l.png,r.png,mask.png,48.1,11.5\n")
    (item,) = find_pairs(tmp_path / "m.csv")
    assert item.stated == Stated(mask=tmp_path / "mask.png", datum_deg=(48.1, 11.5))
    (tmp_path / "m.csv").write_text(head + "l.png,r.png,gone.png,48.1,\nl.png,r.png,,99,0\n")
    with pytest.raises(ManifestError) as found:
        find_pairs(tmp_path / "m.csv")
    said = str(found.value).replace(f"{tmp_path / 'm.csv'}: ", "").splitlines()
    assert said == [
        "line 2: mask 'gone.png' is no file; paths are relative to the manifest",
        "line 2: half of a place is given; give latitude_deg and longitude_deg",
        "line 3: datum 99 0 is no place; give latitude -90 to 90 and longitude -180 to 180, in degrees",
        "line 3: the name 'l' stands in line 2 already; give another name",
    ]


def test_halves_and_doubles_in_a_manifest_are_named(tmp_path: Path) -> None:
    touch(tmp_path, "l.png", "r.png", "a")
    rows = (
        {"calibration_2": "a"},
        {"imu": "a"},
        {"imu": "a", "time_s": 1, "roll_deg": 2},
        {"attitude": "a", "pitch_deg": 2},
    )
    lines = [json.dumps({"name": str(i), "left": "l.png", "right": "r.png", **row}) for i, row in enumerate(rows)]
    (tmp_path / "m.jsonl").write_text("\n".join(lines))
    with pytest.raises(ManifestError) as found:
        find_pairs(tmp_path / "m.jsonl")
    assert str(found.value).replace(f"{tmp_path / 'm.jsonl'}: ", "").splitlines() == [
        "line 1: calibration_2 is given without calibration; give both, or the one file as calibration",
        "line 2: imu is given without time_s; give the time of the pair on the clock of the log",
        "line 3: imu and angles are given; an attitude is stated in one way, leave out the others",
        "line 4: attitude and angles are given; an attitude is stated in one way, leave out the others",
    ]
