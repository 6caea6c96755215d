"""What the README says is true: its example runs, its scenario loads; links of all documents lead somewhere."""

import re
from pathlib import Path

import pytest

from tfg_drake.diagrams.scenario import LoadScenario

ROOT = Path(__file__).parents[1]


def block(language):
    (code,) = re.findall(rf"```{language}\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    return code


def test_the_example_maps_a_house(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    example = block("python")
    assert len([line for line in example.splitlines() if line]) <= 10
    limit = "until=300.0"
    assert limit in example
    names = {}
    exec(example.replace(limit, "until=40.0"), names)
    assert len(names["house"].map.ids) > 10
    assert names["pose"].shape == (5,)
    assert (tmp_path / "house.png").exists()


def test_the_scenario_loads():
    scenario = LoadScenario(data=block("yaml"))
    assert (scenario.seed, scenario.robot.max_speed, scenario.world.tags[0].id) == (3, 0.3, 7)


def anchors(path):
    """What can be linked to in a document: its headings as a hosted page names them."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


DOCUMENTS = [
    str(path.relative_to(ROOT)) for folder in (".", "docs", "benchmarks") for path in (ROOT / folder).glob("*.md")
]


@pytest.mark.parametrize("name", sorted(DOCUMENTS))
def test_links_lead_somewhere(name):
    links = re.findall(r"\]\(([^)]+)\)", (ROOT / name).read_text())
    for link in links:
        if link.startswith("https://"):
            continue
        file, _, anchor = link.partition("#")
        target = (ROOT / name).parent / file if file else ROOT / name
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_the_documents_with_links_are_there():
    assert {"README.md", "CONTRIBUTING.md", "docs/ARCHITECTURE.md", "docs/results.md"} <= set(DOCUMENTS)
