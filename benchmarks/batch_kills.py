"""Kill a batch at random moments until it is done, and compare what it left with an undisturbed run."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from benchmarks.batch_pairs import write_pairs
from expert.batch.runlog import NAME
from expert.decision import Decision

POLL_S = 0.01
START_S = 3.0  # imports, the log, the workers and their systems: what a run does before its first result
PAIR_S = 0.2  # about a pair, so that a kill falls anywhere within one


def kills(work: Path, count: int, wanted: int, seed: int) -> None:
    """Print how a run of `count` pairs came through `wanted` kills, and what is wrong with it."""
    source, out, calm = work / f"{count} pairs to kill", work / "killed", work / "undisturbed"
    write_pairs(source, count)
    for folder in (out, calm):
        shutil.rmtree(folder, ignore_errors=True)
    _finish(source, calm)
    draw = random.Random(seed)
    done = 0
    while done < wanted:
        # As many results as are left are spread over the kills that are left, so that the last one finds work, too.
        more = int(draw.uniform(0.0, 1.2) * (count - logged(out)) / (wanted - done + 1))
        if not _killed(source, out, more, draw):
            break
        done += 1
    left = count - logged(out)
    _finish(source, out)
    problems = [*_problems(out, count), *_differences(out, calm)]
    if done < wanted:
        problems.append(f"the run ended before kill {done + 1} of {wanted}; give more pairs with --kill-pairs")
    print(
        f"{count} pairs, {done} kills (the last with {left} pairs left): "
        + ("nothing lost, nothing twice, no corrupt file, same decisions and products" if not problems else "")
        + "".join(f"\n  {problem}" for problem in problems)
    )
    if problems:
        raise SystemExit(1)
    shutil.rmtree(out)
    shutil.rmtree(calm)


def _command(source: Path, out: Path) -> list[str]:
    terrex = [sys.executable, "-c", "from expert.cli import main; main()", "batch", str(source), "--out", str(out)]
    return [*terrex, "--jobs", "2", "--profile", "fast", "--no-html"]


def _finish(source: Path, out: Path) -> None:
    subprocess.run(_command(source, out), check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _killed(source: Path, out: Path, more: int, draw: random.Random) -> bool:
    """Start a run and kill it when it has `more` results, while it starts where that is 0; False where it ended.

    Either the whole process group is killed, as by a power cut, or the parent alone, which leaves orphans.
    """
    run = subprocess.Popen(
        _command(source, out), start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    aim = logged(out) + more
    while logged(out) < aim and run.poll() is None:
        time.sleep(POLL_S)
    time.sleep(draw.uniform(0.0, PAIR_S if more else START_S))
    if run.poll() is not None:
        return False
    if draw.random() < 0.5:
        os.killpg(run.pid, signal.SIGKILL)
    else:
        run.kill()
    run.wait()
    return True


def logged(out: Path) -> int:
    """Return how many results the log of a run has."""
    if not (out / NAME).exists():
        return 0
    try:
        return int(str(_asked(out, "SELECT count(*) FROM results")[0][0]))
    except sqlite3.OperationalError:  # killed before the tables were there
        return 0


def _asked(out: Path, query: str) -> list[tuple[object, ...]]:
    with closing(sqlite3.connect(out / NAME, timeout=60.0)) as base:
        return base.execute(query).fetchall()


def _problems(out: Path, count: int) -> list[str]:
    """Return what is lost, twice or corrupt."""
    found = []
    check = _asked(out, "PRAGMA integrity_check")
    if check != [("ok",)]:
        found.append(f"the log is corrupt: {check}")
    rows = _asked(out, "SELECT pair, folder, status, decision_id, latest FROM results ORDER BY pair")
    if len(rows) != count or len({row[0] for row in rows}) != count:
        found.append(f"{len(rows)} results of {len({row[0] for row in rows})} pairs instead of {count}")
    for pair, folder, status, decision, latest in rows:
        record = (out / "pairs" / str(folder) / "decision.json").read_text(encoding="utf-8")
        saved = Decision.from_json(record).id
        if saved != decision or latest != 1 or status not in ("reconstructed", "disparity_only", "failed"):
            found.append(f"{pair}: {status}, decision {decision} in the log and {saved} in its folder")
    names = {path.name for path in (out / "pairs").iterdir()}
    strange = names - {str(row[1]) for row in rows}
    if strange:
        found.append(f"left over: {', '.join(sorted(strange))}")
    return found


def _differences(out: Path, calm: Path) -> list[str]:
    """Return the files whose content an undisturbed run has otherwise; times within decision.json do not count."""
    found = []
    decisions = "SELECT pair, decision_id, status, score, reason FROM results ORDER BY pair"
    if _asked(out, decisions) != _asked(calm, decisions):
        found.append("decisions differ")
    for home in sorted((calm / "pairs").iterdir()):
        other = out / "pairs" / home.name
        if {p.name for p in home.iterdir()} != {p.name for p in other.iterdir()}:
            found.append(f"{home.name}: other files")
            continue
        for path in home.iterdir():
            if path.suffix not in (".json", ".md", ".html") and path.read_bytes() != (other / path.name).read_bytes():
                found.append(f"{home.name}/{path.name} differs")
    return found
