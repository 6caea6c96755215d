"""The mission sequencer as a Drake system."""

import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator

from tfg_drake.config import RobotConfig
from tfg_drake.messages import Hazards
from tfg_drake.systems.mission_sequencer import MissionSequencer


@pytest.mark.parametrize(("ends_simulation", "until"), [(True, 0.125), (False, 2.0)])
def test_the_simulation_ends_with_the_mission_unless_it_is_to_go_on(ends_simulation, until):
    sequencer = MissionSequencer(RobotConfig(), ends_simulation=ends_simulation)
    simulator = Simulator(sequencer)
    context = simulator.get_mutable_context()
    sequencer.GetInputPort("hazards").FixValue(context, Value[object](Hazards(0.0, 0, 0, 0)))
    sequencer.GetInputPort("stop").FixValue(context, [1.0])
    simulator.AdvanceTo(2.0)
    assert sequencer.GetOutputPort("mission").Eval(context).phase == "done"
    assert context.get_time() == pytest.approx(until, abs=0.07)
