"""Round trips, refusals and atomic folders."""

import math
import struct
import zlib

import numpy as np
import pytest

from modules import formats as f
from modules.primitives.frames import mount_angles, mount_from_angles
from modules.types import Attitude, Calibration, ElevationMap, Mount, PointCloud

RNG = np.random.default_rng(5)
MIDDLEBURY = (
    "cam0=[ 935 0 148 ; 0 935 138 ; 0 0 1 ] \ncam1=[ 935 0 198 ; 0 935 138 ; 0 0 1 ]\n doffs= 50 \n"
    "baseline= 160\n width= 347 \nheight= 277 \nndisp= 64\n"
)
YAML = "focal_px: 500\ncx_px: 320\ncy_px: 240\nbaseline_m: 0.09\nwidth_px: 640\nheight_px: 480\n"


def noise(shape, dtype=np.uint8):
    return RNG.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3)])
def test_images_survive_a_png(tmp_path, dtype, shape):
    image = noise(shape, dtype)
    f.write_image(tmp_path / "a.png", image)
    back = f.read_image(tmp_path / "a.png")
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, image)


def test_red_is_first_and_alpha_is_dropped(tmp_path):
    from PIL import Image as Pillow

    rgba = np.zeros((16, 16, 4), np.uint8)
    rgba[..., 0], rgba[..., 3] = 200, 9
    Pillow.fromarray(rgba).save(tmp_path / "a.png")
    image = f.read_image(tmp_path / "a.png")
    assert image.shape == (16, 16, 3)
    assert image[0, 0].tolist() == [200, 0, 0]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("part", [0.3, 0.9, 0.999])
def test_truncated_images_are_refused(tmp_path, suffix, part):
    path = tmp_path / f"a{suffix}"
    f.write_image(path, noise((64, 64, 3)))
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * part)])
    with pytest.raises(f.FormatError, match="truncated"):
        f.read_image(path)


def test_a_flipped_byte_is_noticed(tmp_path):
    path = tmp_path / "a.png"
    f.write_image(path, noise((64, 64)))
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(bytes(content))
    with pytest.raises(f.FormatError, match="checksum"):
        f.read_image(path)


def test_an_enormous_image_is_refused_before_it_is_decoded(tmp_path):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 60000, 60000, 8, 0, 0, 0, 0)
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IEND", b""))
    with pytest.raises(f.FormatError, match="60000x60000 px, above the limit of 100 megapixels"):
        f.read_image(tmp_path / "a.png")


def test_other_unreadable_images_are_named(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "empty.png").write_bytes(b"")
    f.write_image(tmp_path / "dot.png", noise((1, 1)))
    for name, words in (
        ("text.png", "not an image"),
        ("empty.png", "empty"),
        ("dot.png", "1x1 px and needs at least 16"),
        ("none.png", "does not exist"),
        (".", "is a folder"),
    ):
        with pytest.raises(f.FormatError, match=words):
            f.read_image(tmp_path / name)


def test_a_middlebury_calibration_is_read_with_its_stray_spaces(tmp_path):
    (tmp_path / "calib.txt").write_text(MIDDLEBURY)
    found = f.read_calibration(tmp_path / "calib.txt")
    assert found.rectified == Calibration(935.0, 148.0, 138.0, 0.16, 347, 277, 50.0)
    assert (found.format, found.rig, found.mount) == ("Middlebury", None, None)


def test_calibration_and_mount_survive_yaml(tmp_path):
    calibration = Calibration(500.1, 320.2, 240.3, 0.0912345678901, 640, 480, -1.5)
    mount = mount_from_angles(0.1, 0.2, 0.3, (1.0, 2.0, 3.0))
    f.write_calibration(tmp_path / "c.yaml", calibration, mount)
    back = f.read_calibration(tmp_path / "c.yaml")
    assert back.rectified == calibration
    np.testing.assert_array_equal(back.mount.rotation, mount.rotation)
    assert back.mount.translation_m == mount.translation_m


def test_a_mount_with_positive_pitch_looks_down(tmp_path):
    (tmp_path / "c.yaml").write_text(YAML + "mount: {pitch_deg: 30, translation_m: [0, 0, 1]}\n")
    mount = f.read_calibration(tmp_path / "c.yaml").mount
    np.testing.assert_allclose(mount.rotation @ [0, 0, 1], [math.cos(math.pi / 6), 0, -0.5], atol=1e-12)
    np.testing.assert_allclose(np.degrees(mount_angles(mount)), [0, 30, 0], atol=1e-9)
    np.testing.assert_allclose(mount_angles(Mount()), 0, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("baseline_m: 0.09", "baseline_m: 0", "baseline is 0 m and must be above 0"),
        ("baseline_m: 0.09", "baseline_m: -0.09", "swap the images"),
        ("baseline_m: 0.09", "baseline_m: 193", "is it in mm"),
        ("baseline_m: 0.09", "baseline_m: .nan", "must be finite"),
        ("baseline_m: 0.09", "basline_m: 0.09", "unknown field 'basline_m'; did you mean 'baseline_m'"),
        ("focal_px: 500", "focal_px: 3", "3 px, below 64 px .* is it in mm"),
        ("focal_px: 500", "focal_px: wide", "'wide' and must be a number"),
        ("focal_px: 500\n", "", "no 'focal_px'"),
        ("width_px: 640", "width_px: 640.5", "whole number"),
        ("width_px: 640", "width_px: 0", "0x480 px and must be positive"),
        ("cx_px", "mount: {rotation_matrix: [[1,0,0],[0,1,0],[0,0,2]]}\ncx_px", "no rotation"),
        ("cx_px: 320", "[", "not YAML"),
    ],
)
def test_impossible_calibrations_are_refused(tmp_path, old, new, words):
    (tmp_path / "c.yaml").write_text(YAML.replace(old, new))
    with pytest.raises(f.FormatError, match=words):
        f.read_calibration(tmp_path / "c.yaml")


def test_a_calibration_of_another_size_is_refused_with_the_scale():
    calibration = Calibration(500, 320, 240, 0.09, 640, 480)
    f.check_calibration(calibration, (480, 640))
    with pytest.raises(f.FormatError, match=r"the aspect fits a scale of 0\.5: .*--scale-calibration"):
        f.check_calibration(calibration, (240, 320))
    with pytest.raises(f.FormatError, match="640x480 px and the images are 600x480"):
        f.check_calibration(calibration, (480, 600))


def test_an_attitude_survives(tmp_path):
    attitude = Attitude(0.1, -0.2, 3.0, 0.01)
    f.write_attitude(tmp_path / "a.yaml", attitude)
    back = f.read_attitude(tmp_path / "a.yaml")
    np.testing.assert_allclose(
        [back.roll_rad, back.pitch_rad, back.yaw_rad, back.sigma_rad], [0.1, -0.2, 3.0, 0.01], atol=1e-12
    )


def test_a_quaternion_about_y_is_pitch(tmp_path):
    half = math.radians(15)
    (tmp_path / "a.yaml").write_text(f"quaternion: {{w: {math.cos(half)}, x: 0, y: {math.sin(half)}, z: 0}}\n")
    assert math.degrees(f.read_attitude(tmp_path / "a.yaml").pitch_rad) == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("roll_deg: 91", "roll_deg is 91 deg, outside -90 to 90"),
        ("pitch_deg: -100", "pitch_deg is -100"),
        ("sigma_deg: -1\nroll_deg: 0", "sigma_deg is -1"),
        ("quaternion: {w: 1, x: 1, y: 0, z: 0}", "length 1.414"),
        ("quaternion: {w: 1, x: 0}", "must be a mapping with w, x, y and z"),
        ("roll_deg: 1\nquaternion: {w: 1, x: 0, y: 0, z: 0}", "both"),
        ("sigma_deg: 1", "neither"),
        ("- 1", "holds list"),
    ],
)
def test_impossible_attitudes_are_refused(tmp_path, text, words):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(f.FormatError, match=words):
        f.read_attitude(tmp_path / "a.yaml")


def test_a_pfm_survives_and_holds_the_bottom_row_first(tmp_path):
    disparity = np.array([[1.5, np.nan], [-2.0, 300.0], [4.0, 5.0]], np.float32)
    f.write_pfm(tmp_path / "d.pfm", disparity)
    np.testing.assert_array_equal(f.read_pfm(tmp_path / "d.pfm"), disparity)
    content = (tmp_path / "d.pfm").read_bytes()
    assert np.frombuffer(content[-24:], "<f4").tolist() == [4.0, 5.0, -2.0, 300.0, 1.5, np.inf]
    (tmp_path / "d.pfm").write_bytes(content[:-1])
    with pytest.raises(f.FormatError, match="23 bytes of data and 2x3 px need 24"):
        f.read_pfm(tmp_path / "d.pfm")


def test_a_disparity_png_is_right_to_a_512th_and_refuses_what_it_cannot_hold(tmp_path):
    disparity = RNG.uniform(0.01, 255, (20, 30)).astype(np.float32)
    disparity[0, 0] = np.nan
    f.write_disparity_png(tmp_path / "d.png", disparity)
    np.testing.assert_allclose(f.read_disparity_png(tmp_path / "d.png"), disparity, atol=1 / 512 + 1e-6)
    disparity[0, 0] = 256.0
    with pytest.raises(f.FormatError, match="write a PFM"):
        f.write_disparity_png(tmp_path / "d.png", disparity)
    f.write_disparity_view(tmp_path / "v.png", disparity)


def test_validity_survives(tmp_path):
    flags = noise((20, 30), np.uint16)
    f.write_validity_png(tmp_path / "v.png", flags)
    np.testing.assert_array_equal(f.read_validity_png(tmp_path / "v.png"), flags)


def test_a_ply_survives_and_another_reader_agrees(tmp_path):
    from plyfile import PlyData

    xyz = RNG.normal(size=(7, 3)).astype(np.float32)
    f.write_ply(tmp_path / "p.ply", PointCloud(xyz, "level", np.arange(7, dtype=np.int32), noise((7, 3))))
    back = f.read_ply(tmp_path / "p.ply")
    np.testing.assert_array_equal(back.xyz_m, xyz)
    assert back.frame == "level"
    vertices = PlyData.read(str(tmp_path / "p.ply"))["vertex"]
    np.testing.assert_array_equal(vertices["z"], xyz[:, 2])
    np.testing.assert_array_equal(vertices["red"], back.rgb[:, 0])


def test_a_geotiff_survives_with_the_highest_y_first(tmp_path):
    import tifffile

    elevation = RNG.normal(size=(5, 8)).astype(np.float32)
    elevation[1, 2] = np.nan
    grid = ElevationMap(-1.0, 2.0, 0.25, {"elevation": elevation})
    f.write_geotiff(tmp_path / "e.tif", grid)
    back = f.read_geotiff(tmp_path / "e.tif")
    assert (back.x0_m, back.y0_m, back.cell_m) == (-1.0, 2.0, 0.25)
    np.testing.assert_array_equal(back.layers["elevation"], elevation)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "e.tif")[0], elevation[-1])
    with pytest.raises(f.FormatError, match="no layer 'slope'"):
        f.write_geotiff(tmp_path / "e.tif", grid, "slope")


def test_a_hillshade_is_drawn(tmp_path):
    elevation = np.fromfunction(lambda i, j: 0.01 * j, (40, 30)).astype(np.float32)
    f.write_terrain_picture(tmp_path / "h.png", ElevationMap(0, 0, 0.1, {"elevation": elevation}))
    assert f.read_image(tmp_path / "h.png").shape[2] == 3


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    out = tmp_path / "deep" / "out"

    def fail():
        with f.whole_folder(out) as folder:
            (folder / "b.txt").write_text("2")
            raise RuntimeError("stop")

    with f.whole_folder(out) as folder:
        (folder / "a.txt").write_text("1")
        assert not out.exists()
    with pytest.raises(RuntimeError):
        fail()
    assert sorted(path.name for path in out.iterdir()) == [".terrex", "a.txt"]
    with f.whole_folder(out) as folder:
        (folder / "c.txt").write_text("3")
    assert sorted(path.name for path in out.iterdir()) == [".terrex", "c.txt"]
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_foreign_files_are_never_replaced(tmp_path):
    (tmp_path / "thesis.txt").write_text("precious")
    with (
        pytest.raises(f.FormatError, match=r"1 files that were not written by terrex \(thesis.txt\)"),
        f.whole_folder(tmp_path),
    ):
        pass
    with pytest.raises(f.FormatError, match="is a file"), f.whole_folder(tmp_path / "thesis.txt"):
        pass
    with pytest.raises(f.FormatError, match="cannot be written"), f.whole_folder("/proc/none/out"):
        pass
