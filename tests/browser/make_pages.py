"""Make the pages that the browser tests open: reports of a rendered pair and of a hostile record, and a batch.

`make browser` runs it with the project and `tests/expert` on the path of modules.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
from made_reports import EVIL, pair_images, record

from benchmarks.batch_pairs import SIZE, rendered, write_pairs
from expert import ExpertSystem, StereoPair
from expert.batch import Batch, Settings, find_pairs
from expert.batch.page import write_page
from expert.products import DEFAULT_PRODUCTS
from expert.report import as_html, as_markdown
from modules.formats.images import write_image
from modules.simulation.distortions import distort_right
from modules.types import Views

PAIRS = 12


def main(out: Path) -> None:
    """Write the pages into a folder."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    _run(out / "run")
    hostile = out / "hostile"
    hostile.mkdir()
    decision = record(EVIL)
    (hostile / "report.html").write_text(as_html(decision, pair_images()), encoding="utf-8")
    (hostile / "report.md").write_text(as_markdown(decision), encoding="utf-8")
    _batch(out)


def _run(out: Path) -> None:
    made = rendered(1, SIZE)
    views = distort_right(Views(made.left, made.right), "curve", 3)
    pair = StereoPair(
        views.left,
        views.right,
        calibration=made.calibration,
        attitude=made.attitude,
        mount=made.mount,
        name="rendered pair, right camera distorted",
    )
    ExpertSystem().reconstruct(pair).save(out, products=[*DEFAULT_PRODUCTS, "terrain.html"])


def _batch(out: Path) -> None:
    source = out / "pairs"
    write_pairs(source, PAIRS)
    for side in ("left", "right"):  # a name that is markup, a pair that cannot be read, and one without content
        shutil.copy(source / f"{side}_00000.png", source / f"{side}_<img src=x onerror=alert(1)>.png")
        (source / f"{side}_broken.png").write_bytes(b"no image")
        write_image(source / f"{side}_flat.png", np.full((240, 320), 90, np.uint8))
    batch = Batch(find_pairs(source), out / "batch", Settings(html=True))
    batch.run(batch.plan())
    write_page(out / "batch")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
