"""What a worker does with one pair: read, reconstruct, save, and tell what came out."""

from __future__ import annotations

import hashlib
import io
import json
import tempfile
import time
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from expert.api import ExpertSystem, Profile
from expert.batch.item import BatchItem
from expert.engine import EngineName
from expert.pair import PairError, StereoPair
from modules.formats import FormatError, attitude_from_degrees

# The last four mean that the pair was not processed to an end; the first three are what a decision says.
OutcomeStatus = Literal["reconstructed", "disparity_only", "failed", "unreadable", "error", "timeout", "crashed"]
PROCESSED: tuple[OutcomeStatus, ...] = ("reconstructed", "disparity_only", "failed")


@dataclass(frozen=True)
class Settings:
    """How every pair of a batch is processed.

    Attributes
    ----------
    rules : tuple of str
        Files layered on the shipped rules.
    profile, engine : str
    calibration, attitude : str or None
        For the items that have none of their own.
    disparity_range_px : (int, int) or None
        For the items that have none of their own.
    html : bool
        Whether each pair gets its `report.html`.
    """

    rules: tuple[str, ...] = ()
    profile: Profile = "balanced"
    engine: EngineName = "experta"
    calibration: str | None = None
    attitude: str | None = None
    disparity_range_px: tuple[int, int] | None = None
    html: bool = True

    def system(self) -> ExpertSystem:
        """Return the expert system; building it takes about as long as a pair."""
        return ExpertSystem(rules=self.rules, profile=self.profile, engine=self.engine)

    def complete(self, item: BatchItem) -> BatchItem:
        """Return the item with what is stated for all."""
        return BatchItem(
            item.name,
            item.left,
            item.right,
            item.calibration or (Path(self.calibration) if self.calibration else None),
            item.attitude or (Path(self.attitude) if self.attitude and item.angles_deg is None else None),
            item.angles_deg,
            item.disparity_range_px or self.disparity_range_px,
        )


@dataclass(frozen=True)
class Outcome:
    """What became of one pair.

    Attributes
    ----------
    name : str
    status : str
    reason : str
        Why it was not processed, or its gravest finding.
    inputs : str
        SHA-256 of the files and of what was stated.
    stamp : str
        Sizes and times of the files: where it is the same, the files need not be read to know them.
    decision : str
        `decision.json`; empty where there is none.
    decision_id : str
    score : float or None
        No-reference score of the kept disparity.
    seconds, cpu_s : float
    products : bytes or None
        The folder as a ZIP archive, where it was not written by the worker.
    """

    name: str
    status: OutcomeStatus
    reason: str = ""
    inputs: str = ""
    stamp: str = ""
    decision: str = ""
    decision_id: str = ""
    score: float | None = None
    seconds: float = 0.0
    cpu_s: float = 0.0
    products: bytes | None = field(default=None, repr=False)


def inputs_digest(item: BatchItem) -> str:
    """Return the SHA-256 of an item's files and of what is stated about it.

    A file that cannot be read counts as such.
    """
    digest = hashlib.sha256(repr((item.angles_deg, item.disparity_range_px)).encode())
    for path in (item.left, item.right, item.calibration, item.attitude):
        try:
            content = b"" if path is None else path.read_bytes()
        except OSError as error:
            content = f"unreadable {error.errno}".encode()
        digest.update(f"{len(content)}:".encode())
        digest.update(content)
    return digest.hexdigest()


def stamp(item: BatchItem) -> str:
    """Return the sizes and times of change of an item's files, and what is stated about it."""
    found: list[object] = [item.angles_deg, item.disparity_range_px]
    for path in (item.left, item.right, item.calibration, item.attitude):
        try:
            state = None if path is None else path.stat()
        except OSError:
            state = None
        found.append(None if state is None else (str(path), state.st_size, state.st_mtime_ns))
    return repr(found)


def unprocessed(item: BatchItem, status: OutcomeStatus, reason: str, seconds: float = 0.0) -> Outcome:
    """Return the outcome of a pair of which no worker could tell anything."""
    return Outcome(item.name, status, reason, inputs_digest(item), stamp(item), seconds=seconds)


def process(system: ExpertSystem, item: BatchItem, out: Path, html: bool) -> Outcome:
    """Process one pair and write its products to the folder `out`, whole or not at all.

    Faults of the pair are told in the outcome; memory that does not suffice and faults of the program are, too, so that
    a batch goes on.
    """
    start, cpu = time.perf_counter(), time.process_time()

    def ended(status: OutcomeStatus, reason: str) -> Outcome:
        spent = time.perf_counter() - start
        return Outcome(item.name, status, reason, inputs, mark, seconds=spent, cpu_s=time.process_time() - cpu)

    inputs, mark = inputs_digest(item), stamp(item)
    try:
        pair = _load(item)
    except (FormatError, PairError) as error:
        return ended("unreadable", str(error))
    try:
        result = system.reconstruct(pair)
        result.save(out, html=html)
    except FormatError as error:
        return ended("error", str(error))
    except OSError as error:
        return ended("error", f"the products could not be written: {error}")
    except MemoryError:
        return ended(
            "error", "the memory did not suffice; raise --memory-limit, narrow the disparity range or downscale"
        )
    except Exception as error:  # noqa: BLE001  a fault of the program must not end the batch; it is told with the pair
        return ended("error", f"{type(error).__name__}: {error}")
    decision = result.decision
    return Outcome(
        item.name,
        "failed" if decision.status == "decided" else decision.status,
        decision.findings[0].sentence if decision.findings else "",
        inputs,
        mark,
        decision.to_json(),
        decision.id,
        next((trial.score for trial in decision.trials if trial.kept and trial.stage == "matching"), None),
        time.perf_counter() - start,
        time.process_time() - cpu,
    )


def _load(item: BatchItem) -> StereoPair:
    attitude = None if item.angles_deg is None else attitude_from_degrees(*item.angles_deg)
    return StereoPair.load(
        item.left,
        item.right,
        calibration=item.calibration,
        attitude=attitude if attitude is not None else item.attitude,
        disparity_range_px=item.disparity_range_px,
    )


# For workers that do not share a disk


@dataclass(frozen=True)
class Packed:
    """An item with the content of its files, for a worker that cannot read them."""

    item: BatchItem
    files: tuple[tuple[str, str, bytes], ...]  # field of the item, file name, content


def pack(item: BatchItem) -> Packed:
    """Read the files of an item.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    named = (("left", item.left), ("right", item.right), ("calibration", item.calibration), ("attitude", item.attitude))
    return Packed(item, tuple((name, path.name, path.read_bytes()) for name, path in named if path is not None))


def process_packed(system: ExpertSystem, packed: Packed, html: bool) -> Outcome:
    """Process a packed item in a temporary folder; the products come back as a ZIP archive in the outcome."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        paths = {}
        for number, (name, file_name, content) in enumerate(packed.files):
            (home / str(number)).mkdir()
            paths[name] = home / str(number) / file_name
            paths[name].write_bytes(content)
        item = packed.item
        local = BatchItem(
            item.name,
            paths["left"],
            paths["right"],
            paths.get("calibration"),
            paths.get("attitude"),
            item.angles_deg,
            item.disparity_range_px,
        )
        outcome = process(system, local, home / "out", html)
        archive = io.BytesIO()
        if (home / "out").is_dir():
            with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as file:
                for path in sorted((home / "out").iterdir()):
                    file.write(path, path.name)
        return Outcome(**{**outcome.__dict__, "products": archive.getvalue() or None})


def unpack(products: bytes, folder: Path) -> None:
    """Write the products of a packed item into a folder; names with a path in them are refused."""
    with zipfile.ZipFile(io.BytesIO(products)) as file:
        for name in file.namelist():
            if Path(name).name != name:
                raise FormatError(f"the worker returned a file named {name!r}, which leads out of its folder")
            (folder / name).write_bytes(file.read(name))


def settings_digest(settings: Settings, rules_digest: str, versions: dict[str, str]) -> str:
    """Return the SHA-256 of everything but the pair that a decision depends on."""
    relevant: Sequence[object] = (
        rules_digest,
        settings.profile,
        sorted((name, value) for name, value in versions.items() if name not in ("python",)),
    )
    return hashlib.sha256(json.dumps(relevant).encode()).hexdigest()
