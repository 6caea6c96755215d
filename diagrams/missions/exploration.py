"""A mission from Python, with each Drake object at hand: `tfg_drake.explore`."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, LeafSystem
from threadpoolctl import threadpool_limits

from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.diagrams.methods import METHODS, FindMethod, Method
from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.diagrams.robots import SIMULATED, Robot
from tfg_drake.diagrams.scenario import ApplySettings, LoadScenario, Scenario
from tfg_drake.messages import FloatArray, MapEstimate, MissionStatus, TfgMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pydrake.geometry import Meshcat


def explore(
    scenario: str | Path | Scenario = "paper",
    *,
    seed: int | None = None,
    settings: Sequence[str] = (),
    method: str = "tfg",
    goal_selector: LeafSystem | None = None,
    station: Callable[[Scenario], Diagram] | None = None,
    meshcat: Meshcat | None = None,
    until: float = 3600.0,
) -> Exploration:
    """Build a simulated mission and drive it.

    Args:
        scenario: a shipped scenario's name, a YAML file, or one in memory.
        seed: of every random number; None for the scenario's own.
        settings: such as "explorer.stop_gain=10".
        method: what explores, as `tfg-drake explore --method`.
        goal_selector: of the method tfg, in place of its own; see MakeTfgExplorer.
        station: makes the station for the scenario, in place of MakeTurtlebotStation; a Diagram with its ports.
        meshcat: where the mission is shown as it goes on; `pydrake.all.StartMeshcat()` makes one.
        until: simulated s to drive, or less where the mission ends before; 0 to build it only.

    Raises:
        ScenarioError, MethodError: the scenario or the method cannot be used.
        ValueError: until is negative.
    """
    loaded = scenario if isinstance(scenario, Scenario) else LoadScenario(scenario)
    name = "mission" if isinstance(scenario, Scenario) else Path(scenario).stem
    loaded = ApplySettings(loaded, settings)
    if seed is not None:
        loaded.seed = seed
    explorer = FindMethod(method)
    explorer.Check(loaded)
    if goal_selector is not None:
        explorer = Method("own", "a goal selector of one's own", lambda one: MakeTfgExplorer(one, goal_selector))
    robot = SIMULATED if station is None else Robot("own", station, world_known=True)
    exploration = Exploration(loaded, explorer, robot, name, meshcat)
    exploration.advance(until)
    return exploration


class Exploration:
    """A mission under way or ended. In a notebook it shows itself, as `figure` draws it.

    scenario: all that defines it. Its Drake objects: simulator, diagram, station, explorer, and context, the diagram's
    root Context.
    """

    def __init__(
        self,
        scenario: Scenario,
        method: Method = METHODS["tfg"],
        robot: Robot = SIMULATED,
        name: str = "mission",
        meshcat: Meshcat | None = None,
    ) -> None:
        """See `explore`."""
        self.scenario, self._name = scenario, name
        self._mission = Mission(scenario, method, meshcat, f"{name}, seed {scenario.seed}", robot)
        self._mission.begin()

    @property
    def simulator(self) -> Simulator:
        """What advances the context; `advance` also notes what happens meanwhile."""
        return self._mission.simulator

    @property
    def diagram(self) -> Diagram:
        """The whole: station, explorer, logs and picture."""
        return self.simulator.get_system()

    @property
    def station(self) -> Diagram:
        """The simulated robot."""
        return self.diagram.GetSubsystemByName("station")

    @property
    def explorer(self) -> Diagram:
        """What explores."""
        return self._mission.explorer

    @property
    def context(self) -> Context:
        """The diagram's, with all state; a system's own is `system.GetMyContextFromRoot(context)`."""
        return self.simulator.get_mutable_context()

    @property
    def time(self) -> float:
        """Simulated s so far."""
        return self._mission.time

    @property
    def outcome(self) -> str:
        """How the mission ended, "" while it has not."""
        return self.status.outcome

    @property
    def status(self) -> MissionStatus:
        """Where the mission stands."""
        return self._mission.status

    @property
    def stages(self) -> list[dict[str, Any]]:
        """A row a stage, as in a run's stages.jsonl."""
        return self._mission.stages

    @property
    def map(self) -> MapEstimate | None:
        """The landmarks and views in the map frame M; None before the first view, and of a grid."""
        return self._mission.map

    @property
    def tfg(self) -> TfgMap | None:
        """The surfaces, free space and frontiers in M."""
        return self._mission.tfg

    @property
    def X_WM(self) -> FloatArray:
        """(3,) pose of the map frame in the world, m and rad."""
        return self._mission.X_WM

    @property
    def X_WB(self) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,), s, and poses (n, 3), m and rad, as they were estimated at the time."""
        return self._mission.estimated_poses()

    @property
    def X_WB_true(self) -> tuple[FloatArray, FloatArray]:
        """The same, the truth."""
        return self._mission.true_poses() or (np.zeros(0), np.zeros((0, 3)))

    def advance(self, seconds: float = math.inf) -> Exploration:
        """Simulate so many s more, or to the mission's end. Returns itself. Raises ValueError for less than 0."""
        if not seconds >= 0.0:
            raise ValueError(f"{seconds:g} s: must be 0 or more; time does not run backwards")
        # Small dense operations are many times slower when BLAS spreads them over a busy machine's cores.
        with threadpool_limits(limits=1):
            self._mission.advance(self.time + seconds)
        return self

    def look(self, port: str) -> Any:
        """What a port of the explorer or, of names such as "truth.pose", of the station carries now: a message, or a
        vector (n,). Raises KeyError where neither has such a port."""
        for system in (self.explorer, self.station):
            if system.HasOutputPort(port):
                return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.context))
        systems = (self.explorer, self.station)
        names = [one.get_output_port(i).get_name() for one in systems for i in range(one.num_output_ports())]
        raise KeyError(f"no port {port}; there are {', '.join(names)}")

    def figure(self) -> Figure:
        """The building, the map so far and the way, as a matplotlib Figure; `savefig` writes it."""
        from tfg_drake.pictures.figure import run_figure

        mission = self._mission
        world = mission.world_then
        return run_figure(
            f"{self._name}, seed {self.scenario.seed}: {self.outcome or self.status.phase} after {self.time:.0f} s",
            world,
            mission.map,
            mission.tfg,
            mission.grid,
            self.X_WB[1],
            self.X_WB_true[1],
            # What could have been reached is a run's summary's to say.
            np.zeros(0 if world is None else len(world.tag_ids), dtype=np.bool_),
            self.X_WM,
        )

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.figure().savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()

    def __repr__(self) -> str:
        landmarks = len(self.map.ids) if self.map is not None else 0
        return (
            f"<{self._name}, seed {self.scenario.seed}: {self.outcome or self.status.phase} after {self.time:.0f} s,"
            f" {len(self.stages)} stages, {landmarks} landmarks>"
        )
