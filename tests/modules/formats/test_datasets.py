"""Data sets in the layouts that are in use."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from modules.formats import FormatError, write_disparity_png, write_image, write_pfm
from modules.formats.datasets import list_pairs, read_index

IMAGE = np.arange(20 * 30, dtype=np.uint8).reshape(20, 30)
TRUTH = np.full((20, 30), 5.5, np.float32)


def middlebury(folder: Path, scene: str, ndisp: str = "ndisp=64\n") -> Path:
    home = folder / scene
    home.mkdir(parents=True)
    for name in ("im0.png", "im1.png"):
        write_image(home / name, IMAGE)
    (home / "calib.txt").write_text(f"cam0=[1 0 0; 0 1 0; 0 0 1]\n{ndisp}", encoding="utf-8")
    return home


def test_middlebury_scenes_are_read_with_truth_and_mask(tmp_path: Path) -> None:
    home = middlebury(tmp_path, "Adirondack")
    write_pfm(home / "disp0GT.pfm", TRUTH)
    mask = np.full((20, 30), 255, np.uint8)
    mask[:, :10] = 128
    write_image(home / "mask0nocc.png", mask)
    (entry,) = list_pairs(tmp_path)
    pair = entry.load()
    assert (pair.group, pair.ndisp) == ("Adirondack", 64)
    assert pair.scored is not None
    assert int(pair.scored.sum()) == 20 * 20


def test_eth3d_truth_lies_in_a_folder_beside(tmp_path: Path) -> None:
    middlebury(tmp_path / "two_view_training", "terrace_1s", ndisp="")
    home = tmp_path / "two_view_training_gt" / "terrace_1s"
    home.mkdir(parents=True)
    write_pfm(home / "disp0GT.pfm", TRUTH)
    (entry,) = list_pairs(tmp_path / "two_view_training")
    assert entry.load().ndisp == 16  # 5.5 px, rounded up


def test_kitti_frames_with_truth_are_read(tmp_path: Path) -> None:
    for name in ("image_2", "image_3", "disp_noc_0"):
        (tmp_path / "training" / name).mkdir(parents=True)
    for frame in ("000000_10.png", "000000_11.png"):
        write_image(tmp_path / "training" / "image_2" / frame, IMAGE)
        write_image(tmp_path / "training" / "image_3" / frame, IMAGE)
    truth = TRUTH.copy()
    truth[:5] = np.nan
    write_disparity_png(tmp_path / "training" / "disp_noc_0" / "000000_10.png", truth)
    (entry,) = list_pairs(tmp_path)
    pair = entry.load()
    assert (pair.ndisp, pair.views.shape) == (192, (20, 30))
    assert pair.scored is not None
    assert int(pair.scored.sum()) == 15 * 30


def test_an_index_may_hold_scaled_truth(tmp_path: Path) -> None:
    write_image(tmp_path / "l.png", IMAGE)
    stored = np.full((20, 30), 22, np.uint8)
    stored[0] = 0
    write_image(tmp_path / "gt.png", stored)
    entry = {
        "dataset": "d",
        "scene": "s",
        "left": "l.png",
        "right": "l.png",
        "ndisp": 16,
        "gt": "gt.png",
        "gt_scale": 4,
    }
    (tmp_path / "INDEX.json").write_text(json.dumps([entry]))
    (pair,) = read_index(tmp_path)
    assert pair.truth_px is not None
    assert float(pair.truth_px[1, 0]) == 5.5
    assert np.isnan(pair.truth_px[0]).all()


def test_pairs_of_one_scene_have_names_of_their_own(tmp_path: Path) -> None:
    entry = {"dataset": "d", "scene": "Art", "ndisp": 16}
    lefts = ("a/l.png", "b/l.png", "b/l.png")
    entries = [{**entry, "left": left, "right": "r.png"} for left in lefts]
    (tmp_path / "INDEX.json").write_text(json.dumps(entries))
    assert [item.name for item in list_pairs(tmp_path)] == ["d/Art", "d/Art, b", "d/Art, 2"]


def test_a_truth_of_another_size_is_refused(tmp_path: Path) -> None:
    home = middlebury(tmp_path, "Shelves")
    write_pfm(home / "disp0GT.pfm", TRUTH[:, :20])
    (entry,) = list_pairs(tmp_path)
    with pytest.raises(FormatError, match=r"disp0GT.pfm is 20x20 and .*im0.png is 30x20; give the truth of this image"):
        entry.load()


def test_without_any_range_a_pair_is_refused(tmp_path: Path) -> None:
    middlebury(tmp_path, "Shelves", ndisp="")
    (entry,) = list_pairs(tmp_path)
    with pytest.raises(FormatError, match="neither the data set nor a truth says how many disparities to search"):
        entry.load()


def test_a_folder_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"is no data set: it has no INDEX.json, no folders with im0.png"):
        list_pairs(tmp_path)


def test_a_missing_entry_field_is_named(tmp_path: Path) -> None:
    (tmp_path / "INDEX.json").write_text(json.dumps([{"dataset": "d", "scene": "s", "left": "l.png"}]))
    with pytest.raises(FormatError, match=r"INDEX.json: entry 0 has no 'right'; add it"):
        list_pairs(tmp_path)


def test_a_split_without_pairs_is_named(tmp_path: Path) -> None:
    middlebury(tmp_path, "Shelves")
    with pytest.raises(FormatError, match="holds no pair of split 'test' in the layout 'middlebury'"):
        list_pairs(tmp_path, split="test")
