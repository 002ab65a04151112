"""`terrex batch` and `terrex log` as words on a command line."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from expert.batch import Batch, Outcome, RunLog, Settings, Stated, find_pairs
from expert.batch.runlog import NAME
from expert.cli.commands import complete_app
from expert.cli.usage import UsageError
from tests.expert.batch.conftest import write_pair

FAST = Settings(profile="fast", engine="compiled", html=False, common=Stated(disparity_range_px=(0, 32)))


def told(*words: object) -> str:
    done = CliRunner().invoke(complete_app(), [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.stdout


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write_pair(tmp_path / "source", "1", seed=1)
    return tmp_path / "source"


@pytest.fixture
def logged(tmp_path: Path) -> Path:
    """A log of two runs: the decision of `b` changed, `slow` took longest."""
    log = RunLog(tmp_path / "out" / NAME)
    for run in (log.begin("source", {}, "one", {}), log.begin("source", {}, "two", {})):
        for name, seconds, decision in (("a", 0.1, "same"), ("b", 0.2, f"of run {run}"), ("slow", 3.0, "same")):
            record = {
                "facts": [],
                "firings": [{"rule": f"RUN00{run}", "stage": "correction"}],
                "findings": [],
                "plans": {},
            }
            log.add(
                run,
                Outcome(name, "reconstructed", decision=json.dumps(record), decision_id=decision, seconds=seconds),
                name,
                "digest",
            )
    return tmp_path / "out"


def test_a_dry_run_says_what_would_be_redone_and_why(source: Path, tmp_path: Path) -> None:
    batch = Batch(find_pairs(source), tmp_path / "out", FAST)
    batch.run(batch.plan())
    words = ("batch", source, "--out", tmp_path / "out", "--engine", "compiled", "--disparity-range", 0, 32)
    said = told(*words, "--profile", "balanced", "--dry-run").splitlines()
    assert said == [
        "processed otherwise: '1'",
        "to do: 1 processed otherwise; 0 are done",
        "processed otherwise: profile fast, now balanced; --resume keep leaves them, --resume redo does not",
    ]
    with pytest.raises(UsageError, match=r"1 of 1 pairs in .* were processed otherwise \(profile fast, now balanced\)"):
        told(*words, "--profile", "balanced")


def test_what_could_not_be_processed_before_is_told_again(source: Path, tmp_path: Path) -> None:
    (source / "right_1.png").write_bytes(b"broken")
    batch = Batch(find_pairs(source), tmp_path / "out", FAST)
    batch.run(batch.plan())
    words = ("batch", source, "--out", tmp_path / "out", "--profile", "fast", "--disparity-range", 0, 32, "--no-html")
    again = CliRunner().invoke(complete_app(), [str(word) for word in words])
    assert again.exit_code == 1
    assert "0 pairs processed, 1 (1 of them could not be processed) kept" in again.stdout
    assert "the same command with --retry tries again" in again.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--jobs", 0), "--jobs 0 is below 1; give 1 or more"),
        (("--limit", 0), "--limit 0 is below 1; give 1 or more"),
        (("--timeout", 0), "--timeout 0 is not positive; give seconds"),
        (("--filter", "x*"), r"no pair of .* matches --filter 'x\*'"),
        (("--scheduler", "tcp://h:1", "--timeout", 5), "--timeout and --memory-limit bind workers on this machine"),
        (("--roll", 1, "--attitude", "a.yaml"), "give --attitude FILE or --roll --pitch --yaw, not both"),
    ],
)
def test_wrong_usage_is_named(words: tuple[object, ...], said: str, source: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=said):
        told("batch", source, "--out", tmp_path / "out", *words)


def ask(out: Path, *words: object) -> list[dict[str, object]]:
    return list(json.loads(told("log", out, "--format", "json", *words)))


def test_the_log_tells_decisions_that_changed_between_runs(logged: Path) -> None:
    assert [(row["pair"], row["decisions"]) for row in ask(logged, "--changed")] == [("b", 2)]


def test_the_log_tells_the_slowest_pairs_first(logged: Path) -> None:
    assert [row["pair"] for row in ask(logged, "--slowest", 2)] == ["slow", "b"]


def test_the_log_tells_of_the_last_run_which_pairs_fired_a_rule(logged: Path) -> None:
    assert [row["pair"] for row in ask(logged, "--rule", "RUN002")] == ["a", "b", "slow"]
    assert ask(logged, "--rule", "RUN001") == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--rule", "RUN003"), r"there is no rule RUN003, .*; did you mean 'RUN00[12]'\?"),
        (("--not-rule", "COR0111"), r"there is no rule COR0111, .*; did you mean 'COR01"),
        (("--finding", "exposure-difers"), "there is no finding exposure-difers, .*; did you mean 'exposure-differs"),
        (("--operator", "matching.blok_match"), "there is no operator .*; did you mean 'matching.block_match'"),
        (("--fact", "brightness.gan"), "there is no fact brightness.gan, .*; did you mean 'brightness.gain'"),
        (("--fact", "brightnes.*"), r"there is no fact brightnes\.\*"),
        (("--status", "timedout"), "there is no status timedout, .*; did you mean 'timeout'"),
    ],
)
def test_a_name_that_nothing_has_is_not_answered_by_no_rows(words: tuple[str, str], said: str, logged: Path) -> None:
    with pytest.raises(UsageError, match=said):
        told("log", logged, *words)


@pytest.mark.parametrize(
    "words",
    [
        ("--rule", "MEA001"),
        ("--finding", "vignetted"),
        ("--finding", "operator-failed"),
        ("--finding", "trial-given-up"),
        ("--operator", "none"),
        ("--fact", "brightness.*"),
        ("--status", "timeout"),
    ],
)
def test_a_name_that_a_log_could_hold_may_have_no_rows(words: tuple[str, str], logged: Path) -> None:
    assert ask(logged, *words) == []


def test_the_log_comes_as_csv_and_as_parquet(logged: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = list(csv.DictReader(io.StringIO(told("log", logged, "--slowest", 1, "--format", "csv"))))
    assert [(row["pair"], row["seconds"]) for row in rows] == [("slow", "3.0")]
    told("log", logged, "--slowest", 1, "--format", "parquet", "--out", tmp_path / "log.parquet")
    assert parquet.read_table(tmp_path / "log.parquet").to_pylist()[0]["pair"] == "slow"
