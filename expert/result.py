"""What a reconstruction returns, and how it is written: whole, or not at all."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from expert.decision import Decision
from expert.products import DEFAULT_PRODUCTS, Terrain, check_products, product_writers
from expert.report import FILES, answer, as_html, as_markdown
from modules.formats.atomic import whole_folder
from modules.formats.disparity import (
    write_confidence_png,
    write_disparity_png,
    write_disparity_view,
    write_pfm,
    write_validity_png,
)
from modules.formats.images import write_image
from modules.types import Datum, Disparity, ElevationMap, FloatImage, Invalid, PointCloud, Views

MAX_PNG_PX = 255.99  # a 16-bit PNG of 1/256 px ends here; the PFM holds every disparity


@dataclass(frozen=True)
class Result:
    """Products of one pair.

    Attributes
    ----------
    decision : Decision
        What was decided, and why.
    views : Views
        The corrected images and their masks.
    disparity : Disparity or None
        None where matching gave nothing.
    points : PointCloud or None
        In the level frame; None without a calibration.
    elevation : ElevationMap or None
    original : Views or None
        The pair before correction, for the report; None where nobody kept it.
    """

    decision: Decision
    views: Views
    disparity: Disparity | None = None
    points: PointCloud | None = None
    elevation: ElevationMap | None = None
    original: Views | None = None

    @property
    def disparity_px(self) -> FloatImage:
        """Disparity of the left image, float32 (H, W), px, NaN where invalid."""
        if self.disparity is None:
            return np.full(self.views.shape, np.nan, np.float32)
        return self.disparity.disparity_px

    @property
    def validity(self) -> NDArray[np.uint16]:
        """`Invalid` flags that say why a pixel has no disparity, uint16 (H, W)."""
        if self.disparity is None:
            return np.full(self.views.shape, int(Invalid.NO_MATCH), np.uint16)
        return self.disparity.validity

    @property
    def timings(self) -> dict[str, float]:
        """Wall time in seconds by probe, operator and inference."""
        return self.decision.timings_s

    @property
    def reconstructed(self) -> bool:
        """Whether the pair gave what it could give: terrain, or the disparity where there is no calibration."""
        return self.decision.status in ("reconstructed", "disparity_only")

    def save(
        self,
        out: str | Path,
        *,
        html: bool = True,
        products: Sequence[str] = DEFAULT_PRODUCTS,
        datum: Datum | None = None,
    ) -> dict[str, float]:
        """Write all products into the folder `out`, which appears whole or not at all; return seconds by file.

        Parameters
        ----------
        out : str or Path
        html : bool
            Whether to write `report.html`; `terrex report` makes it later from the folder.
        products : sequence of str
            Names of `expert.products.PRODUCTS`, or `all`, written beside the images and the record; one that this
            pair cannot give, as points without a calibration, is left out.
        datum : Datum, optional
            Where the origin lies, if the level frame is east-north-up; gives the GeoTIFF a reference system.

        Raises
        ------
        modules.formats.FormatError
            The folder cannot be written, or holds files of another origin; a product is unknown or its extra is not
            installed.
        """
        chosen = check_products(products)
        spent: dict[str, float] = {}
        with whole_folder(Path(out)) as folder:
            for name, write in self._writers(chosen, datum).items():
                start = time.perf_counter()
                write(folder / name)
                spent[name] = time.perf_counter() - start
            spent.update(self._report(folder, html))
        return spent

    def _report(self, folder: Path, html: bool) -> dict[str, float]:
        """Write the report beside the files that it shows."""
        start = time.perf_counter()
        answers, names = answer(self.decision), {path.name for path in folder.iterdir()}
        (folder / "report.md").write_text(as_markdown(self.decision, answers, names), encoding="utf-8")
        spent = {"report.md": time.perf_counter() - start}
        if html:
            start = time.perf_counter()
            files = {name: (folder / name).read_bytes() for name in FILES if name in names}
            (folder / "report.html").write_bytes(as_html(self.decision, files, answers).encode("utf-8"))
            spent["report.html"] = time.perf_counter() - start
        return spent

    def _writers(self, products: Sequence[str], datum: Datum | None) -> dict[str, Callable[[Path], object]]:
        decision, views, validity = self.decision, self.views, self.validity
        writers: dict[str, Callable[[Path], object]] = {
            "decision.json": lambda path: path.write_text(decision.to_json(), encoding="utf-8"),
            "left_corrected.png": lambda path: write_image(path, views.left),
            "right_corrected.png": lambda path: write_image(path, views.right),
            "validity.png": lambda path: write_validity_png(path, validity),
        }
        if self.original is not None:
            for side, before, after in (
                ("left", self.original.left, views.left),
                ("right", self.original.right, views.right),
            ):
                if not np.array_equal(before, after):
                    writers[f"{side}_original.png"] = partial(write_image, image=before)
        disparity = self.disparity
        if disparity is not None:
            storable = _storable(disparity.disparity_px)
            writers["disparity.pfm"] = lambda path: write_pfm(path, disparity.disparity_px)
            writers["disparity.png"] = lambda path: write_disparity_png(path, storable)
            writers["disparity_view.png"] = lambda path: write_disparity_view(path, disparity.disparity_px)
            confidence = disparity.confidence
            if confidence is not None:
                writers["confidence.png"] = lambda path: write_confidence_png(path, confidence)
        writers.update(product_writers(Terrain(self.elevation, self.points, datum, decision.pair), products))
        return writers


def _storable(disparity_px: FloatImage) -> FloatImage:
    """Leave out what a 16-bit PNG of 1/256 px cannot hold; the PFM beside it holds every disparity."""
    return np.where((disparity_px > 0.01) & (disparity_px < MAX_PNG_PX), disparity_px, np.float32(np.nan))
