"""Puts a MultibodyPlant into the station: a base with mass among walls that have contact, beside it in Meshcat.

python examples/multibody_plant.py [--meshcat]
"""

import argparse

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Box, Cylinder, MeshcatVisualizer, StartMeshcat
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, ContactResults, CoulombFriction
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder, LeafSystem

import tfg_drake
from tfg_drake.diagrams.scenario import MakeWorld
from tfg_drake.messages import Hazards
from tfg_drake.simulation.differential_drive import clearance
from tfg_drake.systems.ports import declare_message_output

MASS, HEIGHT, WALL_HEIGHT = 6.0, 0.3, 0.5  # kg, m, m
DAMPING = 200.0  # N s/m and N m s/rad of the motors' velocity loops


class Wheels(LeafSystem):
    """Between the station's ports and those of the plant, whose state is x, y, theta of X_WB and their rates."""

    def __init__(self, walls, radius):
        super().__init__()
        self._walls, self._radius = walls, radius
        self._command = self.DeclareVectorInputPort("velocity_commanded", 2)
        self._state = self.DeclareVectorInputPort("state", 6)
        self._contact = self.DeclareAbstractInputPort("contact_results", Value(ContactResults()))
        # Bearing bits of what is touched, how often a touch began, and the least clearance so far, m.
        self._felt = self.DeclareDiscreteState([0.0, 0.0, np.inf])
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / 32.0, 0.0, self._Feel)
        inputs = {self._command.ticket(), self._state.ticket()}
        self.DeclareVectorOutputPort("desired_state", 6, self._CalcDesired, inputs)
        self.DeclareVectorOutputPort("pose", 5, self._CalcPose, {self._state.ticket()})
        felt = {self.discrete_state_ticket(self._felt), self.time_ticket()}
        declare_message_output(self, "hazards", self._Hazards, felt)
        self.DeclareVectorOutputPort("contacts", 1, lambda x, out: out.SetAtIndex(0, self._Felt(x)[1]), felt)
        self.DeclareVectorOutputPort("clearance", 1, lambda x, out: out.SetAtIndex(0, self._Felt(x)[2]), felt)

    def _Felt(self, context):
        return context.get_discrete_state(self._felt).value()

    def _CalcDesired(self, context, output):
        (v, w), theta = self._command.Eval(context), self._state.Eval(context)[2]
        output.SetFromVector([0.0, 0.0, 0.0, v * np.cos(theta), v * np.sin(theta), w])

    def _CalcPose(self, context, output):
        x, y, theta, vx, vy, w = self._state.Eval(context)
        output.SetFromVector([x, y, theta, vx * np.cos(theta) + vy * np.sin(theta), w])

    def _Feel(self, context, update):
        x, y, theta = self._state.Eval(context)[:3]
        results, before = self._contact.Eval(context), self._Felt(context)
        bits = 0
        for k in range(results.num_point_pair_contacts()):
            dx, dy = results.point_pair_contact_info(k).contact_point()[:2] - [x, y]
            bearing = np.arctan2(dy, dx) - theta
            bits |= 1 if np.sin(bearing) < -0.5 else 4 if np.sin(bearing) > 0.5 else 2
        began = bits != 0 and before[0] == 0.0
        near = clearance(self._walls, x, y, self._radius)
        update.set_value(self._felt, [bits, before[1] + began, min(before[2], near)])

    def _Hazards(self, context):
        return Hazards(context.get_time(), int(self._Felt(context)[0]), cliff=0, wheel_drop=0)


def MakePlant(scenario, meshcat=None):
    """A Diagram with the ports of DifferentialDrivePlant: a cylinder on two prismatic joints and a revolute one."""
    world, robot = MakeWorld(scenario.world), scenario.robot
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0 / 128.0)
    shape, rough = Cylinder(robot.radius, HEIGHT), CoulombFriction(0.3, 0.3)
    X_BG = RigidTransform([0.0, 0.0, HEIGHT / 2.0])
    tiny, z = SpatialInertia.SolidSphereWithMass(1e-3, 0.01), [0.0, 0.0, 1.0]
    along = plant.AddRigidBody("along", tiny)
    across = plant.AddRigidBody("across", tiny)
    base = plant.AddRigidBody("base", SpatialInertia.SolidCylinderWithMass(MASS, robot.radius, HEIGHT, z))
    joints = [
        plant.AddJoint(PrismaticJoint("x", plant.world_frame(), along.body_frame(), [1.0, 0.0, 0.0])),
        plant.AddJoint(PrismaticJoint("y", along.body_frame(), across.body_frame(), [0.0, 1.0, 0.0])),
        plant.AddJoint(RevoluteJoint("theta", across.body_frame(), base.body_frame(), z)),
    ]
    inertia = 0.5 * MASS * robot.radius**2
    limits = [MASS * robot.max_acceleration] * 2 + [inertia * robot.max_turn_acceleration]
    for joint, limit in zip(joints, limits, strict=True):
        motor = plant.AddJointActuator(f"{joint.name()}_motor", joint, effort_limit=limit)
        motor.set_controller_gains(PdControllerGains(p=0.0, d=DAMPING))
    plant.RegisterCollisionGeometry(base, X_BG, shape, "outline", rough)
    plant.RegisterVisualGeometry(base, X_BG, shape, "outline", [0.2, 0.3, 0.5, 1.0])
    for k, (x1, y1, x2, y2) in enumerate(world.walls):
        box = Box(np.hypot(x2 - x1, y2 - y1), 0.02, WALL_HEIGHT)
        turned = RotationMatrix.MakeZRotation(np.arctan2(y2 - y1, x2 - x1))
        X_WG = RigidTransform(turned, [(x1 + x2) / 2.0, (y1 + y2) / 2.0, WALL_HEIGHT / 2.0])
        plant.RegisterCollisionGeometry(plant.world_body(), X_WG, box, f"wall_{k}", rough)
        plant.RegisterVisualGeometry(plant.world_body(), X_WG, box, f"wall_{k}", [0.8, 0.8, 0.8, 0.4])
    for joint, at in zip(joints, world.start, strict=True):
        set_default = joint.set_default_angle if joint.name() == "theta" else joint.set_default_translation
        set_default(at)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
    plant.Finalize()
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)

    wheels = builder.AddNamedSystem("wheels", Wheels(world.walls, robot.radius))
    builder.Connect(plant.get_state_output_port(), wheels.GetInputPort("state"))
    builder.Connect(plant.get_contact_results_output_port(), wheels.GetInputPort("contact_results"))
    builder.Connect(wheels.GetOutputPort("desired_state"), plant.get_desired_state_input_port(base.model_instance()))
    builder.ExportInput(wheels.GetInputPort("velocity_commanded"), "velocity_commanded")
    for name in ("pose", "hazards", "contacts", "clearance"):
        builder.ExportOutput(wheels.GetOutputPort(name), name)
    return builder.Build()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshcat", action="store_true", help="show it in Meshcat")
    meshcat = StartMeshcat() if parser.parse_args().meshcat else None

    def MakePlantHere(scenario):
        return MakePlant(scenario, meshcat)

    mission = tfg_drake.explore("house", plant=MakePlantHere, meshcat=meshcat, until=600.0)
    print(f"{mission}, {mission.look('truth.contacts')[0]:.0f} contacts")


if __name__ == "__main__":
    main()
