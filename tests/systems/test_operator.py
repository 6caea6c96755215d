"""The operator as a system: requests in, what base and mission are told out."""

import numpy as np
from pydrake.systems.analysis import Simulator

from tfg_drake.messages import SaidPose
from tfg_drake.systems.operator import Operator


class Run:
    """An operator whose requests are given by hand."""

    def __init__(self, **arguments):
        self.requests = []
        self.operator = Operator([self.take], **arguments)
        self.simulator = Simulator(self.operator)
        self.context = self.simulator.get_mutable_context()

    def take(self):
        taken, self.requests = self.requests, []
        return taken

    def after(self, *requests):
        self.requests = list(requests)
        self.simulator.AdvanceTo(self.context.get_time() + 0.25)
        return [self.operator.GetOutputPort(name).Eval(self.context)[0] for name in ("enable", "pause", "stop")]


def test_requests_become_what_base_and_mission_are_told():
    run = Run()
    assert run.after() == [0, 0, 0]
    assert run.after("enable") == [1, 0, 0]
    assert run.after("pause") == [1, 1, 0]
    assert run.after("stop") == [0, 1, 0]
    assert run.after("enable", "pause") == [2, 0, 0]
    assert run.after("end") == [0, 0, 1]


def test_of_a_stop_and_an_enabling_at_once_the_stop_counts():
    run = Run()
    run.after()
    assert run.after("enable") == [1, 0, 0]
    assert run.after("stop", "enable") == run.after("enable", "stop") == [0, 0, 0]
    assert run.after("enable") == [2, 0, 0]


def test_a_recall_is_for_the_mission_and_ends_one_that_does_not_know_it():
    run = Run()
    run.after()
    assert run.after("enable", "recall") == [1, 0, 0]
    assert run.operator.GetOutputPort("recall").Eval(run.context)[0] == 1
    run = Run(recalls=False)
    run.after()
    run.after("enable")
    assert run.after("recall") == [0, 0, 1]


def test_places_and_pushes_hold_from_the_next_instant_on():
    run = Run(enabled=True)
    run.after()
    assert run.after((1.0, 2.0), "push", (3.0, 4.0), "pause", "push") == [1, 1, 0]
    goal = run.operator.GetOutputPort("requested_goal").Eval(run.context)
    assert (goal.count, goal.p_MG.tolist()) == (2, [3.0, 4.0])
    # However often it was asked for at once, it is one push; 0.25 s + 1/16 s, the next instant after the request.
    (push,) = run.operator.GetOutputPort("pushes").Eval(run.context).pushes
    assert push.time == 0.3125


def test_of_what_is_said_at_once_the_last_holds_from_the_next_instant_on():
    run = Run(enabled=True)
    run.after()
    said = run.operator.GetOutputPort("said_pose")
    assert said.Eval(run.context).stamp == -np.inf
    assert run.after(SaidPose(X_WB=np.zeros(3)), SaidPose(9.0, X_WB=np.array([1.0, 2.0, 3.0])), "pause") == [1, 1, 0]
    one = said.Eval(run.context)
    assert (one.stamp, one.count, one.X_WB.tolist(), one.sigma.tolist()) == (0.3125, 2, [1.0, 2.0, 3.0], [0.5, 0.3])


def test_what_was_asked_for_before_the_mission_began_does_not_count():
    assert Run().after("enable", "pause") == [0, 0, 0]
    assert Run().after("end") == [0, 0, 1]
