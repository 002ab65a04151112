"""Batches end to end, in worker processes: resuming, faults of pairs and of workers, interrupts, clusters."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from expert.batch import Batch, ChangedSettings, Outcome, RunLog, Settings, Stated, find_pairs
from expert.batch.page import drifts, write_page
from expert.batch.run import alone
from expert.batch.work import process
from modules.formats import FormatError
from tests.expert.batch.conftest import write_pair

FAST = Settings(profile="fast", engine="compiled", html=False, common=Stated(disparity_range_px=(0, 32)))
Rows = list[tuple[object, ...]]


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "pairs of today"
    for i in range(3):
        write_pair(folder, f"{i}", seed=i)
    return folder


def run(source: Path, out: Path, settings: Settings = FAST, jobs: int = 1) -> Batch:
    batch = Batch(find_pairs(source), out, settings)
    batch.run(batch.plan(), jobs=jobs)
    return batch


def rows(out: Path, text: str = "SELECT pair, status FROM results WHERE latest = 1 ORDER BY pair") -> Rows:
    return RunLog(out / "run.sqlite", read_only=True).query(text)[1]


def test_a_batch_writes_every_pair_and_does_nothing_twice(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch = run(source, out, jobs=2)
    assert rows(out) == [(str(i), "disparity_only") for i in range(3)]
    assert (out / "pairs" / "1" / "disparity.pfm").is_file()
    plan = batch.plan()
    assert (plan.todo, plan.done) == ((), 3)


def test_a_pair_whose_files_changed_is_processed_again(source: Path, tmp_path: Path) -> None:
    run(source, tmp_path / "out")
    write_pair(source, "1", seed=99)
    plan = Batch(find_pairs(source), tmp_path / "out", FAST).plan()
    assert [(item.name, reason) for item, reason in plan.todo] == [("1", "input changed")]


def test_files_that_were_only_copied_again_are_not(source: Path, tmp_path: Path) -> None:
    run(source, tmp_path / "out")
    os.utime(source / "left_1.png", (1, 1))
    assert Batch(find_pairs(source), tmp_path / "out", FAST).plan().todo == ()


def test_products_that_are_gone_are_made_again(source: Path, tmp_path: Path) -> None:
    batch = run(source, tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "pairs" / "2")
    assert [reason for _, reason in batch.plan().todo] == ["unfinished"]


def test_changed_rules_are_noticed_and_what_to_do_is_asked(source: Path, tmp_path: Path) -> None:
    run(source, tmp_path / "out")
    (tmp_path / "rig.yaml").write_text("version: 1\ndisable: [MAT016]\n")
    batch = Batch(find_pairs(source), tmp_path / "out", replace(FAST, rules=(str(tmp_path / "rig.yaml"),)))
    with pytest.raises(
        ChangedSettings, match=r"3 of 3 pairs in .*out were processed otherwise \(rules \w+, now \w+\);"
    ):
        batch.plan()
    assert len(batch.plan("redo").todo) == 3
    assert batch.plan("keep").done == 3


def test_an_unreadable_pair_is_recorded_and_the_batch_goes_on(source: Path, tmp_path: Path) -> None:
    (source / "right_0.png").write_bytes(b"no image")
    batch = run(source, tmp_path / "out")
    assert [status for _, status in rows(tmp_path / "out")] == ["unreadable", "disparity_only", "disparity_only"]
    assert batch.plan().todo == ()
    assert [reason for _, reason in batch.plan(retry=True).todo] == ["failed before"]


def test_products_of_an_earlier_input_do_not_stay_beside_its_failure(source: Path, tmp_path: Path) -> None:
    batch = run(source, tmp_path / "out")
    (source / "left_1.png").write_bytes(b"no image")
    batch.run(batch.plan())
    assert dict(rows(tmp_path / "out"))["1"] == "unreadable"
    assert sorted(path.name for path in (tmp_path / "out" / "pairs").iterdir()) == ["0", "2"]


def test_repaired_rules_bring_back_the_pairs_that_they_broke(source: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(
        "rules:\n  - {id: RIG001, name: a-window-out-of-range, stage: matching, when: [{fact: image_format, as: i}],\n"
        "     then: [{set: matching.semi_global_match, parameter: window_px, to: {field: i.width_px}, score: 0.99}],\n"
        "     because: a formula that goes wrong, references: [a test]}\n"
    )
    run(source, tmp_path / "out", replace(FAST, rules=(str(tmp_path / "rig.yaml"),)))
    assert {status for _, status in rows(tmp_path / "out")} == {"error"}
    plan = Batch(find_pairs(source), tmp_path / "out", FAST).plan()
    assert [reason for _, reason in plan.todo] == ["failed before"] * 3


def test_memory_that_does_not_suffice_for_reading_costs_its_pair_only(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = Path.read_bytes

    def short(path: Path) -> bytes:
        if path.name == "left_1.png":
            raise MemoryError
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", short)
    found = [process(FAST.system(), item, tmp_path / item.name, FAST) for item in find_pairs(source)]
    assert [outcome.status for outcome in found] == ["disparity_only", "error", "disparity_only"]
    assert "raise --memory-limit" in found[1].reason


def test_hanging_crashing_and_failing_operators_cost_one_pair_each(misbehaving: Path, tmp_path: Path) -> None:
    source = tmp_path / "source"
    levels = {"crash": 2, "fault": 4, "good": None, "hang": 1, "memory": 3}
    for seed, (name, level) in enumerate(levels.items()):
        write_pair(source, name, seed, first_level=level)
    limits = ("--rules", str(misbehaving), "--timeout", "15", "--memory-limit", "1200", "--jobs", "2")
    with started(source, tmp_path / "out", *limits) as process:
        process.communicate()
    assert process.returncode == 1
    found = dict(rows(tmp_path / "out"))
    assert found == {
        "crash": "crashed",
        "fault": "error",
        "good": "disparity_only",
        "hang": "timeout",
        "memory": "error",
    }
    said = dict(rows(tmp_path / "out", "SELECT pair, reason FROM results"))
    assert said["fault"] == "RuntimeError: a fault of the program"
    assert said["hang"] == "took longer than the limit of 15 s; raise --timeout"
    assert "the memory did not suffice" in str(said["memory"])


def command(source: Path, out: Path) -> list[str]:
    return [
        sys.executable,
        "-c",
        "from expert.cli import main; main()",
        *("batch", str(source), "--out", str(out), "--profile", "fast", "--engine", "compiled", "--no-html"),
        *("--disparity-range", "0", "32"),
    ]


def started(source: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    words = [*command(source, out), *more]
    return subprocess.Popen(words, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def wait_until(true: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)


def logged(out: Path) -> int:
    return len(rows(out)) if (out / "run.sqlite").is_file() and (out / "pairs").is_dir() else 0


def cores(out: Path) -> dict[object, object]:
    return dict(rows(out, "SELECT pair, decision_id FROM results WHERE latest = 1"))


def test_a_killed_batch_goes_on_and_decides_the_same(source: Path, tmp_path: Path) -> None:
    for i in range(3, 8):
        write_pair(source, str(i), seed=i)
    out = tmp_path / "out"
    with started(source, out) as process:
        wait_until(lambda: logged(out) >= 2)
        os.killpg(process.pid, signal.SIGKILL)
    before = logged(out)
    (out / "pairs" / ".7.half").mkdir()  # what a kill within the writing of a pair leaves
    with started(source, out) as process:
        said = process.communicate()[0].decode()
    assert process.returncode == 0, said
    assert f"{8 - before} pairs processed, {before} kept" in said
    assert not [path for path in (out / "pairs").iterdir() if path.name.startswith(".")]
    run(source, tmp_path / "undisturbed")
    assert cores(out) == cores(tmp_path / "undisturbed")


def test_an_interrupt_finishes_the_pairs_in_work_and_says_what_is_left(source: Path, tmp_path: Path) -> None:
    for i in range(3, 12):
        write_pair(source, str(i), seed=i)
    out = tmp_path / "out"
    with started(source, out) as process:
        wait_until(lambda: logged(out) >= 1)
        os.kill(process.pid, signal.SIGINT)
        said = process.communicate()[0].decode()
    assert process.returncode == 1
    assert " left" in said
    assert all((out / "pairs" / str(pair) / "decision.json").is_file() for pair, _ in rows(out))
    batch = Batch(find_pairs(source), out, FAST)
    assert len(batch.plan().todo) == 12 - logged(out)


@pytest.mark.parametrize("after_s", [0.05, 0.3, 0.6, 1.2, 2.5])
def test_an_interrupt_from_the_terminal_is_answered_without_a_traceback(
    after_s: float, source: Path, tmp_path: Path
) -> None:
    for i in range(3, 120):  # more than the fastest machine gets done until the interrupt
        write_pair(source, str(i), seed=i)
    words = command(source, tmp_path / "out")
    words[2] = "from expert.cli import main; print('up', flush=True); main()"
    with subprocess.Popen(
        words, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(
            after_s
        )  # imports, rules, workers that start, or pairs in work: nothing to wait for tells them apart
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers get it, too
        told = process.communicate(timeout=120)[1]
    assert "Traceback" not in told
    assert "interrupted" in told
    assert process.returncode in (1, 130)


def test_the_first_interrupt_says_at_once_what_it_does_and_the_second_ends_the_batch(
    misbehaving: Path, tmp_path: Path
) -> None:
    for name, level in {"1 good": None, "2 hang": 1}.items():
        write_pair(tmp_path / "source", name, seed=1, first_level=level)
    with started(tmp_path / "source", tmp_path / "out", "--rules", str(misbehaving)) as process:
        wait_until(lambda: logged(tmp_path / "out") == 1)
        time.sleep(1.0)
        os.killpg(process.pid, signal.SIGINT)
        assert process.stderr is not None
        first = next(line for line in process.stderr if line.startswith(b"interrupted"))
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGINT)
        rest = process.communicate(timeout=60)[1]
    assert b"the pairs in work are finished first; interrupt once more to give them up" in first
    assert b"Traceback" not in rest
    assert process.returncode == 130


def test_two_batches_do_not_share_a_folder(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch = Batch(find_pairs(source), out, FAST)
    out.mkdir()
    with alone(out), pytest.raises(FormatError, match=r"another batch is at work in .*out; wait for it"), alone(out):
        pass
    assert batch.plan().done == 0


def test_a_folder_with_other_files_is_refused(source: Path) -> None:
    with pytest.raises(FormatError, match="holds files that no batch wrote"):
        Batch(find_pairs(source), source, FAST)


def test_the_page_shows_names_as_text_and_links_the_reports(source: Path, tmp_path: Path) -> None:
    write_pair(source, "<script>alert(1)<!script>", seed=1)
    run(source, tmp_path / "out", replace(FAST, html=True))
    page = write_page(tmp_path / "out").read_text()
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)&lt;!script&gt;" in page
    assert 'href="pairs/1/report.html"' in page
    assert "<h1>1</h1>" in (tmp_path / "out" / "pairs" / "1" / "report.html").read_text()


def test_a_cluster_gives_the_same_though_a_worker_is_lost(source: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    for i in range(3, 8):
        write_pair(source, str(i), seed=i)
    run(source, tmp_path / "local")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        killed: list[int] = []

        def kill_one(progress: object, outcome: Outcome) -> None:
            if not killed:
                killed.append(next(iter(cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

        batch = Batch(find_pairs(source), tmp_path / "out", FAST)
        batch.run(batch.plan(), scheduler=cluster.scheduler_address, transfer="bytes", progress=kill_one)
    assert killed
    assert cores(tmp_path / "out") == cores(tmp_path / "local")
    for pair in cores(tmp_path / "out"):
        one, two = (tmp_path / name / "pairs" / str(pair) / "disparity.pfm" for name in ("out", "local"))
        assert one.read_bytes() == two.read_bytes()


def test_a_scheduler_that_does_not_answer_is_named(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")

    def refuse(*args: object, **more: object) -> None:
        raise OSError("timed out")

    monkeypatch.setattr(distributed, "Client", refuse)
    batch = Batch(find_pairs(source), tmp_path / "out", FAST)
    with pytest.raises(FormatError, match="the scheduler at tcp://nowhere:1 does not answer"):
        batch.run(batch.plan(), scheduler="tcp://nowhere:1")


def test_the_log_answers_what_is_asked(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from expert.cli.log import log

    def ask(**options: object) -> list[dict[str, object]]:
        names = (
            "status",
            "rule",
            "not_rule",
            "finding",
            "operator",
            "slowest",
            "changed",
            "rules",
            "runs",
            "fact",
            "sql",
        )
        values = dict.fromkeys(names) | {"changed": False, "rules": False, "runs": False} | options
        log(tmp_path / "out", **values, format_="json", out=None)  # type: ignore[arg-type]
        return list(json.loads(capsys.readouterr().out))

    run(source, tmp_path / "out")
    assert len(ask()) == 3
    assert len(ask(rule="MAT001")) == 3
    assert ask(not_rule="MAT001") == []
    assert len(ask(slowest=2)) == 2
    assert len(ask(operator="matching.semi_global_match")) == 3
    assert ask(operator="matching.semi_global_block_match") == []
    assert ask(changed=True) == []
    assert {row["rule"]: row["pairs"] for row in ask(rules=True)}["MAT001"] == 3
    assert [row["value"] for row in ask(fact="image_format.width_px")] == [190.0] * 3
    assert ask(sql="SELECT count(*) AS n FROM results") == [{"n": 3}]
    with pytest.raises(FormatError, match="the query failed: attempt to write a readonly database"):
        ask(sql="DELETE FROM results")


def test_the_page_names_the_rules_and_marks_what_lies_apart(source: Path, tmp_path: Path) -> None:
    for number in range(3, 12):
        write_pair(source, str(number), seed=number)
    run(source, tmp_path / "out")
    page = write_page(tmp_path / "out").read_text()
    rows = re.findall(r'data-rules="[^"]*"><th scope="row" role="rowheader">([^<]*)</th>', page)
    assert rows == [str(number) for number in range(12)]
    button = '<button type="button" data-rule="MAT001" aria-pressed="false">MAT001</button></th>'
    assert f"{button}<td>range-as-given</td>" in page
    items = [(str(number), value) for number, value in enumerate([1.0, 1.1, 0.9, 1.0, 1.2, 0.8, 1.0, 1.1, 9.0])]
    (drift,) = drifts({"brightness.gain": items})
    assert [mark.text for mark in drift.marks] == ["8: 9"]
    assert (drift.least, drift.median, drift.most) == (0.8, 1.0, 9.0)
    assert drifts({"x.flat": [(str(number), 1.0) for number in range(9)]}) == []
