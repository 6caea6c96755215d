"""The paper's tables beside our figures."""

from pathlib import Path

from tfg_drake.comparison.paper_tables import parameter_table, performance_table
from tfg_drake.comparison.runs import Run
from tfg_drake.config import GridConfig, ScanConfig, TagSensorConfig


def run(method, seed, time, variables):
    summary = {
        "outcome": "complete",
        "reason": "",
        "sim_time_s": time,
        "map_variables": variables,
        "position_error_m": {"mean": 0.02},
        "heading_error_rad": {"mean": 0.004},
        "estimator_cpu_s": 5.0,
        "planner_cpu_s": 5.0,
    }
    return Run(method, seed, Path(), summary)


def test_parameters_stand_beside_the_papers():
    table = parameter_table((46.0, 22.0), 274, TagSensorConfig(), ScanConfig(), GridConfig())
    assert "| size of environment | 46 m x 22 m | 46 m x 22 m |" in table
    assert "| field of view | 124° | 124° |" in table
    assert "| particles of GMapping | 100 | 100 |" in table


def test_performance_is_mean_and_deviation_over_the_runs():
    runs = [run("tfg", seed, 100.0 + seed, {"landmarks": 274, "poses": 60}) for seed in range(3)]
    runs += [run("grid-nearest", seed, 80.0, {"cells": 900000}) for seed in range(3)]
    table = performance_table(runs, "paper", 3)
    assert "| running time (s) | 2433 ± 546 | 101 ± 1 | 2293 ± 375 | 80 ± 0 |" in table
    assert "| variables | 274 | 334 ± 0 | 800000 | 900000 ± 0 |" in table
    assert "here over 3 of `paper`\n\n|" in table
    table = performance_table(runs[:4], "paper", 3)
    assert "| running time (s) | 2433 ± 546 | 101 ± 1 | 2293 ± 375 | 80, n = 1 |" in table
    assert "here over 3 of `paper`\n\nPartial: 4 of 6 missions are done.\n\n|" in table


def test_a_method_without_runs_has_a_dash():
    assert "| running time (s) | 2433 ± 546 | - | 2293 ± 375 | - |" in performance_table([], "paper", 4)
