"""The table of results, the closed gap, cross-validation and comparison, on numbers worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from expert.evaluate.compare import compare
from expert.evaluate.page import Mark, as_html, labelled, pareto_front
from expert.evaluate.store import Row
from expert.evaluate.summary import as_text, regrets, summarise
from expert.evaluate.table import Table, closed_gap, cross_validated, resample


def row(case: str, system: str, bad_1: float, *, kind: str = "fixed", cpu_s: float = 0.1, scene: str = "") -> Row:
    pair, variant = case.split("|")
    return Row(
        case, pair, scene or pair, variant, False, system, kind, "d", bad_1, bad_1, bad_1, 5.0, 90.0, 0.5, cpu_s, cpu_s
    )  # fmt: skip


def small_table() -> Table:
    losses = {"a": (10.0, 30.0), "b": (30.0, 10.0), "terrex": (12.0, 11.0)}
    rows = [
        row(
            case,
            system,
            values[i],
            kind="terrex" if system == "terrex" else "fixed",
            cpu_s=0.1 if system == "a" else 0.2,
        )
        for system, values in losses.items()
        for i, case in enumerate(("one|clean", "two|noise"))
    ]
    return Table.of(rows, list(losses))


def test_the_closed_gap_is_one_for_the_oracle_and_zero_for_the_single_best() -> None:
    fixed = np.array([[10.0, 30.0], [30.0, 12.0]])
    assert closed_gap(fixed, fixed.min(axis=1)) == 1.0
    assert closed_gap(fixed, fixed[:, 0]) == 0.0
    assert closed_gap(fixed, np.array([40.0, 40.0])) == pytest.approx((20.0 - 40.0) / (20.0 - 11.0))


def test_there_is_no_gap_when_one_configuration_is_always_best() -> None:
    assert closed_gap(np.array([[1.0, 2.0], [1.0, 2.0]]), np.array([1.0, 1.0])) is None


def test_the_gap_of_a_table_names_the_single_best_and_stays_within_its_interval() -> None:
    gap = small_table().gap("terrex")
    assert (gap.single_best, gap.single_best_loss, gap.virtual_best_loss, gap.loss) == ("a", 20.0, 10.0, 11.5)
    assert gap.closed == pytest.approx(0.85)


def test_a_case_that_one_system_lacks_is_left_out() -> None:
    rows = [row("one|clean", "a", 1.0), row("one|clean", "b", 2.0), row("two|clean", "a", 1.0)]
    assert len(Table.of(rows, ["a", "b"])) == 1


def test_cross_validation_chooses_without_the_scene_it_is_applied_to() -> None:
    # Each scene alone prefers the system that the other scenes dislike, so the held-out loss is the worst one.
    losses = np.array([[0.0, 10.0], [10.0, 0.0]])
    assert cross_validated(losses, np.array(["s", "t"])) == 10.0
    agreeing = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert cross_validated(agreeing, np.array(["s", "t"])) == 2.0


def test_scenes_are_drawn_whole() -> None:
    scenes = np.array(["s", "s", "t"])
    for index in resample(scenes, 50, seed=1):
        assert (np.count_nonzero(index == 0)) == np.count_nonzero(index == 1)


def test_a_regret_is_a_case_that_a_fixed_configuration_wins() -> None:
    found = regrets(small_table(), ["terrex"])
    assert [(item.case, item.best, item.best_loss) for item in found] == [
        ("one|clean", "a", 10.0),
        ("two|noise", "b", 10.0),
    ]


def test_a_comparison_counts_cases_and_gives_the_mean_difference() -> None:
    found = compare(small_table(), "a", "terrex")
    assert (found.better, found.worse, found.equal) == (1, 1, 0)
    assert found.difference == pytest.approx(-8.5)
    assert found.interval[0] <= found.difference <= found.interval[1]
    assert "terrex is better in 1 cases, worse in 1, equal in 0" in found.text()


def test_equal_systems_do_not_differ() -> None:
    rows = [row("one|clean", name, 3.0) for name in ("a", "b")]
    found = compare(Table.of(rows, ["a", "b"]), "a", "b")
    assert (found.p_value, found.difference, found.largest) == (None, 0.0, ())


def test_the_front_holds_what_nothing_beats_in_error_and_time() -> None:
    lines = summarise(small_table()).systems
    assert [line.name for line in pareto_front(lines)] == ["a", "terrex"]


def test_text_and_page_name_every_system_and_markup_in_names_stays_text() -> None:
    rows = [row("<b>pair</b>|clean", name, 3.0 + i) for i, name in enumerate(("a", "<script>"))]
    summary = summarise(Table.of(rows, ["a", "<script>"]))
    text, page = as_text(summary), as_html(summary)
    assert "<script>" in text
    assert page.count("<script>") == 1  # the page's own
    assert "&lt;script&gt;" in page


def test_an_empty_table_is_refused() -> None:
    with pytest.raises(ValueError, match="no case has been run on all the systems"):
        summarise(Table.of([], ["a"]))


def test_the_test_by_pairs_counts_pairs_and_the_test_by_scenes_counts_scenes() -> None:
    rows = [
        row(f"pair{i}|clean", system, loss + i * (system == "b"), scene=f"scene{i // 3}")
        for system, loss in (("a", 5.0), ("b", 5.5))
        for i in range(6)
    ]
    found = compare(Table.of(rows, ["a", "b"]), "a", "b")
    assert found.p_pairs == pytest.approx(2 / 2**6)  # all six differ in one direction
    assert found.p_value == pytest.approx(2 / 2**2)  # of two scenes
    assert "p = 0.0312 by pairs, 0.5 by scenes (Wilcoxon)" in found.text()


def test_names_in_the_plot_cover_neither_marks_nor_each_other() -> None:
    marks = tuple(Mark(f"terrex {i}, range estimated", "terrex", 840.0 - i, 300.0 + i % 2, "") for i in range(5))
    placed = [mark.label for mark in labelled(marks, {mark.name for mark in marks})]
    assert all(place is not None for place in placed)
    assert len({place[1] for place in placed if place is not None}) == 5  # one line each
    assert all(place[0] + 6 * len(marks[0].name) < 900 for place in placed if place is not None)


def test_rules_are_counted_by_the_cases_in_which_they_fired() -> None:
    rows = [
        replace(row(f"{case}|clean", name, 3.0, kind="terrex"), rules=rules)
        for name in ("fast", "best")
        for case, rules in (("one", ("COR001", "MAT001")), ("two", ("MAT001",)))
    ]
    assert summarise(Table.of(rows, ["fast", "best"])).fired == {
        "MAT001": {"fast": 2, "best": 2},
        "COR001": {"fast": 1, "best": 1},
    }
