"""Measure the time of every operator of correction: `make bench-correction`.

    python -m benchmarks.correction [--width 640] [--height 480] [--runs 7] [--bits 8]

CPU milliseconds of one core on a rendered colour pair whose right image is darker and vignetted: the least of some
runs, the bar where there is one, what the operator's own cost model says, and what scikit-image, SciPy or OpenCV take
for a comparable step on both images.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy import ndimage
from skimage import exposure, restoration

from modules.correction import OPERATORS
from modules.simulation import TerrainParams, render_terrain
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.types import Image, Views

DIFFERENCE = SensorParams(gain=0.7, vignetting=0.3, noise_sigma_dn=2.0, misalign_rad=0.002, shift_y_px=1.0)
BARS_MS = {
    "align_rows": 90, "match_histograms": 8, "fit_gain_offset": 8, "equalize_histogram": 8, "balance_white": 8,
    "warp_histograms_dynamically": 30, "calibrate_segments": 80, "normalise_local_contrast": 30,
    "transfer_local_affine": 30, "level_gain_field": 30, "fit_response": 30, "mask_featureless": 30,
}  # fmt: skip
BUSY = {"align_rows": {"offset_px": 1.0, "roll_deg": 0.1146}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=480)
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--bits", type=int, choices=(8, 16), default=8)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    views = pair(args.width, args.height, args.bits)
    others = comparable(views) if args.bits == 8 else {}
    print(f"{args.width}x{args.height}, {args.bits} bit, colour; CPU ms of one core, least of {args.runs} runs")
    print(f"{'operator':34s}{'ms':>8s}{'bar':>6s}{'model':>8s}  comparable")
    for operator in OPERATORS:
        name = operator.name.split(".")[1]
        params = operator.params(**BUSY.get(name, {}))
        spent = least_ms(lambda run=operator.function, given=params: run(views, given), args.runs)
        bar = BARS_MS.get(name)
        mark = "" if bar is None else f"{bar}{'!' if spent > bar else ' '}"
        other = ", ".join(f"{what} {least_ms(call, 3):.1f}" for what, call in others.get(name, ()))
        model = 1000 * operator.cost.seconds(args.width * args.height)
        print(f"{name:34s}{spent:8.1f}{mark:>6s}{model:8.1f}  {other}")


def pair(width: int, height: int, bits: int) -> Views:
    """Return a rendered pair whose right image differs."""
    made = render_terrain(TerrainParams(seed=7, width_px=width, height_px=height, focal_px=500.0 * width / 640))
    images = made.left, apply_sensor(made.right, DIFFERENCE, seed=1)
    if bits == 16:
        return Views(*(image.astype(np.uint16) * np.uint16(257) for image in images))
    return Views(*images)


def least_ms(call: Callable[[], object], runs: int) -> float:
    """Return the least CPU time of some runs, ms."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return 1000 * min(times)


def comparable(views: Views) -> dict[str, tuple[tuple[str, Callable[[], object]], ...]]:
    """Return what other libraries do for comparable steps, on both images where the operator works on both."""
    left, right = views.left, views.right

    def both(call: Callable[[Image], object]) -> Callable[[], object]:
        return lambda: [call(image) for image in (left, right)]

    def planes(call: Callable[[Image], object]) -> Callable[[], object]:
        return both(lambda image: [call(np.ascontiguousarray(image[..., channel])) for channel in range(3)])

    height, width = left.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 0.1, 1.0)
    clahe = cv2.createCLAHE(2.0, (8, 8))
    return {
        "align_rows": (
            ("cv2.warpAffine", lambda: cv2.warpAffine(right, turn, (width, height), flags=cv2.INTER_CUBIC)),
        ),
        "match_histograms": (
            ("skimage.match_histograms", lambda: exposure.match_histograms(right, left, channel_axis=-1)),
        ),
        "equalize_histogram": (("cv2.equalizeHist", planes(cv2.equalizeHist)),),
        "equalize_adaptively": (("cv2 CLAHE", planes(clahe.apply)),),
        "denoise_gaussian": (("cv2.GaussianBlur", both(lambda image: cv2.GaussianBlur(image, (0, 0), 1.0))),),
        "denoise_bilateral": (("cv2.bilateralFilter", both(lambda image: cv2.bilateralFilter(image, 7, 30, 1.5))),),
        "denoise_non_local_means": (
            ("cv2, coloured", both(lambda image: cv2.fastNlMeansDenoisingColored(image, None, 10, 10, 5, 15))),
            (
                "skimage, luminance",
                both(lambda image: restoration.denoise_nl_means(image.mean(axis=2), 5, 7, h=10, fast_mode=True)),
            ),
        ),
        "filter_laplacian": (
            ("scipy.gaussian_laplace", planes(lambda plane: ndimage.gaussian_laplace(plane.astype(np.float32), 1.5))),
        ),
        "normalise_local_contrast": (
            ("cv2.GaussianBlur of g and g^2, full size", both(full_statistics)),
        ),
    }  # fmt: skip


def full_statistics(image: Image) -> object:
    """Return the local mean and mean square without reducing the image first."""
    values = image.astype(np.float32)
    return cv2.GaussianBlur(values, (0, 0), 20), cv2.GaussianBlur(values * values, (0, 0), 20)


if __name__ == "__main__":
    main()
