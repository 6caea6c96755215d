import csv
import dataclasses
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.comparison.measures import CPU_IDLE, MEASURES, cpu_idle, mapped_share, variables
from tfg_drake.comparison.report import Comparison, Picture, markdown, page, tables, text
from tfg_drake.comparison.runs import Run, flatten, paired, sample, to_csv, values
from tfg_drake.comparison.statistics import spread
from tfg_drake.diagrams.commands.command import EXIT_CODES


def summary(**fields):
    basis = {
        "outcome": "complete",
        "reason": "done",
        "sim_time_s": 100.0,
        "position_error_m": {"mean": 0.1, "max": 0.3},
        "landmark_rmse_m": 0.02,
        "map_variables": {"landmarks": 10, "poses": 4},
        "estimator_cpu_s": 20.0,
        "planner_cpu_s": 5.0,
        "contacts": 1,
    }
    return basis | fields


def run(method, seed, **fields):
    return Run(method, seed, Path(f"{method}-{seed}"), summary(**fields))


FAILED = Run("b", 2, Path("b-2"), None, "killed by SIGKILL")


@pytest.fixture
def comparison():
    runs = [run("a", seed, sim_time_s=100.0 + seed) for seed in range(4)]
    runs += [run("b", 0, landmark_rmse_m=None, sim_time_s=202.0), run("b", 1, outcome="fault", reason="Error <at> 3 s")]
    runs += [FAILED, run("b", 3, landmark_rmse_m=None, sim_time_s=208.0, outcome="stuck", reason="boxed in")]
    return Comparison("a against b", ["a", "b"], runs, 8, "tfg-drake compare --seeds 4", "tfg-drake 1, Python 3.")


def test_pairs_are_seeds_on_which_neither_failed(comparison):
    time = MEASURES[0].read
    first, other = values(comparison.runs, "a", time), values(comparison.runs, "b", time)
    assert list(other) == [0, 3]
    np.testing.assert_array_equal(paired(first, other), [[100.0, 103.0], [202.0, 208.0]])


def test_tables(comparison):
    found = {table.title: table for table in tables(comparison)}
    outcomes = found["Outcomes"]
    assert list(outcomes.header) == ["method", "runs", "complete", "stuck", "fault", "failed", "contacts in all"]
    assert outcomes.rows == [["a", "4", "4", "0", "0", "0", "4"], ["b", "4", "1", "1", "1", "1", "3"]]
    figures = {row[0]: row[1:] for row in found["Figures"].rows}
    assert figures["map error, RMSE of tags (m)"] == ["0.0200 ± 0.0000 (0.0200 to 0.0200)", "-"]
    assert re.fullmatch(r"205 ± 4 \(.*\), n = 2", figures["time (s)"][1])
    assert figures["CPU idle at real time (%)"][0].startswith("75.4 ± ")
    ratios = found["Ratio to a"]
    assert list(ratios.header) == ["", "b (2 pairs)"]
    assert ratios.rows[0][1].startswith("2.02 (2.02 to 2.02)")
    assert found["Difference to a"].rows[0][1].startswith("+104 (")
    assert [row[:3] for row in found["Runs that did not complete"].rows] == [
        ["b", "1", "fault"],
        ["b", "2", "failed"],
        ["b", "3", "stuck"],
    ]
    assert found["Runs that did not complete"].rows[1][3] == "killed by SIGKILL"


def test_a_figure_of_fewer_runs_or_pairs_says_of_how_many():
    cut = {"outcome": "time_limit", "sim_time_s": 36.0, "explored_s": None}
    runs = [run("a", seed, **(cut if seed else {"sim_time_s": 31.0, "explored_s": 31.0})) for seed in range(3)]
    runs += [run("b", seed, explored_s=17.0 + 5.0 * (seed == 1)) for seed in range(3)]
    comparison = Comparison("a against b", ["a", "b"], runs, 6, "", "")
    found = {table.title: table for table in tables(comparison)}
    explored, time = (
        next(one.label for one in MEASURES if one.read(summary(explored_s=9.0, sim_time_s=8.0)) == value)
        for value in (9.0, 8.0)
    )
    cells = {title: {row[0]: row[1:] for row in found[title].rows} for title in found if title != "Outcomes"}
    assert cells["Figures"][explored][0] == "31, n = 1"
    assert "n =" not in cells["Figures"][explored][1] + cells["Figures"][time][0]
    assert list(found["Difference to a"].header) == ["", "b (3 pairs)"]
    assert cells["Difference to a"][explored] == ["-14, 1 pair"]
    assert cells["Ratio to a"][explored] == ["0.548, 1 pair"]
    assert "pair" not in cells["Difference to a"][time][0]
    assert "<td>31, n = 1</td>" in page(comparison, [])
    assert "neither the method nor a failed, whatever ended the mission" in markdown(comparison, [])


def test_every_outcome_of_a_mission_has_a_column():
    runs = [run("a", seed, outcome=outcome) for seed, outcome in enumerate(EXIT_CODES)]
    found = tables(Comparison("a", ["a"], runs, 8, "tfg-drake compare", "tfg-drake 1, Python 3."))
    assert set(EXIT_CODES) < set(found[0].header)


def test_what_the_time_limit_ended_is_said_to_have_taken_it(comparison):
    limit = "What the time limit ended counts as it was then, with the limit as its time."
    assert limit not in markdown(comparison, [])
    cut = run("b", 2, outcome="time_limit", sim_time_s=90.0)
    assert limit in markdown(dataclasses.replace(comparison, runs=[*comparison.runs[:6], cut]), [])


def test_the_page_needs_nothing_else(comparison):
    written = page(comparison, [Picture("errors", "Error against time.", b"\x89PNG")])
    assert not re.search(r"https?:|file:|//", written.replace("image/png", ""))
    assert re.findall(r'(?:src|href)="([^"]{15})', written) == ["data:image/png;"]
    assert "Error &lt;at&gt; 3 s" in written
    assert "tfg-drake compare --seeds 4" in written


def test_markdown_names_figures_and_command(comparison):
    written = markdown(comparison, [Picture("errors", "Error against time.", b"")])
    assert "![Error against time.](errors.png)" in written
    assert "    tfg-drake compare --seeds 4\n" in written
    assert "| b | 2 | failed | killed by SIGKILL |" in written


def test_it_is_said_who_sees_tags(comparison):
    runs = [
        run("a", 0, landmarks_mapped=9),
        run("b", 0, landmarks_mapped=None),
        FAILED,
        run("c", 0, landmarks_mapped=9),
    ]
    said = markdown(dataclasses.replace(comparison, methods=["a", "b", "c"], runs=runs), [])
    assert "\n\nThe world's tags are seen by a, c, not by b: --tag-spacing none is fairer.\n\n" in said
    assert "world's tags" not in markdown(comparison, [])
    said = markdown(dataclasses.replace(comparison, methods=["a", "b", "c"], runs=runs, need_tags=["c"]), [])
    assert "--tag-spacing none is fairer, but not for c, which maps tags alone.\n\n" in said


def test_it_is_said_from_where_the_area_counts(comparison):
    areas = {"a": 3, "b": None, "c": 0}
    runs = [run(name, 0, area_coverage=0.9, walls_mapped=walls) for name, walls in areas.items()]
    said = markdown(dataclasses.replace(comparison, methods=["a", "b", "c"], runs=runs), [])
    assert "\n\nThe area seen is that from turns and glances by a, c, on the whole way by b: compare" in said
    alone = markdown(dataclasses.replace(comparison, methods=["a", "c"], runs=[runs[0], runs[2]]), [])
    assert "on the whole way by" not in alone
    assert "on the whole way by" not in markdown(comparison, [])


def test_a_partial_report_has_figures_of_the_seeds_that_all_methods_have():
    runs = [run("a", 0, sim_time_s=100.0), run("b", 0, sim_time_s=90.0), run("a", 1, sim_time_s=300.0)]
    partial = Comparison("a against b", ["a", "b"], runs, 4, "", "")
    figures = next(table for table in tables(partial) if table.title == "Figures")
    assert figures.rows[0][1:] == ["100", "90"]
    said = markdown(partial, [])
    assert "a, b; 1 seed each" in said
    assert "3 of 4 runs are done. Its figures are of the seeds that all methods with a run have." in said


def test_a_partial_report_says_so(comparison):
    partial = Comparison(comparison.title, comparison.methods, [], 8, "", "")
    assert "This report is partial: 0 of 8 runs are done." in markdown(partial, [])


def test_the_table_of_all_runs(comparison):
    rows = list(csv.DictReader(io.StringIO(to_csv(comparison.runs))))
    assert [row["method"] + row["seed"] for row in rows] == ["a0", "a1", "a2", "a3", "b0", "b1", "b2", "b3"]
    assert rows[0]["position_error_m.max"] == "0.3"
    assert (rows[6]["outcome"], rows[6]["reason"], rows[6]["sim_time_s"]) == ("failed", "killed by SIGKILL", "")
    assert rows[4]["landmark_rmse_m"] == ""


def test_measures_of_a_summary():
    assert flatten({"a": {"b": {"c": 1}}, "d": 2}) == {"a.b.c": 1, "d": 2}
    assert variables(summary()) == 14.0
    assert variables(summary(map_variables={"cells": 800})) == 800.0
    assert cpu_idle(summary()) == 75.0
    assert cpu_idle(summary(estimator_cpu_s=200.0)) == 0.0
    assert mapped_share({"landmarks_mapped": None, "landmarks_reachable": 4}) is None
    assert mapped_share({"landmarks_mapped": 3, "landmarks_reachable": 4}) == 75.0
    assert json.dumps([measure.label for measure in MEASURES]).count("(m)") >= 5


def test_one_run_and_none_have_no_interval():
    assert text(spread(np.array([1.25])), CPU_IDLE) == "1.2"
    assert text(spread(np.zeros(0)), CPU_IDLE) == "-"


def test_a_mean_of_shares_below_all_is_not_shown_as_all():
    area = next(measure for measure in MEASURES if measure.name == "area seen")
    runs = [Run("tfg", seed, Path(), summary(area_coverage=share)) for seed, share in enumerate((1.0, 0.99996))]
    shown = text(spread(sample(runs, "tfg", area.read)), area)
    assert shown == "99.99 ± 0.00 (99.99 to 100.00)"
    assert text(spread(np.array([100.0, 100.0])), area) == "100.00 ± 0.00 (100.00 to 100.00)"
