"""A mission brought back to one of its stages."""

import json

import numpy as np
import pytest

import tfg_drake
from tests.diagrams.rooms import room
from tfg_drake.diagrams.exploration import fork
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.missions.fork import Fork, ForkError, check_same
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.messages import GoalChoice, MapEstimate, MissionStatus


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return run.run_mission(room(), name="room", out_dir=tmp_path_factory.mktemp("original"))


def look(simulator, port, kind):
    explorer = simulator.get_system().GetSubsystemByName("explorer")
    value = explorer.GetOutputPort(port).Eval(explorer.GetMyContextFromRoot(simulator.get_context()))
    assert isinstance(value, kind)
    return value


def finish(simulator):
    while look(simulator, "mission", MissionStatus).phase != "done" and simulator.get_context().get_time() < 600.0:
        simulator.AdvanceTo(simulator.get_context().get_time() + 1.0)


@pytest.mark.parametrize("stage", [pytest.param(1, marks=pytest.mark.slow), 4])
def test_a_fork_that_changes_nothing_ends_as_the_run_did(original, stage):
    simulator = tfg_drake.fork(original.folder, stage)
    assert look(simulator, "goal", GoalChoice).stage == stage
    finish(simulator)
    status = look(simulator, "mission", MissionStatus)
    assert (status.outcome, status.since) == (original.summary["outcome"], original.summary["sim_time_s"])
    # The newest map as the run had it, whose last line of stages.jsonl has its entropy to the bit.
    estimate = look(simulator, "map", MapEstimate)
    last = original.stages[-1]
    assert (estimate.stage, estimate.stamp, estimate.entropy) == (last["stage"], last["time_s"], last["entropy_nats"])


def test_the_context_can_be_cloned_and_driven_on(original):
    simulator = fork(original.folder, 2)
    clone = simulator.get_context().Clone()
    simulator.AdvanceTo(clone.get_time() + 4.0)
    other = type(simulator)(simulator.get_system(), clone)
    other.AdvanceTo(simulator.get_context().get_time())
    one, two = (look(s, "map", MapEstimate).p_ML for s in (simulator, other))
    assert one.tobytes() == two.tobytes()


@pytest.mark.slow
def test_the_robot_drives_to_another_candidate_and_looks_round_there(original):
    change = Fork(2, candidate=3)
    result = run.run_mission(
        LoadScenario(original.folder / "scenario.yaml"),
        out_dir=original.folder.parent / "other",
        monitor=change.monitor,
    )
    check_same(tfg_drake.load_run(original.folder), result.stages, 2)
    assert change.reached
    gains = [one.gain for one in change.candidates]
    assert gains == sorted(gains, reverse=True)
    assert sum(one.chosen for one in change.candidates) <= 1
    at = change.candidates[2].p_WG
    been = [np.hypot(*(np.array(stage["goal"][:2]) - at)) for stage in result.stages[2:]]
    assert min(been) < 0.5
    assert result.summary["outcome"] == "complete"
    assert result.stages != original.stages


def test_a_goal_is_the_place_next_to_it(original):
    simulator = fork(original.folder, 3, goal=(1.0, 3.0))
    choice = look(simulator, "goal", GoalChoice)
    assert choice.reason == "It was asked for at stage 3."
    with pytest.raises(
        ForkError,
        match=r"goal 50,50: no place within 0.5 m that is known to be reachable at stage 3; the nearest is \(",
    ):
        fork(original.folder, 3, goal=(50.0, 50.0))


def test_what_cannot_be_forked_is_told_in_a_line(original, tmp_path):
    last = original.summary["stages"]
    with pytest.raises(ForkError, match=rf"stage 999: .* has the stages 1 to {last}"):
        fork(original.folder, 999)
    with pytest.raises(ForkError, match="candidate 0: stage 2 has 1 to"):
        fork(original.folder, 2, candidate=0)
    for name in ("stages.jsonl", "trajectory.tum", "scenario.yaml"):
        (tmp_path / name).write_bytes((original.folder / name).read_bytes())
    (tmp_path / "summary.json").write_text(json.dumps(original.summary | {"contacts": None}))
    with pytest.raises(ForkError, match="is no simulated run"):
        fork(tmp_path, 1)
    (tmp_path / "summary.json").write_text(json.dumps(original.summary | {"method": "grid-nearest"}))
    with pytest.raises(ForkError, match="its method grid-nearest chooses from no candidates; fork a run of tfg, "):
        fork(tmp_path, 1)
    (tmp_path / "summary.json").write_text(json.dumps(original.summary | {"method": "own"}))
    with pytest.raises(ForkError, match="had parts of your own, which no file holds"):
        fork(tmp_path, 1)
    (tmp_path / "summary.json").write_text(json.dumps(original.summary))
    lines = [json.loads(line) for line in (tmp_path / "stages.jsonl").read_text().splitlines()]
    lines[0]["entropy_nats"] += 1e-9
    (tmp_path / "stages.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(ForkError, match="its stage 1 comes out otherwise now"):
        fork(tmp_path, 2)


@pytest.mark.parametrize("lost", ["contacts", "version"])
def test_a_summary_that_is_no_missions_is_told_in_a_line(original, tmp_path, lost):
    """As that of `tfg-drake slam` is."""
    summary = {name: value for name, value in original.summary.items() if name != lost}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(ForkError) as caught:
        fork(tmp_path, 1)
    assert str(caught.value) == f"{tmp_path / 'summary.json'}: has no {lost}; name the folder of a mission"
