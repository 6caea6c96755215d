"""Builds and drives a mission, looks at it half-way, and draws mission.png. In a notebook `house` is its picture."""

from pydrake.systems.analysis import Simulator

import tfg_drake

house = tfg_drake.explore("house", seed=3, until=60.0)  # s
print(house)

# What a port of explorer or station carries now, and how well the tags are known.
print("robot at", house.look("truth.pose")[:2], "goal:", house.look("goal").reason)
deviation = house.map.landmark_covariance.trace(axis1=1, axis2=2) ** 0.5
print(f"{len(house.map.ids)} tags, the least known to {deviation.max():.3f} m")

# Drake's objects: the diagram drawn by Graphviz, and the Context, whose clone another Simulator drives on.
print(
    len(house.diagram.GetGraphvizString()), "characters for dot;", house.explorer.num_output_ports(), "ports to look at"
)
clone = house.context.Clone()

house.advance(540.0)  # or to the end
print(house, "while the clone stands at", clone.get_time(), "s")
Simulator(house.diagram, clone).AdvanceTo(clone.get_time() + 5.0)
map_of_clone = house.explorer.GetOutputPort("map").Eval(house.explorer.GetMyContextFromRoot(clone))
print(len(map_of_clone.ids), "tags are in the map of the clone at", clone.get_time(), "s")
house.figure().savefig("mission.png")
