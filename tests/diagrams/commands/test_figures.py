import threading

import pytest

from tfg_drake.diagrams.missions import paper_figures as figures
from tfg_drake.diagrams.missions.sweep import run_of
from tfg_drake.diagrams.scenario import ApplySettings, FindScenario, LoadScenario


@pytest.mark.slow
def test_stages_hold_what_belongs_together_and_end_when_told():
    quick = ["explorer.first_look=2", "explorer.first_turns=1"]
    scenario = ApplySettings(LoadScenario(FindScenario("paper")), quick)
    stages, stamps, p_MB = figures.stages_of(scenario, lambda stage, time: stage == 2)
    assert [stage.goal.stage for stage in stages] == [1, 2]
    for stage in stages:
        assert stage.estimate.stage == stage.tfg.stage == stage.roadmap.stage == stage.goal.stage
    assert p_MB.shape == (len(stamps), 2)
    assert abs(p_MB[0]).max() < 0.01


@pytest.mark.slow
def test_the_command_writes_every_figure_and_names_it(call, tmp_path, monkeypatch):
    stages_of = figures.stages_of
    monkeypatch.setattr(figures, "stages_of", lambda scenario, _: stages_of(scenario, lambda stage, time: stage == 2))
    monkeypatch.setattr(figures, "RUNS", 1)
    monkeypatch.setattr(figures, "LONGEST", 40.0)
    code, said, _ = call("figures", "--out", tmp_path)
    assert code == 0
    names = sorted(path.name for path in tmp_path.iterdir())
    figures_of = ("growth", "information_gain", "priors", "tfg")
    assert names == sorted(
        [name + suffix for name in figures_of for suffix in (".pdf", ".png")]
        + ["felt", "paper.md", "table-2", "tables.md", "unfelt"]
    )
    page = (tmp_path / "paper.md").read_text()
    for file, title, _ in figures.PAGE:
        assert f"![{title}]({file})" in page
        assert (tmp_path / file).is_file()
    tables = (tmp_path / "tables.md").read_text()
    assert "| landmarks | 274 | 274 |" in tables
    assert "| running time (s) | 2433 ± 546 | 40 | 2293 ± 375 | 40 |" in tables
    assert str(tmp_path / "growth.png") in said


def test_what_an_interruption_left_out_is_said(tmp_path, monkeypatch):
    interrupted = threading.Event()

    def sweep(tasks, out, *_):
        """Two missions of the first sweep, then Ctrl-C."""
        done = [] if interrupted.is_set() else [run_of(task, out, {"outcome": "complete"}) for task in tasks[:2]]
        interrupted.set()
        return done

    monkeypatch.setattr(figures, "run_sweep", sweep)
    monkeypatch.setattr(figures, "write_comparison", lambda runs, *_: None)
    monkeypatch.setattr(figures, "performance_table", lambda runs, scenario, seeds: f"{len(runs)} of {seeds}")
    (tmp_path / "tfg.png").write_bytes(b"")
    page, missing = figures.write_tables(tmp_path, interrupted, lambda line: None)
    names = {"table-2": "2 of 8", "felt": "0 of 3", "unfelt": "0 of 3"}
    assert missing == [f"{name}: {share} missions are done" for name, share in names.items()]
    text = page.read_text()
    assert f"**Not whole.** {'; '.join(missing)}. The same command in the same folder goes on.\n" in text
    assert "](tfg.png)" in text
    assert "Missing: table-2/maps.png.\n" in text
    assert "](table-2/maps.png)" not in text


def test_of_an_interrupted_mission_nothing_is_drawn(tmp_path, monkeypatch):
    interrupted = threading.Event()

    def stages_of(_scenario, on_stage):
        interrupted.set()
        return [None] * on_stage(1, 8.0), None, None

    monkeypatch.setattr(figures, "stages_of", stages_of)
    assert figures.write_figures(tmp_path, lambda *_: True, interrupted) == []
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(call, tmp_path):
    (tmp_path / "file").write_text("")
    complaint = f"tfg-drake: --out {tmp_path / 'file'}: is a file; name a folder\n"
    assert call("figures", "--out", tmp_path / "file") == (2, "", complaint)
