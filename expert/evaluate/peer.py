"""CNES Pandora as a peer: another program's matcher on the same pairs, in a Python environment of its own."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from expert.evaluate.systems import Outcome, digest_of
from modules.formats.errors import FormatError
from modules.formats.images import write_image
from modules.matching.common import to_bytes
from modules.types import Disparity, DisparityRange, FloatImage, Invalid, Matching, Views

WORKER = Path(__file__).with_name("pandora_worker.py")


@dataclass(frozen=True)
class Spent:
    """What a match cost in Pandora's process: CPU time, and memory beyond what the process held before."""

    cpu_s: float
    extra_mb: float


class Pandora:
    """Pandora's process; started once, and asked for one pair after the other.

    Parameters
    ----------
    python : Path
        Python of an environment with Pandora and its plugin libsgm; see `make bench-pandora`.

    Raises
    ------
    FormatError
        There is no such program.
    """

    def __init__(self, python: Path) -> None:
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115  closed with the process
        try:
            self._process = subprocess.Popen(
                [str(python), "-I", str(WORKER)],  # isolated, so that it finds no module of ours
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
            )
        except OSError as error:
            self._errors.close()
            raise FormatError(
                f"{python} cannot be run ({error.strerror}); give the Python of an environment with Pandora, "
                "e.g. build/pandora/bin/python after `make bench-pandora`"
            ) from error

    def match(self, views: Views, search: DisparityRange) -> tuple[FloatImage, Spent]:
        """Return the disparity, float32 (H, W), px, NaN where Pandora calls it invalid, and what it cost.

        Raises
        ------
        FormatError
            Pandora has ended.
        """
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / f"{side}.png" for side in ("left", "right")]
            for path, image in zip(paths, to_bytes(views, colour=False), strict=True):
                write_image(path, image)
            out = Path(folder) / "disparity.npy"
            request = {"left": str(paths[0]), "right": str(paths[1]), "out": str(out)}
            answer = self._ask({**request, "range_px": [search.min_px, search.max_px]})
            return np.load(out), Spent(float(answer["cpu_s"]), float(answer["extra_mb"]))

    def _ask(self, request: dict[str, object]) -> dict[str, float]:
        if self._process.stdin is None or self._process.stdout is None:
            raise FormatError("Pandora was closed; start it again")
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            self._errors.seek(0)
            last = (self._errors.read().strip().splitlines() or ["it said nothing"])[-1]
            raise FormatError(f"Pandora has ended ({last}); install it with its plugin: make bench-pandora")
        return dict(json.loads(answer))

    def close(self) -> None:
        """End the process."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._errors.close()


@contextmanager
def pandora_at(python: Path) -> Iterator[Pandora | None]:
    """Give Pandora, or nothing where it is not installed."""
    if not python.exists():
        yield None
        return
    pandora = Pandora(python)
    try:
        yield pandora
    finally:
        pandora.close()


@cache
def _started(python: Path) -> Pandora:
    """Pandora's process of this worker, started at first use; it ends when its input does, with this process."""
    return Pandora(python)


@dataclass(frozen=True)
class PandoraSystem:
    """Pandora's census and SGM with cross-checking, behind the interface of the evaluation; it is given the range."""

    python: Path
    name: str = "pandora"
    kind: str = "peer"

    def digest(self) -> str:
        """Identify the pipeline."""
        return digest_of(WORKER.read_bytes())

    def run(self, views: Views, ndisp: int) -> Outcome:
        """Match the pair; CPU time and memory are those of Pandora's process, without reading the images."""
        disparity, spent = _started(self.python).match(views, DisparityRange(0, ndisp))
        reasons = np.where(np.isnan(disparity), np.uint16(Invalid.NO_MATCH), np.uint16(0)).astype(np.uint16)
        found = Matching(views, disparity=Disparity(disparity, reasons))
        return Outcome(found, cpu_s=spent.cpu_s, peak_mb=spent.extra_mb)
