"""Evaluations end to end on tiny pairs: scores, resuming, ablation, the command."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import cv2
import numpy as np
import pytest

from expert.cli import main
from expert.evaluate import ExpertConfiguration, RenderedTerrain, Store, evaluate, expand, fixed_grid, parse_variants
from expert.evaluate.ablation import ablate
from expert.evaluate.scores import score
from expert.evaluate.store import StoreError
from modules.catalog import operators
from modules.formats import write_image, write_pfm
from modules.formats.datasets import list_pairs

SHIFT_PX = 7


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two textured pairs of constant disparity, with an index."""
    folder = tmp_path_factory.mktemp("data set")
    entries = []
    for scene, seed in (("one", 1), ("two", 2)):
        draw = np.random.default_rng(seed)
        wide = cv2.resize(draw.integers(20, 235, (40, 60, 3), np.uint8), (180, 120), interpolation=cv2.INTER_CUBIC)
        write_image(folder / f"{scene} left.png", wide[:, : 180 - SHIFT_PX])
        write_image(folder / f"{scene} right.png", wide[:, SHIFT_PX:])
        truth = np.full((120, 180 - SHIFT_PX), SHIFT_PX, np.float32)
        truth[:, :SHIFT_PX] = np.nan
        write_pfm(folder / f"{scene}.pfm", truth)
        entries.append(
            {
                "dataset": "tiny",
                "scene": scene,
                "split": "dev",
                "left": f"{scene} left.png",
                "right": f"{scene} right.png",
                "gt": f"{scene}.pfm",
                "ndisp": 32,
            }
        )
    (folder / "INDEX.json").write_text(json.dumps(entries), encoding="utf-8")
    return folder


def test_missing_pixels_count_as_wrong_but_not_as_wrong_among_valid() -> None:
    truth = np.full((1, 4), 10, np.float32)
    found = score(np.array([[10.0, 10.7, 13.0, np.nan]], np.float32), truth, np.isfinite(truth))
    assert (found.bad_05, found.bad_1, found.bad_2, found.density) == (75.0, 50.0, 50.0, 75.0)
    assert found.wrong == pytest.approx(100.0 / 3.0)
    assert found.epe_px == pytest.approx((0.0 + 0.7 + 3.0) / 3.0, abs=1e-6)


def test_no_disparity_at_all_is_wrong_everywhere() -> None:
    truth = np.ones((2, 2), np.float32)
    found = score(None, truth, truth > 0)
    assert (found.bad_1, found.density, found.wrong) == (100.0, 0.0, None)


def test_the_grid_has_thirty_configurations_of_shipped_operators() -> None:
    grid = fixed_grid()
    assert len(grid) == 30
    for system in grid.values():
        for step in system.steps:
            operators()[step.operator].params(**step.with_)


def test_variants_are_read_with_their_strength() -> None:
    assert [str(item) for item in parse_variants(["noise:0.5", "clean"])] == ["noise:0.5", "clean"]
    assert len(parse_variants(["reference", "noise"])) == 10


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fog", "there is no distortion 'fog'; known: reference (all of them), clean"),
        ("noise:much", "variant 'noise:much': the strength 'much' is no number from 0 to 4, e.g. noise:0.5"),
        ("noise:9", "variant 'noise:9': the strength '9' is no number from 0 to 4, e.g. noise:0.5"),
    ],
)
def test_a_wrong_variant_is_named(text: str, words: str) -> None:
    with pytest.raises(ValueError, match="^" + words.replace("(", r"\(").replace(")", r"\)")):
        parse_variants([text])


def test_cases_differ_in_their_noise_but_not_from_run_to_run(data: Path) -> None:
    entry = list_pairs(data)[0]
    views = entry.load().views
    one, two = expand([entry], parse_variants(["noise"]), seeds=(0, 1))
    assert np.array_equal(one.distort(views).right, one.distort(views).right)
    assert not np.array_equal(one.distort(views).right, two.distort(views).right)


def test_an_evaluation_goes_on_where_it_was(data: Path, tmp_path: Path) -> None:
    cases = expand(list_pairs(data), parse_variants(["clean", "dark"]))
    grid = fixed_grid()
    store = Store(tmp_path / "results.sqlite")
    first = evaluate(cases, [grid["block-15"]], store)
    assert (first.run, first.kept, first.problems) == (4, 0, ())
    again = evaluate(cases, [grid["block-15"], grid["sgbm-5"]], store)
    assert (again.run, again.kept) == (4, 4)
    assert {row.system for row in store.rows()} == {"block-15", "sgbm-5"}
    assert all(row.bad_1 < 10.0 for row in store.rows() if row.system == "sgbm-5" and row.variant == "clean")


def test_a_pair_that_cannot_be_read_is_left_out_and_named(data: Path, tmp_path: Path) -> None:
    entries = json.loads((data / "INDEX.json").read_text())
    for name in ("one left.png", "one right.png", "one.pfm", "two left.png", "two.pfm"):
        (tmp_path / name).write_bytes((data / name).read_bytes())
    (tmp_path / "two right.png").write_bytes(b"no image")
    (tmp_path / "INDEX.json").write_text(json.dumps(entries))
    store = Store(tmp_path / "out" / "results.sqlite")
    report = evaluate(expand(list_pairs(tmp_path), parse_variants(["clean"])), [fixed_grid()["block-15"]], store)
    assert len(report.problems) == 1
    assert (report.run, report.kept) == (1, 0)
    assert report.problems[0].startswith("tiny/two|clean|0: ")
    assert len(store.rows()) == 1


def test_leaving_out_a_rule_is_measured_where_it_fired(data: Path, tmp_path: Path) -> None:
    cases = expand(list_pairs(data)[:1], parse_variants(["dark"]))
    system = ExpertConfiguration("terrex fast", "fast")
    store = Store(tmp_path / "results.sqlite")
    evaluate(cases, [system], store)
    silent_rule = next(rule for rule in system.system.rule_ids if rule not in store.rows()[0].rules)
    fired, silent = ablate(system, ["MAT001", silent_rule], cases, store)
    assert (fired.rule, fired.fired) == ("MAT001", 1)
    assert fired.gain is not None
    assert (silent.fired, silent.note) == (0, "never fired")


def test_a_file_that_is_no_store_is_refused(tmp_path: Path) -> None:
    (tmp_path / "results.sqlite").write_text("text " * 1000)
    with pytest.raises(StoreError, match="is no SQLite file"):
        Store(tmp_path / "results.sqlite")


def test_a_store_of_another_version_is_refused(tmp_path: Path) -> None:
    base = sqlite3.connect(tmp_path / "results.sqlite")
    base.execute("CREATE TABLE runs (x)")
    base.execute("PRAGMA user_version = 99")
    base.commit()
    base.close()
    with pytest.raises(StoreError, match="has version 99, this program reads 1; give another file"):
        Store(tmp_path / "results.sqlite")


def test_a_rendered_terrain_follows_from_its_seed() -> None:
    assert RenderedTerrain(3).params == RenderedTerrain(3).params
    assert RenderedTerrain(3).params.pitch_deg != RenderedTerrain(4).params.pitch_deg


def run_command(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["terrex", "evaluate", *words])
    with pytest.raises(SystemExit) as leaving:
        main()
    return int(leaving.value.code or 0)


def test_the_command_writes_a_page_and_prints_the_summary(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(data), "--variants", "clean", "--profile", "fast", "--range", "given", "--only", "sgbm-5"]
    assert run_command(monkeypatch, *words, "--only", "block-15", "--out", str(tmp_path / "out")) == 0
    assert "2 cases of 2 scenes" in capsys.readouterr().out
    assert "terrex fast" in (tmp_path / "out" / "evaluation.html").read_text()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "nothing to evaluate on: give folders of pairs with truth, or --rendered N"),
        (["--rendered", "1", "--profile", "quick"], "there is no profile 'quick'; known: fast, balanced, best"),
        (["--rendered", "1", "--only", "sgbm-4"], "there is no fixed configuration 'sgbm-4'; did you mean 'sgbm-9'?"),
        (["--rendered", "1", "--every", "0"], "--every 0 is below 1; give 1 or more"),
        (["--rendered", "1", "--ablation", "MAT0001"], "there is no rule 'MAT0001'; did you mean 'MAT001'?"),
    ],
)
def test_wrong_usage_is_named(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_command(monkeypatch, *words, "--out", str(tmp_path)) == 2
    assert capsys.readouterr().err.strip() == said


def test_an_evaluation_in_which_nothing_could_be_run_says_so(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pairs").mkdir()
    (tmp_path / "pairs" / "INDEX.json").write_text((data / "INDEX.json").read_text())
    words = [str(tmp_path / "pairs"), "--variants", "clean", "--profile", "fast", "--only", "block-15"]
    assert run_command(monkeypatch, *words, "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err
    assert "0 results new" in said
    assert "no pair has results of all the systems" in said


def test_two_evaluations_are_compared_by_their_last_results(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(data), "--variants", "clean", "--profile", "fast", "--range", "given", "--only", "none"]
    for name in ("before", "after"):
        assert run_command(monkeypatch, *words, "--out", str(tmp_path / name)) == 0
    capsys.readouterr()
    folders = [str(tmp_path / "before"), str(tmp_path / "after")]
    assert run_command(monkeypatch, "--compare", *folders, "--profile", "fast") == 0
    assert "difference +0.00 [+0.00, +0.00], no pair differs" in capsys.readouterr().out
    assert run_command(monkeypatch, "--compare", *folders, "--profile", "best") == 2
    assert "holds no result of 'terrex best'; say --profile and --range" in capsys.readouterr().err


def test_a_candidate_is_chosen_beside_the_system_it_changes(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other.yaml").write_text("version: 1\ndisable: [MAT016]\n")
    words = [str(data), "--variants", "clean", "--profile", "fast", "--range", "estimated", "--only", "sgbm-5"]
    candidate = ("--candidate", str(tmp_path / "other.yaml"), "--out", str(tmp_path / "out"))
    assert run_command(monkeypatch, *words, *candidate) == 0
    said = capsys.readouterr().out
    assert "terrex fast, range estimated with other" in said
    assert "choice among 2 candidate rules: " in said
    assert "cross-validated by scene" in said
