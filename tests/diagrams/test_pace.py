"""A mission that begins while kernels are still compiled."""

from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.scenario import ApplySettings, LoadScenario


class Compiling:
    """Whoever compiles them has done so when they have been asked often enough."""

    def __init__(self, times):
        self._left = times
        self.left = 0.02

    @property
    def ended(self):
        self._left -= 1
        return self._left < 0

    @property
    def word(self):
        return "compiling" if self._left > 0 else ""


def test_it_says_so_goes_on_as_ever_and_comes_to_the_same(tmp_path):
    scenario = ApplySettings(LoadScenario("house"), ["explorer.first_look=5", "explorer.first_turns=1"])
    said = []
    one = run.run_mission(scenario, max_time=30.0, out_dir=tmp_path / "one")
    two = run.run_mission(
        scenario,
        max_time=30.0,
        out_dir=tmp_path / "two",
        on_progress=lambda progress: said.append((progress.time, progress.word)),
        warm_up=Compiling(40),
    )
    assert one.stages == two.stages
    assert (tmp_path / "one" / "map.npz").read_bytes() == (tmp_path / "two" / "map.npz").read_bytes()
    assert said[0] == (0.125, "compiling")
    words = [word for _, word in said[:-1]]
    assert words == sorted(words, reverse=True)
    assert said[-2] == (30.0, "")
