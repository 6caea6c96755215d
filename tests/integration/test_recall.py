"""A mission whose robot is called back: it goes home where it is to end there, and ends where it stands otherwise."""

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator

from tfg_drake.diagrams.mission_diagram import MakeMissionDiagram
from tfg_drake.diagrams.scenario import ApplySettings, LoadScenario, MakeWorld
from tfg_drake.planning.budget import THERE

# The robot is called back where it has come so far from the place where it began, m.
FAR = 2.0


@pytest.mark.parametrize("return_home", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_robot_that_is_called_back(return_home):
    scenario = ApplySettings(LoadScenario("house"), [f"explorer.return_home={return_home}"])
    world = MakeWorld(scenario.world)
    diagram, *_ = MakeMissionDiagram(scenario, world)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.SetRandomContext(context, RandomGenerator(scenario.seed))
    explorer, station = diagram.GetSubsystemByName("explorer"), diagram.GetSubsystemByName("station")
    truth = station.GetOutputPort("truth.pose")

    def from_home():
        return float(np.hypot(*(truth.Eval(station.GetMyContextFromRoot(context))[:2] - world.start[:2])))

    while from_home() < FAR:
        assert context.get_time() < 90.0
        simulator.AdvanceTo(context.get_time() + 1.0)
    recalled = context.get_time()
    explorer.GetInputPort("recall").FixValue(explorer.GetMyMutableContextFromRoot(context), [1.0])
    simulator.AdvanceTo(recalled + 60.0)
    status = explorer.GetOutputPort("mission").Eval(explorer.GetMyContextFromRoot(context))
    assert (status.phase, status.outcome) == ("done", "budget")
    assert status.reason.startswith("The robot was called back before all was explored.")
    assert (from_home() < 2.0 * THERE) == return_home
    # It chooses every two seconds on its way; a stage may take it a moment longer.
    assert return_home or status.since < recalled + 10.0
