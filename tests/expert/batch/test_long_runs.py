"""What long runs meet: strange names, other file systems, full disks, several cameras, logs of the inertial unit."""

from __future__ import annotations

import json
import os
import resource
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from expert.api import ExpertSystem
from expert.batch import Batch, BatchItem, Outcome, RunLog, Settings, Stated, find_pairs, timed
from expert.batch.runlog import NAME, LogFull
from expert.batch.work import inputs_digest, pack, process, process_packed
from expert.decision import Decision
from modules.formats import FormatError, read_validity_png, write_image
from modules.types import Invalid
from tests.expert.batch.conftest import write_pair

FAST = Settings(profile="fast", engine="compiled", html=False, common=Stated(disparity_range_px=(0, 32)))
RIG = "focal_px: {focal}\ncx_px: 95\ncy_px: 60\nbaseline_m: 0.1\nwidth_px: 190\nheight_px: 120\n"


@pytest.fixture(scope="module")
def system() -> ExpertSystem:
    return FAST.system()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[Path]:
    """A folder on another file system than the temporary one, where there is one."""
    shared = Path("/dev/shm")
    apart = shared.is_dir() and os.access(shared, os.W_OK) and shared.stat().st_dev != tmp_path.stat().st_dev
    home = Path(tempfile.mkdtemp(dir=shared if apart else tmp_path))
    yield home
    shutil.rmtree(home)


def state(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in sorted(folder.rglob("*"))}


def fact(decision: str, template: str) -> dict[str, Any]:
    records = json.loads(decision)["facts"]
    return dict(next(item["fields"] for item in records if item["template"] == template))


def item(folder: Path, stated: Stated | None = None, name: str = "one") -> BatchItem:
    write_pair(folder, name, seed=3)
    made = BatchItem(name, folder / f"left_{name}.png", folder / f"right_{name}.png", stated or Stated())
    return FAST.complete(made)


def test_strange_names_a_source_that_nobody_may_write_and_another_file_system(tmp_path: Path, elsewhere: Path) -> None:
    source = tmp_path / "sol 7\nGröße"
    for seed, name in enumerate(("plain", "with space", "new\nline", "ümläut 火星")):
        write_pair(source, name, seed)
    before = state(source)
    for path in (*source.iterdir(), source):
        path.chmod(0o555 if path.is_dir() else 0o444)
    batch = Batch(find_pairs(source), elsewhere / "out ü\nput", FAST)
    batch.run(batch.plan())
    source.chmod(0o755)
    assert state(source) == before
    assert batch.plan().done == 4
    records = sorted((elsewhere / "out ü\nput" / "pairs").glob("*/decision.json"))
    assert len(records) == 4
    assert {Decision.from_json(path.read_text(encoding="utf-8")).status for path in records} == {"disparity_only"}


def test_every_pair_of_a_manifest_may_have_a_camera_of_its_own(tmp_path: Path, system: ExpertSystem) -> None:
    write_pair(tmp_path, "a", seed=1)
    write_pair(tmp_path, "b", seed=2)
    for focal in (200, 300):
        (tmp_path / f"rig_{focal}.yaml").write_text(RIG.format(focal=focal))
    lines = ["left,right,calibration", "left_a.png,right_a.png,rig_200.yaml", "left_b.png,right_b.png,rig_300.yaml"]
    (tmp_path / "pairs.csv").write_text("\n".join(lines))
    settings = replace(FAST, products=())
    found = [
        process(system, settings.complete(one), tmp_path / "out" / one.name, settings)
        for one in find_pairs(tmp_path / "pairs.csv")
    ]
    assert [fact(outcome.decision, "rig")["focal_px"] for outcome in found] == [200.0, 300.0]


SENSOR = """T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, {x}, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
resolution: [190, 120]
camera_model: pinhole
intrinsics: [200.0, 200.0, 95.0, 60.0]
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.01, 0.0, 0.0]
"""


def test_a_euroc_sequence_is_rectified_by_the_files_of_its_sensors(tmp_path: Path, system: ExpertSystem) -> None:
    write_pair(tmp_path, "a", seed=1)
    for side, camera, x_m in (("left", "cam0", 0.0), ("right", "cam1", 0.11)):
        (tmp_path / f"seq/mav0/{camera}/data").mkdir(parents=True)
        (tmp_path / f"{side}_a.png").rename(tmp_path / f"seq/mav0/{camera}/data/1403636579763555584.png")
        (tmp_path / f"seq/mav0/{camera}/sensor.yaml").write_text(SENSOR.format(x=x_m))
    (one,) = find_pairs(tmp_path / "seq")
    outcome = process(system, FAST.complete(one), tmp_path / "out", FAST)
    rig = fact(outcome.decision, "rig")
    assert (rig["rectified_here"], rig["baseline_m"]) == (True, 0.11)


def imu_log(folder: Path) -> Path:
    path = folder / "imu.csv"
    path.write_text("time_s,roll_deg,pitch_deg,yaw_deg\n" + "".join(f"{t / 10},{t},{-t},0\n" for t in range(11)))
    return path


def test_the_attitude_of_a_pair_is_read_from_the_log_at_its_time(tmp_path: Path, system: ExpertSystem) -> None:
    stated = Stated(imu=imu_log(tmp_path), time_s=0.45)
    outcome = process(system, item(tmp_path, stated), tmp_path / "out", FAST)
    known = fact(outcome.decision, "attitude")
    assert (known["roll_deg"], known["pitch_deg"]) == pytest.approx((4.5, -4.5), abs=0.1)


def test_a_time_that_the_log_does_not_reach_costs_that_pair_alone(tmp_path: Path, system: ExpertSystem) -> None:
    outcome = process(system, item(tmp_path, Stated(imu=imu_log(tmp_path), time_s=7.0)), tmp_path / "out", FAST)
    assert outcome.status == "unreadable"
    assert "7" in outcome.reason


def test_times_are_taken_from_names_in_their_unit(tmp_path: Path) -> None:
    named = BatchItem("mav0/data/1403636579763555584", tmp_path / "l", tmp_path / "r")
    (found,) = timed([named], "ns")
    assert found.stated.time_s == pytest.approx(1403636579.7635555, abs=1e-6)
    stated = replace(named, stated=Stated(time_s=2.0))
    assert timed([stated], "ns") == (stated,)
    level = replace(named, stated=Stated(angles_deg=(1.0, 2.0, None)))
    assert timed([level], None) == (level,)
    with pytest.raises(FormatError, match=r"1 of 2 pairs state no time .*\('mav0/data/1403636579763555584'\); give a"):
        timed([named, stated])


def test_of_the_ways_to_state_an_attitude_a_pair_keeps_its_own(tmp_path: Path) -> None:
    common = Stated(attitude=tmp_path / "level.yaml", rectified=True)
    assert Stated(angles_deg=(1.0, 2.0, None)).over(common).attitude is None
    assert Stated().over(common) == common


def test_whatever_is_stated_changes_the_digest_of_the_inputs(tmp_path: Path) -> None:
    log = imu_log(tmp_path)
    states = [
        Stated(),
        Stated(calibration=(log,)),
        Stated(attitude=log),
        Stated(imu=log, time_s=0.1),
        Stated(imu=log, time_s=0.2),
        Stated(angles_deg=(0.0, 0.0, None)),
        Stated(angles_deg=(0.0, 0.0, 0.0)),
        Stated(disparity_range_px=(0, 16)),
        Stated(rectified=True),
        Stated(alpha=0.5),
        Stated(scale_calibration=True),
        Stated(convention="aerospace"),
        Stated(mask=log),
        Stated(datum_deg=(48.0, 11.0)),
    ]
    digests = {inputs_digest(BatchItem("x", log, log, stated)) for stated in states}
    assert len(digests) == len(states)


def test_a_pair_that_travels_with_its_files_gives_the_same(tmp_path: Path, system: ExpertSystem) -> None:
    (tmp_path / "rig.yaml").write_text(RIG.format(focal=200))
    write_image(
        tmp_path / "mask.png", np.where(np.arange(120)[:, None] < 60, 255, np.zeros((120, 190))).astype(np.uint8)
    )
    stated = Stated((tmp_path / "rig.yaml",), imu=imu_log(tmp_path), time_s=0.5, mask=tmp_path / "mask.png")
    one = item(tmp_path, stated)
    here = process(system, one, tmp_path / "out", FAST)
    there = process_packed(system, pack(one), FAST)
    assert there.decision_id == here.decision_id
    assert there.products is not None
    assert fact(there.decision, "attitude")["pitch_deg"] == pytest.approx(-5.0, abs=0.1)
    validity = read_validity_png(tmp_path / "out" / "validity.png")
    assert (validity[60:] & Invalid.MASKED).all()
    assert not (validity[:60] & Invalid.MASKED).any()


def test_a_mask_of_another_size_costs_that_pair_alone(tmp_path: Path, system: ExpertSystem) -> None:
    write_image(tmp_path / "mask.png", np.full((60, 95), 255, np.uint8))
    outcome = process(system, item(tmp_path, Stated(mask=tmp_path / "mask.png")), tmp_path / "out", FAST)
    assert outcome.status == "unreadable"
    assert "make the mask on the rectified left image" in outcome.reason


def test_a_place_gives_the_map_of_its_pair_a_reference_system(tmp_path: Path, system: ExpertSystem) -> None:
    rasterio = pytest.importorskip("rasterio")
    (tmp_path / "rig.yaml").write_text(RIG.format(focal=200))
    settings = replace(FAST, products=("elevation.tif",))
    stated = Stated((tmp_path / "rig.yaml",), angles_deg=(0.0, 0.0, 0.0), datum_deg=(48.0, 11.0))
    process(system, item(tmp_path, stated), tmp_path / "out", settings)
    with rasterio.open(tmp_path / "out" / "elevation.tif") as file:
        assert file.crs.to_dict()["lat_0"] == 48.0


def test_all_workers_and_later_runs_keep_a_time_budget_by_one_speed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_pair(tmp_path / "source", "1", seed=1)
    items = find_pairs(tmp_path / "source")
    budget = replace(FAST, time_budget_s=0.5, memory_budget_mb=100.0)
    monkeypatch.setattr("expert.batch.run.measure_speed", lambda: 1.25)
    first = Batch(items, tmp_path / "out", budget)
    first.run(first.plan())
    record = (tmp_path / "out" / "pairs" / "1" / "decision.json").read_text(encoding="utf-8")
    task = fact(record, "task")
    assert (task["time_budget_s"], task["machine_speed"], task["memory_budget_mb"]) == (0.5, 1.25, 100.0)
    monkeypatch.setattr("expert.batch.run.measure_speed", lambda: 2.0)
    assert Batch(items, tmp_path / "out", budget).plan().todo == ()
    less = Batch(items, tmp_path / "out", replace(budget, time_budget_s=0.1)).plan("redo")
    assert less.changes == ("time budget 0.5 s at speed 1.25, now 0.1 s at speed 1.25",)


@contextmanager
def files_end_at(size: int) -> Iterator[None]:
    """Let no file grow beyond some bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_products_that_find_no_room_are_an_error_of_that_pair(tmp_path: Path, system: ExpertSystem) -> None:
    with files_end_at(50_000):
        outcome = process(system, item(tmp_path), tmp_path / "out", FAST)
    assert outcome.status == "error"
    assert "File too large); make room on the disk" in outcome.reason
    assert not (tmp_path / "out").exists()


def test_a_log_that_finds_no_room_says_what_to_do_and_keeps_what_it_has(tmp_path: Path) -> None:
    log = RunLog(tmp_path / NAME)
    run = log.begin("source", {}, "digest", {})
    log.add(run, Outcome("first", "error"), "", "digest")
    with files_end_at(1000), pytest.raises(LogFull, match="make room on the disk and give the same command again"):
        log.add(run, Outcome("second", "error"), "", "digest")
    assert list(RunLog(tmp_path / NAME).latest()) == ["first"]


def test_a_log_that_another_program_holds_is_not_taken_for_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def held(_: RunLog) -> NoReturn:
        raise sqlite3.OperationalError("database is locked")

    log = RunLog(tmp_path / NAME)
    monkeypatch.setattr(RunLog, "_open", held)
    with pytest.raises(FormatError, match=r"cannot be written \(database is locked\)") as caught:
        log.add(1, Outcome("first", "error"), "", "digest")
    assert not isinstance(caught.value, LogFull)


def test_products_that_leave_no_room_for_the_log_make_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "source"
    write_pair(source, "1", seed=1)
    write_pair(source, "2", seed=2)
    batch = Batch(find_pairs(source), tmp_path / "out", FAST)
    add = RunLog.add

    def full_until_products_go(log: RunLog, run: int, outcome: Outcome, folder: str, digest: str) -> None:
        if (tmp_path / "out" / "pairs" / "2").exists():
            raise LogFull("full")
        add(log, run, outcome, folder, digest)

    monkeypatch.setattr(RunLog, "add", full_until_products_go)
    batch.run(batch.plan())
    found = RunLog(tmp_path / "out" / NAME).latest()
    assert {name: latest.status for name, latest in found.items()} == {"1": "disparity_only", "2": "error"}
    assert not (tmp_path / "out" / "pairs" / "2").exists()


def test_a_log_in_a_folder_that_cannot_be_written_is_read(tmp_path: Path) -> None:
    log = RunLog(tmp_path / NAME)
    log.add(log.begin("source", {}, "digest", {}), Outcome("first", "error"), "", "digest")
    (tmp_path / f"{NAME}-shm").mkdir()  # where SQLite would write to read
    found = RunLog(tmp_path / NAME, read_only=True)
    assert found.query("SELECT pair FROM results")[1] == [("first",)]


def test_what_is_other_than_it_was_is_named(tmp_path: Path) -> None:
    source, out = tmp_path / "source", tmp_path / "out"
    write_pair(source, "1", seed=1)
    batch = Batch(find_pairs(source), out, FAST)
    batch.run(batch.plan())
    other = Batch(find_pairs(source), out, replace(FAST, profile="balanced"))
    assert other.plan("redo").changes == ("profile fast, now balanced",)
    other.versions = {**other.versions, "numpy": "99"}
    assert other.plan("redo").changes[1].endswith(", now 99")
    assert other.plan("keep").todo == ()
