import pytest

from tfg_drake.diagrams.missions import paper_figures as figures
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


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(call, tmp_path):
    (tmp_path / "file").write_text("")
    complaint = f"tfg-drake: --out {tmp_path / 'file'}: is a file; name a folder\n"
    assert call("figures", "--out", tmp_path / "file") == (2, "", complaint)
