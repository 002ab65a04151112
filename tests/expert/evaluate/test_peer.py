"""The adapter of an outside peer, with a program in its place that answers as Pandora's worker does."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from expert.evaluate import peer
from expert.evaluate.peer import Pandora, PandoraSystem, pandora_at
from modules.formats import FormatError
from modules.types import DisparityRange, Views

STAND_IN = """
import json, sys
import numpy as np
for line in sys.stdin:
    request = json.loads(line)
    assert open(request["left"], "rb").read(4)[1:] == b"PNG"
    disparity = np.full((20, 30), float(request["range_px"][1]), np.float32)
    disparity[0] = np.nan
    np.save(request["out"], disparity)
    print(json.dumps({"cpu_s": 1.5, "extra_mb": 7.0}), flush=True)
"""
VIEWS = Views(np.zeros((20, 30, 3), np.uint8), np.zeros((20, 30, 3), np.uint8))


@pytest.fixture
def worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "worker.py").write_text(STAND_IN)
    monkeypatch.setattr(peer, "WORKER", tmp_path / "worker.py")
    yield tmp_path / "worker.py"
    if peer._started.cache_info().currsize:
        peer._started(Path(sys.executable)).close()
        peer._started.cache_clear()


@pytest.mark.usefixtures("worker")
def test_a_peer_is_one_system_among_others_with_what_it_took_in_its_own_process() -> None:
    outcome = PandoraSystem(Path(sys.executable)).run(VIEWS, 24)
    assert outcome.disparity_px is not None
    assert np.isnan(outcome.disparity_px[0]).all()
    assert (outcome.disparity_px[1:] == 24).all()
    assert (outcome.cpu_s, outcome.peak_mb) == (1.5, 7.0)


def test_the_last_words_of_a_peer_that_ended_are_told(worker: Path) -> None:
    worker.write_text("raise SystemExit('no module named plugin_libsgm')")
    lost = Pandora(Path(sys.executable))
    with pytest.raises(FormatError, match=r"Pandora has ended \(no module named plugin_libsgm\); install it with"):
        lost.match(VIEWS, DisparityRange(0, 8))
    lost.close()


def test_a_peer_that_is_not_installed_is_left_out_or_named(tmp_path: Path) -> None:
    with pandora_at(tmp_path / "python") as nobody:
        assert nobody is None
    with pytest.raises(FormatError, match=r"cannot be run .* give the Python of an environment with Pandora"):
        Pandora(tmp_path / "python")
