"""A saved plan, run again without any rule."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from synthetic_pairs import shifted, shifted_pair

from expert import ExpertSystem
from expert.cli import main
from expert.decision import Decision
from expert.plan import PlanError
from expert.replay import ReplayError, load_recorded_pair, replay, run_plans
from expert.result import Result
from modules.types import Attitude, Calibration

CALIBRATION = Calibration(focal_px=200.0, cx_px=80.0, cy_px=60.0, baseline_m=0.1, width_px=160, height_px=120)


@pytest.fixture(scope="module")
def made() -> Result:
    _, right = shifted()
    pair = replace(
        shifted_pair(calibration=CALIBRATION, attitude=Attitude(pitch_rad=0.1)),
        right=(right // 2 + 20).astype(np.uint8),
    )
    return ExpertSystem(profile="balanced", engine="compiled").reconstruct(pair)


@pytest.fixture
def files(tmp_path: Path, made: Result) -> Path:
    """Give a folder with the pair and the saved run."""
    assert made.original is not None
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{side}.png"), getattr(made.original, side))
    other = made.original.right.copy()
    other[40:80, 60:100] = 90
    cv2.imwrite(str(tmp_path / "other.png"), other)
    made.save(tmp_path / "run", html=False)
    return tmp_path


def test_a_saved_plan_gives_the_same_bytes(files: Path, made: Result) -> None:
    decision = Decision.from_json((files / "run" / "decision.json").read_text(encoding="utf-8"))
    again = replay(decision, load_recorded_pair(decision.inputs, files / "left.png", files / "right.png"))
    assert again.same, again.text()
    assert {"disparity_px", "validity", "elevation_m", "left image", "calibration"} <= set(again.verified)
    np.testing.assert_array_equal(again.result.disparity_px, made.disparity_px)
    assert again.result.points is not None
    assert made.points is not None
    np.testing.assert_array_equal(again.result.points.xyz_m, made.points.xyz_m)


def test_another_image_is_named_and_so_is_what_it_changes(files: Path) -> None:
    decision = Decision.from_json((files / "run" / "decision.json").read_text(encoding="utf-8"))
    again = replay(decision, load_recorded_pair(decision.inputs, files / "left.png", files / "other.png"))
    assert not again.same
    assert any(text.startswith("right image: the record has ") for text in again.differences)
    assert any(text.startswith("disparity_px: the record has ") for text in again.differences)
    assert not any(text.startswith("left image") for text in again.differences)


def test_exchanged_images_are_recognised(files: Path) -> None:
    decision = Decision.from_json((files / "run" / "decision.json").read_text(encoding="utf-8"))
    with pytest.raises(ReplayError, match="the inputs are not those of the record: left and right are exchanged"):
        replay(decision, load_recorded_pair(decision.inputs, files / "right.png", files / "left.png"))


def test_another_version_is_named_where_products_differ(made: Result) -> None:
    versions = {**made.decision.versions, "numpy": "0.1"}
    products = {**made.decision.products, "disparity_px": "0" * 64}
    changed = made.decision.model_copy(update={"versions": versions, "products": products})
    again = replay(changed, shifted_pair(calibration=CALIBRATION, attitude=Attitude(pitch_rad=0.1)))
    assert any(text.startswith("numpy was 0.1 and is ") for text in again.differences)


def test_a_plan_runs_from_the_stages_it_has(made: Result) -> None:
    pair = shifted_pair()
    matching, scene = run_plans({"matching": made.decision.plans["matching"]}, pair)
    assert matching.disparity is not None
    assert scene is None


def test_a_plan_of_another_installation_is_refused_by_its_operator(made: Result) -> None:
    plan = made.decision.plans["matching"]
    steps = (plan.steps[0].model_copy(update={"operator": "matching.gone"}), *plan.steps[1:])
    with pytest.raises(PlanError, match=r"slot matching.range: there is no operator 'matching.gone'"):
        run_plans({"matching": plan.model_copy(update={"steps": steps})}, shifted_pair())


def test_a_record_without_a_plan_and_pairs_that_no_file_holds_are_refused(made: Result) -> None:
    with pytest.raises(ReplayError, match="the record has no plan to run"):
        replay(made.decision.model_copy(update={"plans": {}}), shifted_pair())
    inputs = made.decision.inputs
    with pytest.raises(ReplayError, match="give the calibration of that run with --calibration"):
        load_recorded_pair(inputs.model_copy(update={"rectified_here": True}), "left.png", "right.png")
    with pytest.raises(ReplayError, match="the pair of this record had masks"):
        load_recorded_pair(inputs.model_copy(update={"left_mask": inputs.left}), "left.png", "right.png")


def terrex(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    monkeypatch.setattr(sys, "argv", ["terrex", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_the_command_verifies_and_writes(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = files / "run" / "decision.json"
    assert terrex(monkeypatch, "replay", record, files / "left.png", files / "right.png", "--out", files / "again") == 0
    assert "same: elevation_m" in capsys.readouterr().out
    for name in ("disparity.pfm", "elevation.tif", "decision.json"):
        assert (files / "again" / name).read_bytes() == (files / "run" / name).read_bytes()
    assert terrex(monkeypatch, "replay", record, files / "left.png", files / "other.png") == 1
    said = capsys.readouterr().out
    assert "differs: right image" in said
    assert f"disparity against {files / 'run' / 'disparity.pfm'}: " in said
    assert terrex(monkeypatch, "replay", record, files / "left.png", files / "none.png") == 2
