"""The typed helper for ports that hold messages."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import LeafSystem

from tfg_drake.messages import Hazards, Odometry
from tfg_drake.systems.ports import MessageInputs, MessageState, declare_message_output


class _Relay(LeafSystem):
    def __init__(self):
        super().__init__()
        self.set_name("relay")
        self.inputs = MessageInputs(self, "odometry")
        self.state = MessageState(self, Odometry(0.0, np.zeros(3), np.zeros(2)))
        declare_message_output(self, "out", lambda c: self.inputs(c, "odometry"), {self.all_input_ports_ticket()})


def test_a_message_passes_through():
    relay = _Relay()
    context = relay.CreateDefaultContext()
    message = Odometry(1.0, np.zeros(3), np.zeros(2))
    relay.get_input_port(0).FixValue(context, AbstractValue.Make(message))
    assert relay.get_output_port(0).Eval(context).stamp == 1.0


def test_the_wrong_message_and_no_message_are_named():
    relay = _Relay()
    context = relay.CreateDefaultContext()
    with pytest.raises(TypeError, match=r"^relay\.odometry must be connected to an output of Odometry\.$"):
        relay.inputs(context, "odometry")
    relay.get_input_port(0).FixValue(context, AbstractValue.Make(Hazards(0.0, 0, 0, 0)))
    with pytest.raises(TypeError, match=r"^relay\.odometry must hold Odometry, not Hazards\.$"):
        relay.inputs(context, "odometry")


def test_a_port_whose_message_is_not_known_is_named():
    with pytest.raises(ValueError, match=r"no message is known as base\.odometry; .* odometry"):
        MessageInputs(LeafSystem(), "base.odometry")


def test_state_survives_a_clone():
    relay = _Relay()
    context = relay.CreateDefaultContext()
    message = Odometry(2.0, np.zeros(3), np.zeros(2))
    relay.state.set(context.get_mutable_state(), message)
    assert relay.state(context.Clone()) is message
    relay.state.set(context.get_mutable_state(), Hazards(0.0, 0, 0, 0))
    with pytest.raises(TypeError, match="abstract state 0 must hold Odometry, not Hazards"):
        relay.state(context)


class _Counter(LeafSystem):
    def __init__(self):
        super().__init__()
        self.hazards = MessageState(self, Hazards(0.0, 0, 0, 0))
        self.hazards.declare_outputs(self, "cliff")
        self.DeclareStateOutputPort("hazards", self.hazards.index)


def test_outputs_follow_the_state():
    system = _Counter()
    context = system.CreateDefaultContext()
    assert system.GetOutputPort("cliff").Eval(context) == 0
    message = Hazards(1.0, 0, 4, 0)
    system.hazards.set(context.get_mutable_state(), message)
    context.SetTime(1.0)
    assert system.GetOutputPort("cliff").Eval(context) == 4
    assert system.GetOutputPort("hazards").Eval(context) is message
