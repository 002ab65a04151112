"""Every terrain product opens in an independent reader and gives the same numbers back."""

import base64
import hashlib
import json
import math
import re
import struct
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from modules import formats as f
from modules.formats.layers import parse_layers, write_layers
from modules.formats.terrain_pictures import UNKNOWN, draw_map, write_ortho
from modules.formats.viewer import write_viewer
from modules.primitives.surface import surface_of
from modules.types import Datum, ElevationMap, Hazard, PointCloud

RNG = np.random.default_rng(11)


def cloud(count=500, uncertain=True):
    factor = RNG.normal(size=(count, 3, 3)).astype(np.float32) * 0.02
    full = factor @ factor.transpose(0, 2, 1)
    covariance = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return PointCloud(
        xyz_m=np.column_stack([RNG.uniform(0, 2, count), RNG.uniform(-1, 1, count), RNG.normal(0, 0.1, count)]).astype(
            np.float32
        ),
        frame="level",
        pixel=np.arange(count, dtype=np.int32),
        rgb=RNG.integers(0, 256, (count, 3), dtype=np.uint8),
        covariance_m2=covariance.astype(np.float32) if uncertain else None,
    )


def grid(rows=20, columns=40):
    i, j = np.indices((rows, columns))
    elevation = (0.02 * j - 0.03 * i + 0.05 * np.sin(i)).astype(np.float32)
    elevation[3:6, 10:14] = np.nan
    hazard = np.zeros((rows, columns), np.uint8)
    hazard[8:10, 20:22] = Hazard.STEP
    hazard[np.isnan(elevation)] = Hazard.UNKNOWN
    layers = {
        "elevation": elevation,
        "sigma_m": np.full(elevation.shape, 0.02, np.float32),
        "slope_deg": np.where(np.isnan(elevation), np.nan, 30.0).astype(np.float32),
        "count": np.full(elevation.shape, 7, np.int32),
        "filled": np.zeros(elevation.shape, bool),
        "hazard": hazard,
        "traversability": np.where(np.isnan(elevation), np.nan, 0.5).astype(np.float32),
    }
    return ElevationMap(0.0, -0.5, 0.05, layers)


def test_plyfile_reads_points_colours_and_covariances(tmp_path):
    from plyfile import PlyData

    points = cloud()
    f.write_ply(tmp_path / "p.ply", points)
    vertex = PlyData.read(tmp_path / "p.ply")["vertex"]
    np.testing.assert_array_equal(np.column_stack([vertex[name] for name in "xyz"]), points.xyz_m)
    np.testing.assert_array_equal(np.column_stack([vertex[n] for n in ("red", "green", "blue")]), points.rgb)
    names = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
    np.testing.assert_array_equal(np.column_stack([vertex[name] for name in names]), points.covariance_m2)
    back = f.read_ply(tmp_path / "p.ply")
    np.testing.assert_array_equal(back.covariance_m2, points.covariance_m2)
    assert back.frame == "level"


def read_pcd(path):
    """Read a PCD by its public description."""
    head, data = path.read_bytes().split(b"DATA binary\n", 1)
    field = {line.split()[0]: line.split()[1:] for line in head.decode().splitlines() if not line.startswith("#")}
    kinds = {("F", "4"): "<f4", ("U", "4"): "<u4"}
    kind = [kinds[pair] for pair in zip(field["TYPE"], field["SIZE"], strict=True)]
    rows = np.frombuffer(data, np.dtype(list(zip(field["FIELDS"], kind, strict=True))))
    assert len(rows) == int(field["POINTS"][0]) == int(field["WIDTH"][0]) * int(field["HEIGHT"][0])
    return rows


def test_a_pcd_holds_points_packed_colours_and_sigma(tmp_path):
    points = cloud()
    f.write_pcd(tmp_path / "p.pcd", points)
    rows = read_pcd(tmp_path / "p.pcd")
    np.testing.assert_array_equal(np.column_stack([rows[name] for name in "xyz"]), points.xyz_m)
    unpacked = np.column_stack([(rows["rgb"] >> shift) & 255 for shift in (16, 8, 0)])
    np.testing.assert_array_equal(unpacked, points.rgb)
    np.testing.assert_array_equal(rows["sigma_z"], np.sqrt(points.covariance_m2[:, 5]))


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_laspy_reads_points_colours_and_sigma(tmp_path, suffix):
    laspy = pytest.importorskip("laspy", reason="the extra geo is not installed")
    points = cloud()
    path = tmp_path / f"p.{suffix}"
    f.write_las(path, points)
    las = laspy.read(path)
    assert str(las.header.version) == "1.4"
    np.testing.assert_allclose(np.column_stack([las.x, las.y, las.z]), points.xyz_m, atol=0.51e-4)
    np.testing.assert_array_equal(np.column_stack([las.red, las.green, las.blue]) // 257, points.rgb)
    np.testing.assert_array_equal(las["sigma_z"], np.sqrt(points.covariance_m2[:, 5]))


def test_las_without_its_extra_is_refused_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(f.FormatError, match=r"needs laspy, which is not installed; install terrex\[geo\]"):
        f.write_las(tmp_path / "p.las", cloud())
    assert not (tmp_path / "p.las").exists()


def test_trimesh_reads_the_obj_with_colours(tmp_path):
    import trimesh

    points, elevation = cloud(), grid()
    f.write_obj(tmp_path / "m.obj", elevation, points)
    mesh = trimesh.load(tmp_path / "m.obj", process=False, maintain_order=True)
    wanted = surface_of(elevation, points)
    np.testing.assert_allclose(mesh.vertices, wanted.vertices_m, atol=1e-5)
    np.testing.assert_array_equal(mesh.faces, wanted.faces)
    np.testing.assert_allclose(np.asarray(mesh.visual.vertex_colors)[:, :3], wanted.rgb, atol=1)


def test_trimesh_reads_the_glb_upright_with_linear_colours(tmp_path):
    import trimesh

    points, elevation = cloud(), grid()
    f.write_glb(tmp_path / "m.glb", elevation, points)
    scene = trimesh.load(tmp_path / "m.glb", process=False)
    (mesh,) = scene.geometry.values()
    wanted = surface_of(elevation, points)
    np.testing.assert_array_equal(mesh.vertices.astype(np.float32), wanted.vertices_m)
    np.testing.assert_array_equal(mesh.faces, wanted.faces)
    placed = scene.to_geometry().vertices  # as a viewer with y up shows it: x ahead is z, left is x
    np.testing.assert_allclose(placed, wanted.vertices_m[:, [1, 2, 0]], atol=1e-6)
    value = wanted.rgb / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    found = np.asarray(mesh.visual.vertex_attributes["color"], float)[:, :3]
    np.testing.assert_allclose(found / 65535.0, linear, atol=1e-5)


def test_triangles_face_up_and_span_no_unknown_cell():
    surface = surface_of(grid())
    a, b, c = (surface.vertices_m[surface.faces[:, k]].astype(float) for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    assert np.hypot(*(a - b)[:, :2].T).max() < 0.08  # the diagonal of a cell
    assert len(surface.vertices_m) == 20 * 40 - 12
    assert (surface.rgb == 160).all()


def test_a_cell_has_the_mean_colour_of_its_points():
    xyz = np.array([[0.01, -0.49, 0.0], [0.02, -0.48, 0.0]], np.float32)
    points = PointCloud(
        xyz, "level", np.arange(2, dtype=np.int32), rgb=np.array([[10, 20, 30], [30, 40, 50]], np.uint8)
    )
    assert surface_of(grid(), points).rgb[0].tolist() == [20, 30, 40]


def test_a_map_without_three_neighbouring_cells_has_no_mesh(tmp_path):
    lone = np.full((4, 4), np.nan, np.float32)
    lone[1, 1] = 0.0
    with pytest.raises(f.FormatError, match="no three neighbouring cells"):
        f.write_obj(tmp_path / "m.obj", ElevationMap(0.0, 0.0, 0.1, {"elevation": lone}))
    assert not (tmp_path / "m.obj").exists()


def load_map(path):
    """Read a map as the map_server of ROS 2 does in the mode `trinary`; returns data, resolution and origin."""
    from PIL import Image

    stated = yaml.safe_load(path.read_text())
    assert stated["mode"] == "trinary"
    picture = np.asarray(Image.open(path.parent / stated["image"]))
    shade = picture / 255.0
    occupied = shade if stated["negate"] else 1.0 - shade
    data = np.full(picture.shape, -1, np.int8)
    data[occupied > stated["occupied_thresh"]] = 100
    data[occupied < stated["free_thresh"]] = 0
    return data[::-1], stated["resolution"], stated["origin"]  # row 0 of a map is the lowest y


@pytest.mark.parametrize("free_thresh", [0.25, 0.196])
def test_map_server_reads_the_occupancy_map(tmp_path, free_thresh):
    elevation = grid()
    f.write_occupancy(tmp_path / "o.yaml", elevation)
    text = (tmp_path / "o.yaml").read_text().replace("free_thresh: 0.25", f"free_thresh: {free_thresh}")
    (tmp_path / "o.yaml").write_text(text)
    data, resolution, origin = load_map(tmp_path / "o.yaml")
    np.testing.assert_array_equal(data, f.occupancy_of(elevation))
    assert (resolution, origin) == (0.05, [0.0, -0.5, 0.0])
    assert data[8, 20] == 100
    assert data[4, 11] == -1
    assert data[0, 0] == 0


def test_an_occupancy_map_needs_hazards(tmp_path):
    with pytest.raises(f.FormatError, match="needs the layer 'hazard'"):
        f.write_occupancy(tmp_path / "o.yaml", ElevationMap(0, 0, 1, {"elevation": np.zeros((2, 2), np.float32)}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_rasterio_reads_the_geotiff_without_a_datum(tmp_path):
    rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")
    elevation = grid()
    f.write_geotiff(tmp_path / "e.tif", elevation)
    with rasterio.open(tmp_path / "e.tif") as file:
        band = file.read(1, masked=True)
        assert file.nodata == -9999.0
        assert file.transform.to_gdal() == pytest.approx((0.0, 0.05, 0.0, 0.5, 0.0, -0.05))
    np.testing.assert_array_equal(band.filled(np.nan)[::-1], elevation.layers["elevation"])


def test_rasterio_finds_the_place_of_a_geotiff_with_a_datum(tmp_path):
    rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")
    from rasterio.warp import transform

    elevation = grid()
    f.write_geotiff(tmp_path / "e.tif", elevation, datum=Datum(75.35, -89.6))
    with rasterio.open(tmp_path / "e.tif") as file:
        np.testing.assert_array_equal(file.read(1, masked=True).filled(np.nan)[::-1], elevation.layers["elevation"])
        east, north = transform(file.crs, "EPSG:4326", [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    np.testing.assert_allclose([east[0], north[0]], [-89.6, 75.35], atol=1e-9)
    # One metre east and north by the radii of curvature of the WGS 84 ellipsoid.
    a, e2, latitude = 6378137.0, 6.69437999014e-3, math.radians(75.35)
    w2 = 1.0 - e2 * math.sin(latitude) ** 2
    assert east[1] + 89.6 == pytest.approx(math.degrees(math.sqrt(w2) / (a * math.cos(latitude))), rel=1e-5)
    assert north[2] - 75.35 == pytest.approx(math.degrees(w2**1.5 / (a * (1.0 - e2))), rel=1e-5)
    back = f.read_geotiff(tmp_path / "e.tif")
    assert (back.x0_m, back.y0_m) == pytest.approx((0.0, -0.5))


def test_a_datum_without_rasterio_is_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(f.FormatError, match=r"needs rasterio, .*; install terrex\[geo\] or leave the datum out"):
        f.write_geotiff(tmp_path / "e.tif", grid(), datum=Datum(10.0, 20.0))
    assert list(tmp_path.iterdir()) == []


def test_a_datum_that_is_no_place_is_refused():
    with pytest.raises(ValueError, match=r"datum 95 20 is no place; give latitude -90 to 90"):
        Datum(95.0, 20.0)


def test_layers_survive_with_units_and_place(tmp_path):
    elevation = grid()
    f.write_layers(tmp_path / "l.npz", elevation)
    back = f.read_layers(tmp_path / "l.npz")
    assert (back.x0_m, back.y0_m, back.cell_m, back.frame) == (0.0, -0.5, 0.05, "level")
    assert back.layers.keys() == elevation.layers.keys()
    for name, layer in elevation.layers.items():
        assert back.layers[name].dtype == layer.dtype
        np.testing.assert_array_equal(back.layers[name], layer)
    with np.load(tmp_path / "l.npz") as file:
        described = json.loads(str(file["description"]))["layers"]
    assert described["slope_deg"]["unit"] == "deg"
    assert described["elevation"]["unit"] == "m"


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 broken"])
def test_other_files_are_no_layers(tmp_path, content):
    (tmp_path / "l.npz").write_bytes(content)
    with pytest.raises(f.FormatError, match="holds no layers of an elevation map"):
        f.read_layers(tmp_path / "l.npz")


@pytest.mark.parametrize("kind", ["relief", "height", "slope", "traversability"])
@pytest.mark.parametrize("shape", [(20, 40), (3, 200), (400, 300)])
def test_pictures_show_forward_up_and_left_left(tmp_path, kind, shape):
    from PIL import Image

    elevation = grid(*shape) if min(shape) > 14 else ElevationMap(1.0, 0.0, 0.05, {
        name: np.ones(shape, np.float32) * 0.5 for name in ("elevation", "slope_deg", "traversability")
    })  # fmt: skip
    f.write_terrain_picture(tmp_path / "p.png", elevation, kind)
    with Image.open(tmp_path / "p.png") as image:
        assert image.mode == "RGB"
        assert 300 < image.width < 2200
        assert 60 < image.height < 2200


def test_a_high_corner_is_drawn_where_it_lies(tmp_path):
    elevation = np.zeros((20, 20), np.float32)
    elevation[:5, 15:] = 1.0  # far ahead and to the right
    f.write_terrain_picture(tmp_path / "p.png", ElevationMap(0.0, -0.5, 0.05, {"elevation": elevation}), "height")
    picture = f.read_image(tmp_path / "p.png").astype(int)
    yellow = (picture[..., 0] > 200) & (picture[..., 1] > 200) & (picture[..., 2] < 90)
    rows, columns = np.nonzero(yellow[:, :860])
    assert rows.mean() < 0.35 * picture.shape[0]
    assert columns.mean() > 0.6 * 860


def test_pictures_say_what_their_colours_leave_out():
    """The colours end at 2 and 98 % of the heights; a rock above is one of them all the same."""
    elevation = grid()
    elevation.layers["elevation"][0, 0] = 7.0
    for kind in ("relief", "height"):
        assert "heights from -0.58 to 7.00 m" in draw_map(elevation, kind).words
    assert draw_map(elevation, "slope").words.startswith("colours end at 40 deg")
    assert draw_map(elevation, "traversability").words.startswith("1 safe, 0 not")


def test_a_picture_without_its_layer_is_refused(tmp_path):
    bare = ElevationMap(0.0, 0.0, 0.05, {"elevation": np.zeros((20, 20), np.float32)})
    with pytest.raises(f.FormatError, match="no layer 'slope_deg'"):
        f.write_terrain_picture(tmp_path / "p.png", bare, "slope")


def page_data(page):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S).group(1))


def test_the_page_holds_the_terrain_and_needs_nothing_else(tmp_path):
    elevation, points = grid(), cloud()
    write_viewer(tmp_path / "t.html", elevation, points, "</script><b>evil & co")
    page = (tmp_path / "t.html").read_text(encoding="utf-8")
    assert "<b>evil" not in page
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)", page)
    assert "http" not in page.replace("http-equiv", "")
    script = re.findall(r"<script>(.*?)</script>", page, re.S)
    digest = base64.b64encode(hashlib.sha256(script[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page
    data = page_data(page)
    height = np.frombuffer(base64.b64decode(data["height"]), "<u2").reshape(data["rows"], data["columns"])
    known = height != 65535
    z = data["zMin"] + height / 65534 * (data["zMax"] - data["zMin"])
    truth = elevation.layers["elevation"]
    np.testing.assert_array_equal(known, np.isfinite(truth))
    np.testing.assert_allclose(z[known], truth[known], atol=1e-4)
    assert [layer["name"] for layer in data["layers"]] == ["image", "height", "sigma", "slope", "traversability"]


def test_a_large_map_is_thinned_to_fit_a_page(tmp_path):
    rows, columns = 1500, 1200
    layers = {name: RNG.normal(size=(rows, columns)).astype(np.float32) for name in ("elevation", "sigma_m")}
    write_viewer(tmp_path / "t.html", ElevationMap(0.0, 0.0, 0.1, layers), cloud())
    assert (tmp_path / "t.html").stat().st_size < 8_000_000
    data = page_data((tmp_path / "t.html").read_text(encoding="utf-8"))
    assert data["rows"] * data["columns"] <= 500_000
    assert data["x0"] + 0.5 * data["cell"] == pytest.approx(0.05)  # the first cell kept is the first cell


def test_points_without_covariance_and_colour_are_written_bare(tmp_path):
    bare = PointCloud(np.ones((3, 3), np.float32), "level", np.arange(3, dtype=np.int32))
    f.write_ply(tmp_path / "p.ply", bare)
    assert f.read_ply(tmp_path / "p.ply").covariance_m2 is None
    f.write_pcd(tmp_path / "p.pcd", bare)
    assert read_pcd(tmp_path / "p.pcd").dtype.names == ("x", "y", "z")
    assert struct.calcsize("<3f") * 3 < (tmp_path / "p.pcd").stat().st_size


def test_equal_layers_give_equal_bytes_and_single_layers_can_be_read(tmp_path):
    write_layers(tmp_path / "a.npz", grid())
    write_layers(tmp_path / "b.npz", grid())
    content = (tmp_path / "a.npz").read_bytes()
    assert content == (tmp_path / "b.npz").read_bytes()
    assert set(parse_layers("a.npz", content, {"elevation"}).layers) == {"elevation"}


def test_the_ground_from_above_has_forward_up_left_left_and_unknown_cells_dark(tmp_path):
    made = grid(4, 6)
    elevation = np.asarray(made.layers["elevation"]).copy()
    elevation[:] = 0.0
    elevation[0, 0] = np.nan
    colours = np.full((4, 6, 3), 100, np.uint8)
    colours[3, 5] = (1, 2, 3)  # the largest y and x: farthest to the left, and ahead
    write_ortho(tmp_path / "o.png", replace(made, layers={"elevation": elevation}), colours)
    picture = cv2.imread(str(tmp_path / "o.png"))[:, :, ::-1]
    assert picture.shape == (6, 4, 3)
    assert tuple(picture[0, 0]) == (1, 2, 3)
    assert tuple(picture[5, 3]) == UNKNOWN
