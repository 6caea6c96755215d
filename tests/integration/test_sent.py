"""A mission whose robot somebody sends to a place: it goes there, explores on, and a replay is equal to the bit."""

import numpy as np
import pytest

from benchmarks.timelines import read_timeline
from tfg_drake.cockpit.server import Cockpit
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.recorded_station import ReplayRobot
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.storage.port_recording import read_recording

# m in M, and the instant, in sixteenths of a second, when the robot is sent there.
PLACE, SENT = (3.0, -2.0), 45 * 16


@pytest.mark.slow
def test_the_robot_goes_where_it_is_sent_and_a_replay_is_equal_to_the_bit(tmp_path, monkeypatch):
    asked = iter([()] * SENT + [[PLACE]])
    monkeypatch.setattr(Cockpit, "requests", lambda _: next(asked, ()))
    scenario = LoadScenario("house")
    with Cockpit("", "house", rate=0.0) as cockpit:
        run = run_mission(scenario, out_dir=tmp_path / "run", max_time=80.0, cockpit=cockpit)
    goals = [one for one in read_timeline(run.folder) if one.layer == "goal"]
    sent = [one for one in goals if one.told["reason"] == "Somebody has sent the robot there."]
    # Chosen within two glances, and left when the robot has looked round there.
    assert 45.0 < sent[0].time < 52.0
    assert np.hypot(*(sent[0].arrays["points"][0] - PLACE)) < 0.5
    assert sent[-1].time < goals[-1].time
    recording = read_recording(run.folder)
    again = run_mission(scenario, robot=ReplayRobot(recording), out_dir=tmp_path / "again", max_time=80.0)
    for name in ("stages.jsonl", "map.npz"):
        assert (again.folder / name).read_bytes() == (run.folder / name).read_bytes(), name
