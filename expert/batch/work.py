"""What a worker does with one pair: read, reconstruct, save, and tell what came out."""

from __future__ import annotations

import hashlib
import io
import json
import tempfile
import time
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

from expert.api import ExpertSystem, Profile
from expert.batch.item import BatchItem, Stated
from expert.engine import EngineName
from expert.pair import PairError, StereoPair
from expert.products import DEFAULT_PRODUCTS
from modules.formats import FormatError, attitude_from_degrees, read_imu_log
from modules.formats._text import unwritable
from modules.formats.imu import ImuLog
from modules.primitives.frames import Convention
from modules.types import Attitude, Datum, Rover

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
    rover : Rover or None
        The vehicle that shall drive on the terrain.
    time_budget_s, memory_budget_mb : float or None
        For one pair; see `ExpertSystem`.
    machine_speed : float or None
        That the time budget is kept by, the same for all workers; `Batch` takes what the log has, or measures it.
    products : tuple of str
        See `Result.save`.
    html : bool
        Whether each pair gets its `report.html`.
    common : Stated
        For the pairs that state nothing else.
    """

    rules: tuple[str, ...] = ()
    profile: Profile = "balanced"
    engine: EngineName = "experta"
    rover: Rover | None = None
    time_budget_s: float | None = None
    memory_budget_mb: float | None = None
    machine_speed: float | None = None
    products: tuple[str, ...] = DEFAULT_PRODUCTS
    html: bool = True
    common: Stated = field(default_factory=Stated)

    def system(self) -> ExpertSystem:
        """Return the expert system; building it takes about as long as a pair."""
        return ExpertSystem(
            self.rules,
            self.profile,
            self.engine,
            time_budget_s=self.time_budget_s,
            memory_budget_mb=self.memory_budget_mb,
            machine_speed=self.machine_speed,
            rover=self.rover,
        )

    def complete(self, item: BatchItem) -> BatchItem:
        """Return the item with what is stated for all."""
        return replace(item, stated=item.stated.over(self.common))

    def record(self, rules_digest: str) -> dict[str, object]:
        """Return what of it decisions and products hang on, by words that messages can use."""
        time_s, memory_mb = self.time_budget_s, self.memory_budget_mb
        rover = "none" if self.rover is None else ", ".join(f"{k} {v:g}" for k, v in asdict(self.rover).items())
        return {
            "rules": rules_digest[:12],
            "profile": self.profile,
            "rover": rover,
            "time budget": "none" if time_s is None else f"{time_s:g} s at speed {self.machine_speed}",
            "memory budget": "none" if memory_mb is None else f"{memory_mb:g} MB",
            "products": ",".join(sorted(self.products)),
        }


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
    digest = hashlib.sha256(repr(item.facts).encode())
    for path in item.files:
        try:
            content = path.read_bytes()
        except OSError as error:
            content = f"unreadable {error.errno}".encode()
        digest.update(f"{len(content)}:".encode())
        digest.update(content)
    return digest.hexdigest()


def stamp(item: BatchItem) -> str:
    """Return the sizes and times of change of an item's files, and what is stated about it."""
    found: list[object] = [item.facts]
    for path in item.files:
        try:
            state = path.stat()
        except OSError:
            found.append(None)
        else:
            found.append((str(path), state.st_size, state.st_mtime_ns))
    return repr(found)


def unprocessed(item: BatchItem, status: OutcomeStatus, reason: str, seconds: float = 0.0) -> Outcome:
    """Return the outcome of a pair of which no worker could tell anything."""
    return Outcome(item.name, status, reason, inputs_digest(item), stamp(item), seconds=seconds)


def process(system: ExpertSystem, item: BatchItem, out: Path, settings: Settings) -> Outcome:
    """Process one pair and write its products to the folder `out`, whole or not at all.

    Faults of the pair are told in the outcome; memory that does not suffice and faults of the program are, too, so that
    a batch goes on.
    """
    start, cpu = time.perf_counter(), time.process_time()

    def ended(status: OutcomeStatus, reason: str) -> Outcome:
        spent = time.perf_counter() - start
        return Outcome(item.name, status, reason, inputs, mark, seconds=spent, cpu_s=time.process_time() - cpu)

    inputs, mark = "", stamp(item)
    loaded = False
    try:
        inputs = inputs_digest(item)
        pair = _load(item)
        loaded = True
        result = system.reconstruct(pair)
        datum = None if item.stated.datum_deg is None else Datum(*item.stated.datum_deg)
        result.save(out, html=settings.html, products=settings.products, datum=datum)
    except (FormatError, PairError) as error:
        return ended("error" if loaded else "unreadable", str(error))
    except OSError as error:
        if not loaded:
            return ended("unreadable", f"{error.filename or item.left} cannot be read ({error.strerror})")
        return ended("error", str(unwritable(error.filename or out, error)))
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
    own = item.stated
    pair = StereoPair.load(
        item.left,
        item.right,
        calibration=own.calibration or None,
        attitude=_attitude(own),
        disparity_range_px=own.disparity_range_px,
        rectified=own.rectified,
        alpha=own.alpha,
        scale_calibration=own.scale_calibration,
        convention=own.convention,
    )
    pair = replace(pair, name=item.name)
    return pair if own.mask is None else pair.without_masked(own.mask)


def _attitude(own: Stated) -> Attitude | Path | None:
    if own.angles_deg is not None:
        return attitude_from_degrees(*own.angles_deg, convention=own.convention)
    if own.imu is not None and own.time_s is not None:
        return _log(own.imu, own.convention, own.imu.stat().st_mtime_ns).at(own.time_s, max_gap_s=own.max_gap_s)
    return own.attitude


@lru_cache(maxsize=2)
def _log(path: Path, convention: Convention, changed_ns: int) -> ImuLog:
    """Read a log once for all pairs of a worker; it is long, and their times are near each other."""
    return read_imu_log(path, convention)


# For workers that do not share a disk


@dataclass(frozen=True)
class Packed:
    """An item with the content of its files, for a worker that cannot read them."""

    item: BatchItem
    files: tuple[bytes, ...]


def pack(item: BatchItem) -> Packed:
    """Read the files of an item.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    return Packed(item, tuple(path.read_bytes() for path in item.files))


def process_packed(system: ExpertSystem, packed: Packed, settings: Settings) -> Outcome:
    """Process a packed item in a temporary folder; the products come back as a ZIP archive in the outcome."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        paths = [home / str(number) / path.name for number, path in enumerate(packed.item.files)]
        for path, content in zip(paths, packed.files, strict=True):
            path.parent.mkdir()
            path.write_bytes(content)
        outcome = process(system, packed.item.moved(paths), home / "out", settings)
        archive = io.BytesIO()
        if (home / "out").is_dir():
            with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as file:
                for path in sorted((home / "out").iterdir()):
                    file.write(path, path.name)
        return replace(outcome, products=archive.getvalue() or None)


def unpack(products: bytes, folder: Path) -> None:
    """Write the products of a packed item into a folder; names with a path in them are refused."""
    with zipfile.ZipFile(io.BytesIO(products)) as file:
        for name in file.namelist():
            if Path(name).name != name:
                raise FormatError(f"the worker returned a file named {name!r}, which leads out of its folder")
            (folder / name).write_bytes(file.read(name))


def settings_digest(record: Mapping[str, object], versions: Mapping[str, str]) -> str:
    """Return the SHA-256 of everything but the pair that a decision and its products depend on."""
    relevant = sorted(record.items()), sorted((name, value) for name, value in versions.items() if name != "python")
    return hashlib.sha256(json.dumps(relevant).encode()).hexdigest()
