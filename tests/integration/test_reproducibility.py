"""One seed is one run: in another process, and from a copy of the context."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import InitializeParams, Simulator

from tests.diagrams.rooms import DIVIDED, QUICK_LOOK, lasting, tagged
from tfg_drake.diagrams.mission_diagram import MakeMissionDiagram
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import MakeWorld


def test_two_processes_give_the_same_run(tmp_path):
    room = tmp_path / "room.yaml"
    room.write_text(DIVIDED + QUICK_LOOK)
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", str(room), "--tag-spacing", "1"]
    subprocess.run([*command, "--headless", "--out", str(tmp_path / "one")], check=True, capture_output=True)
    scenario = tagged(DIVIDED + QUICK_LOOK)
    two = run_mission(scenario, name="room", world_name=str(room), out_dir=tmp_path / "two").summary
    one = json.loads((tmp_path / "one" / "summary.json").read_text())
    assert (one["outcome"], one["contacts"]) == ("complete", 0)
    assert one["landmarks_mapped"] == one["landmarks_reachable"]
    assert one["position_error_m"]["mean"] < 0.05
    assert one["landmark_rmse_m"] < 0.06
    assert lasting(one) == lasting(two)
    for name in ("stages.jsonl", "map.npz", "trajectory.tum", "truth.tum", "scenario.yaml"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name


# In the first turn, and later; at no instant of an event, since a new Simulator publishes what is due at its beginning.
COPIED = (6.7, 16.3)


def test_a_copy_of_the_context_goes_on_as_the_original_does():
    scenario = tagged(DIVIDED + QUICK_LOOK)
    diagram, *logs = MakeMissionDiagram(scenario, MakeWorld(scenario.world))
    original = Simulator(diagram)
    diagram.SetRandomContext(original.get_mutable_context(), RandomGenerator(scenario.seed))
    original.Initialize()
    copies = []
    for time in COPIED:
        original.AdvanceTo(time)
        copies.append(Simulator(diagram, original.get_context().Clone()))
    for copy in copies:
        # Initialisation belongs to a mission's beginning: the copy is past it.
        copy.Initialize(InitializeParams(suppress_initialization_events=True))
    for simulator in (original, *copies):  # Each to its end, in turn: they must share nothing.
        simulator.AdvanceTo(200.0)
        assert simulator.get_context().get_time() < 200.0

    explorer = diagram.GetSubsystemByName("explorer")
    assert len(logs) == 3
    for copy in copies:
        ends = [explorer.GetMyContextFromRoot(simulator.get_context()) for simulator in (original, copy)]
        one, two = (explorer.GetOutputPort("mission").Eval(end) for end in ends)
        assert one.outcome == "complete"
        assert dataclasses.asdict(one) == dataclasses.asdict(two)
        one, two = (explorer.GetOutputPort("map").Eval(end) for end in ends)
        np.testing.assert_array_equal(one.p_ML, two.p_ML)
        np.testing.assert_array_equal(one.covariance, two.covariance)
        for log in logs:
            one, two = (log.FindLog(simulator.get_context()) for simulator in (original, copy))
            np.testing.assert_array_equal(one.sample_times(), two.sample_times())
            np.testing.assert_array_equal(one.data(), two.data())
