"""`tfg-drake tags`: prints tags, and advises where to hang them."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, flag, option, writing
from tfg_drake.diagrams.screen import Screen

if TYPE_CHECKING:
    from collections.abc import Callable

    from tfg_drake.diagrams.scenario import Scenario
    from tfg_drake.messages import BoolArray, FloatArray
    from tfg_drake.world.tag_advice import Advice

tags_app = command.group("tags", "Print tags, or find the best places for them.")


@tags_app.command("print")
def print_tags(
    ids: Annotated[str, option("LIST", "Ids of the family tag36h11, such as 0-99 or 3,5,10-12.")],
    out: Annotated[Path, option("FILE", "The PDF to write.")],
    size: Annotated[float, option("M", "Side of the black square, m.")] = 0.16,
) -> None:
    """Write tags to a PDF of A4 pages, with cut marks. Print it at 100 %, and check the size with a ruler."""
    with command.installed("camera"):
        from tfg_drake.vision import tag_sheets
    with command.naming("--ids ", tag_sheets.SheetError):
        numbers = tag_sheets.parse_ids(ids)
    with command.naming("--size ", tag_sheets.SheetError), writing(f"--out {out}"):
        pages = tag_sheets.print_tags(numbers, size, out)
    print(
        f"{len(numbers)} tags of {1000.0 * size:g} mm on {pages} pages: {out}; print at 100 %, not fitted to the page"
    )


@tags_app.command()
def advise(
    run: Annotated[
        Path | None, argument("RUN", "The folder of a mission, to whose mapped tags others are added.")
    ] = None,
    world: Annotated[
        Path | None, option("FILE", "The walls: a scenario, a map_server .yaml or a *.vectormap.txt.")
    ] = None,
    start: Annotated[str | None, option("X,Y,YAW", "Start pose of the robot, m and rad.")] = None,
    count: Annotated[int, option("N", "Number of tags to place.")] = 40,
    fresh: Annotated[bool, flag("--fresh", "Ignore the tags of the world file.")] = False,
    out: Annotated[Path, option("FILE", "The world with the tags, for explore --world.")] = Path("advised.yaml"),
) -> None:
    """Find places for tags that make the robot's position most certain, the most useful first."""
    from tfg_drake.io.files import write_atomic

    if (run is None) == (world is None):
        bad_input("tags advise: name either the folder of a mission or --world FILE")
    if run is not None and (start is not None or fresh):
        bad_input(f"{'--start' if start is not None else '--fresh'}: goes with --world; of a mission both are known")
    if count < 1:
        bad_input(f"--count {count}: must be 1 or more")
    with Screen("loading") as show:
        from threadpoolctl import threadpool_limits

        from tfg_drake.diagrams.scenario import MakeWorld, PrepareScenario
        from tfg_drake.planning.parameters import PlanningParameters
        from tfg_drake.world.tag_advice import advise_tags
        from tfg_drake.world.world import WorldError

        if run is not None:
            scenario, floor = _of_run(run)
        else:
            scenario, floor = PrepareScenario("paper", world=world, start=command.parse_start(start)), None
        if fresh:
            scenario.world.tags = []
        if world is not None and out.exists() and world.exists() and out.samefile(world):
            bad_input(f"--out {out}: is the world that is read; name another file")
        mapper = PlanningParameters(scenario.robot, scenario.tags, scenario.odometry, scenario.explorer)
        # Small dense operations are many times slower when BLAS spreads them over the cores of a busy machine.
        with command.naming(f"{run or world}: ", WorldError), threadpool_limits(limits=1):
            on_tag = lambda n: show(f"{n} of {count} tags")  # noqa: E731
            advice = advise_tags(MakeWorld(scenario.world), count, mapper, floor=floor, on_tag=on_tag)
    hanging = {tag.id for tag in scenario.world.tags}
    ids = [i for i in range(len(hanging) + len(advice.facing)) if i not in hanging][: len(advice.facing)]
    with writing(f"--out {out}"):
        write_atomic(out, _world_yaml(scenario, ids, advice))
    mean, worst = advice.deviation.mean(axis=1), advice.deviation.max(axis=1)
    print("  id     x m     y m  faces deg   position known to, m: mean   worst")
    print(f"{len(hanging):>4} tags that hang{'':>31}{mean[0]:>9.3f}{worst[0]:>8.3f}")
    for k, tag in enumerate(ids):
        (x, y), faces = advice.p_WT[k], round(math.degrees(advice.facing[k])) % 360
        print(f"{tag:>4}{x:>8.2f}{y:>8.2f}{faces:>11}{'':>21}{mean[k + 1]:>9.3f}{worst[k + 1]:>8.3f}")
    if len(ids) < count:
        print(f"There is room for {len(ids)} tags")
    print(f"{out}: the world with these tags; tfg-drake explore --world {out}")


def _of_run(folder: Path) -> tuple[Scenario, Callable[[FloatArray], BoolArray]]:
    """Return the scenario of a mission with the mapped world, and a function that tells which points are free space."""
    import numpy as np

    from tfg_drake.diagrams.scenario import LoadScenario, MakeWorldConfig
    from tfg_drake.geometry.star import inside_any
    from tfg_drake.mapfile.in_world import landmarks_in_world, tfg_in_world
    from tfg_drake.mapfile.saved_map import load_map
    from tfg_drake.world.world import World

    scenario, saved = LoadScenario(folder / "scenario.yaml"), load_map(folder / "map.npz")
    tfg, p_WT = tfg_in_world(saved), landmarks_in_world(saved)[0]
    facing = np.arctan2(tfg.facing[:, 1], tfg.facing[:, 0])
    scenario.world = MakeWorldConfig(World(tfg.segments, saved.ids, p_WT, facing, saved.X_WM))
    return scenario, lambda points: inside_any(points, tfg.star_offsets, tfg.star_vertices)


def _world_yaml(scenario: Scenario, ids: list[int], advice: Advice) -> str:
    """Return a scenario file of the world with the advised tags."""
    from tfg_drake.io.yaml_text import dump_yaml

    world = dataclasses.asdict(scenario.world)
    places = zip(ids, advice.p_WT.round(4).tolist(), advice.facing.round(4).tolist(), strict=True)
    world["tags"] += [{"id": i, "position": p_WT, "facing": facing} for i, p_WT, facing in places]
    text = dump_yaml({"world": world}, sort_keys=False, default_flow_style=None)
    return f"# Tags as tfg-drake tags advise says, the last ones new. Metres and radians.\n{text}"
