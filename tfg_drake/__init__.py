"""Active SLAM on topological feature graphs, with Drake.

    import tfg_drake
    house = tfg_drake.explore("house", seed=3, until=300.0)

The public API, whose changes CHANGELOG.md lists:

- this module: `explore` builds and runs a mission and returns an `Exploration`; `load_run` reads the folder of a run,
  `fork` continues a run from one of its stages, `map_graph` returns a map as GTSAM factors and values, `merge` merges
  two maps.
- in `tfg_drake.diagrams`: `scenario` (Scenario, LoadScenario, ApplySettings, ApplyWorldFile, MakeWorld), `station`
  (MakeTurtlebotStation), `explorer` (MakeTfgExplorer), `mapping_explorer` (MakeMappingExplorer), `pose_estimator`
  (MakePoseEstimator), `mission_diagram` (ConnectStation), and the names, types and meanings of their ports.
- in `tfg_drake.systems`: the systems and their ports; `ports` declares and reads message ports.
- `tfg_drake.messages` and `tfg_drake.config`: the messages on the ports, the parameters of a scenario.
- `tfg_drake.storage.run` and `tfg_drake.mapfile.saved_map`: the contents of a run and of a map.

Everything else may change without notice. Only `systems`, `diagrams` and part of `hardware` import Drake.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from tfg_drake.kernels import use_locator

if TYPE_CHECKING:
    from tfg_drake.diagrams.exploration import Exploration, explore, fork
    from tfg_drake.mapfile.merge import merge
    from tfg_drake.slam.gtsam_solver import map_graph
    from tfg_drake.storage.run import load_run
else:
    # Each is imported on first access, so that the package is usable without Drake.
    _WHERE = {
        "Exploration": "tfg_drake.diagrams.exploration",
        "explore": "tfg_drake.diagrams.exploration",
        "fork": "tfg_drake.diagrams.exploration",
        "load_run": "tfg_drake.storage.run",
        "map_graph": "tfg_drake.slam.gtsam_solver",
        "merge": "tfg_drake.mapfile.merge",
    }

    def __getattr__(name):
        if name not in _WHERE:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(importlib.import_module(_WHERE[name]), name)


# Before any module with kernels is imported.
use_locator()

__version__ = "0.2.0"
__all__ = ["Exploration", "__version__", "explore", "fork", "load_run", "map_graph", "merge"]


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()} - {"TYPE_CHECKING", "annotations", "importlib", "use_locator", "_WHERE"})
