"""The report: one page that needs nothing else, the same from a saved run, and deaf to markup in what it shows."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from made_reports import EVIL, layers, pair_images, png, record
from synthetic_pairs import shifted_pair

from expert.api import ExpertSystem
from expert.cli import main
from expert.decision import Decision, FactRecord
from expert.pair import StereoPair
from expert.report import as_html, as_markdown, as_outline, as_text, render_again, verdict
from expert.report.pictures import MAX_BYTES, MAX_SIDE_PX, decode, drawing, histograms, pair_pictures, picture
from expert.report.terrain import terrain
from expert.report.validity import validity_shares
from expert.result import Result
from modules.catalog import operators
from modules.formats import FormatError
from modules.formats.disparity import view_range_px, write_pfm
from modules.formats.layers import parse_layers
from modules.formats.viewer import viewer_page
from modules.types import Disparity, Views


class Page(HTMLParser):
    """Collects what a browser would load, link and run."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.open: list[str] = []
        self.problems: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "wbr":  # where a name may be broken; their number follows the rows
            return
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in ("meta", "link", "img", "input", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.problems.append(tag)

    def of(self, tag: str, name: str) -> list[str]:
        return [value for found, key, value in self.attributes if (found, key) == (tag, name)]


def test_the_page_loads_nothing_and_its_elements_nest() -> None:
    page = Page(as_html(record(), pair_images()))
    assert not page.problems
    assert not page.open
    sources = [value for _, name, value in page.attributes if name in ("src", "href", "srcset", "data", "action")]
    assert all(value.startswith(("#", "data:")) for value in sources)
    assert "http" not in re.sub(r'http-equiv=|xmlns="[^"]*"', "", as_html(record(), {}).split("<pre")[0])


def test_markup_in_any_text_of_the_record_appears_as_text() -> None:
    plain, evil = (Page(as_html(record(text), pair_images())) for text in ("word", EVIL))
    assert evil.tags == plain.tags
    text = as_html(record(EVIL), pair_images())
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert" in text
    assert [name for _, name, _ in evil.attributes] == [name for _, name, _ in plain.attributes]


def test_the_policy_of_the_page_allows_its_own_script_only() -> None:
    text = as_html(record(), {})
    policy = Page(text).of("meta", "content")[1]
    assert "default-src 'none'" in policy
    script = text[text.index("<script>") + 8 : text.index("</script>")]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy


def test_pictures_have_texts_controls_have_labels_and_links_have_targets() -> None:
    page = Page(as_html(record(), pair_images()))
    assert len(page.of("img", "alt")) == page.tags.count("img") == 2 + 3 + 3 + 6
    assert all(page.of("img", "alt"))
    assert len(page.of("svg", "aria-label")) == 6 + 1  # histograms and graph
    assert len(page.of("svg", "aria-hidden")) == 6  # the rings over the maps say nothing new
    assert page.tags.count("svg") == 13
    ids = [value for _, name, value in page.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    assert {value[1:] for value in page.of("a", "href")} <= set(ids)
    assert set(page.of("label", "for")) <= set(ids)
    assert {value for _, name, value in page.attributes if name == "aria-labelledby"} <= set(ids)
    assert page.tags.count("h1") == 1


def test_a_changed_image_has_a_wipe_and_an_unchanged_one_says_so() -> None:
    text = as_html(record(), pair_images())
    assert 'id="wipe-right"' in text
    assert 'id="wipe-left"' not in text
    assert "Left image, unchanged by the correction" in text


def test_the_page_says_everything_that_was_decided() -> None:
    text = as_html(record(), pair_images()).replace("<wbr>", "")
    decision = record()
    for expected in (
        *dataclasses.astuple(verdict(decision)), "brightness.offset_dn", "-13.97 dn", "COR1", "Rather than 1 other",
        "channels=word, range=1, 2", "50.0 %", "0.500", decision.id, "2.000 s", "its match would lie outside",
    ):  # fmt: skip
        assert expected in text, expected


def test_a_page_without_pictures_has_no_empty_sections() -> None:
    text = as_html(record(status="failed", plans={}, trials=(), firings=()), {})
    assert not {"img", "svg"} & set(Page(text).tags)
    assert "Nothing was tried" in text
    assert "No stage was planned" in text


def test_facts_of_one_template_are_told_apart_by_their_keys() -> None:
    facts = tuple(
        FactRecord(template="histogram", fields={"side": side, "channel": "gray", "mean_dn": 5.0})
        for side in ("left", "right")
    )
    text = as_html(record(facts=facts), {}).replace("<wbr>", "")
    assert "histogram[left, gray].mean_dn" in text
    assert "histogram[right, gray].mean_dn" in text


def test_lists_read_back_from_a_record_are_written_like_the_tuples_they_were() -> None:
    decision = record()
    again = Decision.from_json(decision.to_json())
    assert as_html(again, {}) == as_html(decision, {})
    assert as_markdown(again) == as_markdown(decision)
    assert as_text(again) == as_text(decision)


def test_a_large_picture_is_scaled_down_and_a_drawing_too_large_for_png_becomes_jpeg() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (1500, 3000, 3), np.uint8)
    shown = picture(noise, photo=False)
    assert (shown.width, shown.height) == (MAX_SIDE_PX, MAX_SIDE_PX // 2)
    assert shown.uri.startswith("data:image/jpeg")
    assert picture(noise[:20, :20], photo=False).uri.startswith("data:image/png")


def test_a_small_drawing_goes_in_as_the_file_it_is() -> None:
    images = pair_images()
    shown = drawing("disparity_view.png", images["disparity_view.png"])
    assert (shown.width, shown.height) == (80, 60)
    assert base64.b64decode(shown.uri.partition(",")[2]) == images["disparity_view.png"]
    with pytest.raises(ValueError, match="x is not an image"):
        drawing("x", images["disparity_view.png"][:-1][:50])


def test_the_worst_pair_stays_below_eight_megabytes() -> None:
    noise = png(np.random.default_rng(2).integers(0, 256, (1000, 1000, 3), np.uint8))
    names = ("left_original", "right_original", "left_corrected", "right_corrected", "disparity_view", "confidence")
    files = {f"{name}.png": noise for name in names}
    files["validity.png"] = png(np.random.default_rng(3).choice([0, 1, 2, 4, 8], (1000, 1000)).astype(np.uint16))
    files |= {"layers.npz": layers(1000, 1000), "ortho.png": noise}
    assert len(as_html(record(), files).encode()) < 8_000_000


def test_no_picture_is_larger_than_its_share() -> None:
    noise = np.random.default_rng(2).integers(0, 256, (1000, 1000, 3), np.uint8)
    assert all(len(picture(noise, photo=photo).uri) < 1.34 * MAX_BYTES + 50 for photo in (True, False))


def test_the_view_in_three_dimensions_is_inside_and_its_script_is_allowed() -> None:
    text = as_html(record(EVIL), pair_images())
    start = text.index('id="page-3d">') + len('id="page-3d">')
    page = json.loads(text[start : text.index("</script>", start)])
    assert page == viewer_page(parse_layers("x", layers()), np.full((6, 9, 3), 90, np.uint8), EVIL, 200_000)
    script = page[page.rindex("<script>") + 8 : page.rindex("</script>")]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in Page(text).of("meta", "content")[1]


def test_maps_have_scales_in_units_and_classes_in_words() -> None:
    made = terrain(pair_images(), "x")
    assert made is not None
    by_title = {item.title: item for item in made.maps}
    assert list(by_title) == ["Relief", "Height", "Slope", "Traversability", "Coverage", "Seen from above"]
    assert (by_title["Slope"].low, by_title["Slope"].high) == ("0 deg", "40 deg")
    assert ("#2c2e34", "unknown") in by_title["Height"].classes
    assert next(words for _, words in by_title["Coverage"].classes) == "measured (98.1 %)"
    assert (by_title["Relief"].shown.width, by_title["Relief"].shown.height) == (6, 9)
    assert made.centre == pytest.approx((-3.0 + 6, 10.0 + 9))  # the rover stands behind the map: below the picture


def test_layers_and_a_picture_from_above_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match=r"ortho\.png is"):
        terrain({**pair_images(), "ortho.png": png(np.zeros((4, 4, 3), np.uint8))}, "x")
    with pytest.raises(ValueError, match=r"layers\.npz holds no layers"):
        terrain({"layers.npz": b"no"}, "x")


def test_pixels_come_back_as_rgb_and_sixteen_bits_fit_the_histogram() -> None:
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 200
    assert np.array_equal(decode("x", png(red[..., ::-1])), red)
    deep = np.full((16, 16), 200 * 257, np.uint16)
    (curve,) = histograms(deep, deep)
    assert (curve.channel, curve.left_mean_dn) == ("gray", 200.0)
    with pytest.raises(ValueError, match="x is not an image"):
        decode("x", b"no")


def test_shares_of_validity_count_every_flag_of_a_pixel() -> None:
    valid, reasons = validity_shares(decode("v", pair_images()["validity.png"]))
    assert valid.percent == 50.0
    assert [(share.flag, share.count) for share in reasons] == [("OUTSIDE", 2400), ("SATURATED", 1200)]


def test_equal_images_have_equal_histograms_on_one_scale() -> None:
    made = pair_pictures(pair_images())
    assert all(curve.left == curve.right for curve in made.after)
    assert all(curve.left != curve.right for curve in made.before)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Return the folder of a saved result whose right image was changed."""
    left = np.random.default_rng(3).integers(0, 256, (40, 50), np.uint8)
    disparity = Disparity(np.full((40, 50), 7.0, np.float32), np.zeros((40, 50), np.uint16))
    result = Result(record(), Views(left, left), disparity, original=Views(left, left // 3))
    result.save(tmp_path / "run")
    return tmp_path / "run"


def test_a_saved_run_renders_again_to_the_same_bytes(saved: Path) -> None:
    assert (saved / "right_original.png").exists()
    assert not (saved / "left_original.png").exists()
    before = {path.name: path.read_bytes() for path in saved.iterdir()}
    (saved / "report.html").unlink()
    render_again(saved)
    assert {path.name: path.read_bytes() for path in saved.iterdir()} == before


def test_without_html_the_page_can_be_made_later(tmp_path: Path) -> None:
    views = Views(np.full((20, 30), 9, np.uint8), np.full((20, 30), 9, np.uint8))
    spent = Result(record(), views).save(tmp_path / "run", html=False)
    assert "report.html" not in spent
    assert not (tmp_path / "run" / "report.html").exists()
    assert render_again(tmp_path / "run")[0].exists()


def test_a_link_that_leads_out_of_the_folder_is_refused(saved: Path, tmp_path: Path) -> None:
    outside = tmp_path / "secret.png"
    (saved / "left_corrected.png").rename(outside)
    (saved / "left_corrected.png").symlink_to(outside)
    with pytest.raises(FormatError, match="leads out of the folder"):
        render_again(saved)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("decision.json", b"{}", "there is no decision_id"),
        ("decision.json", b"\xff", "decision.json"),
        ("validity.png", b"no", "validity.png is not an image"),
    ],
)
def test_a_damaged_run_is_refused_and_its_report_stays(saved: Path, name: str, content: bytes, words: str) -> None:
    before = (saved / "report.html").read_bytes()
    (saved / name).write_bytes(content)
    with pytest.raises(FormatError, match=re.escape(words)):
        render_again(saved)
    assert (saved / "report.html").read_bytes() == before


def test_the_command_writes_both_files_and_refuses_another_folder(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (saved / "report.html").read_bytes()
    (saved / "report.html").unlink()
    monkeypatch.setattr(sys, "argv", ["terrex", "report", str(saved)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert (saved / "report.html").read_bytes() == before
    monkeypatch.setattr(sys, "argv", ["terrex", "report", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "holds no decision.json" in capsys.readouterr().err


def test_every_operator_not_chosen_is_answered_in_place(tmp_path: Path) -> None:
    image = np.random.default_rng(4).integers(0, 255, (60, 80), dtype=np.uint8)
    decision = ExpertSystem().decide(StereoPair(image, image))
    page = as_html(decision, {})
    chosen = {step.operator for step in decision.steps()}
    for name in set(operators()) - chosen:
        assert f"Why not <code>{name}</code>?" in page
    assert not any(f"Why not <code>{name}</code>?" in page for name in chosen)


def test_the_disparity_tells_what_its_colours_stand_for(tmp_path: Path) -> None:
    disparity = np.tile(np.linspace(10.0, 50.0, 101, dtype=np.float32), (4, 1))
    write_pfm(tmp_path / "disparity.pfm", disparity)
    files = {**pair_images(), "disparity.pfm": (tmp_path / "disparity.pfm").read_bytes()}
    low, high = view_range_px(disparity)
    assert (low, high) == pytest.approx((10.4, 49.6))
    page = as_html(record(), files)
    assert "<span>10.4 px</span><span>49.6 px</span>" in page
    rig = FactRecord(template="rig", fields={"focal_px": 496.0, "baseline_m": 0.1, "doffs_px": 0.0})
    assert "<span>10.4 px, 4.77 m</span><span>49.6 px, 1 m</span>" in as_html(record(facts=(rig,)), files)
    rig = FactRecord(template="rig", fields={"focal_px": 496.0, "baseline_m": 0.1, "doffs_px": -20.0})
    assert "<span>10.4 px, infinitely far</span>" in as_html(record(facts=(rig,)), files)
    with pytest.raises(ValueError, match=r"disparity\.pfm does not begin like a gray PFM"):
        as_html(record(), {**files, "disparity.pfm": b"broken"})


def test_the_result_stands_beside_the_verdict() -> None:
    page = as_html(record(), pair_images())
    top = page[page.index('<section id="verdict"') : page.index("</section>")]
    assert re.findall(r'<a href="#(\w+)"><img src="data:', top) == ["disparity", "terrain"]
    assert 'class="results"' not in as_html(record(), {})


def test_an_outline_tells_who_chose_what_and_who_fired_on_a_screen() -> None:
    decision = ExpertSystem(engine="compiled").decide(shifted_pair())
    lines = as_outline(decision).splitlines()
    assert len(lines) <= 50
    assert max(len(line) for line in lines[5:]) <= 120
    for step in decision.steps():
        (place,) = [number for number, line in enumerate(lines) if f".{step.slot}: {step.operator}" in line]
        assert lines[place].endswith(", the default") == (step.chosen_by is None)
        assert step.chosen_by is None or lines[place + 1].startswith(f"      because {step.chosen_by} ")
    fired = " ".join(lines[lines.index("Rules that fired") :])
    assert all(f"{firing.rule} {firing.name}" in fired for firing in decision.firings)
    assert all(finding.sentence in "\n".join(lines) for finding in decision.findings)
