"""Missions by the paper's rules, with all of them and with one left out, a row each.

    python benchmarks/paper_rules.py
    python benchmarks/paper_rules.py --rows "all" "without frontiers" --seeds 1

In `paper`, at most two hours each. Rows, columns and --out are as of consistency.py.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import consistency
import reality

from tfg_drake.planning.paper_rules import PaperRules

METHODS = Path("runs/paper_rules")
METHOD = '''"""The paper's rules without one: {rule}."""

from tfg_drake.diagrams.methods import MakePaperExplorer
from tfg_drake.planning.paper_rules import PaperRules

RULES = PaperRules({rule}=False)
SETTINGS = RULES.settings()


def MakeExplorer(scenario):
    return MakePaperExplorer(scenario, RULES)
'''

if __name__ == "__main__":
    METHODS.mkdir(parents=True, exist_ok=True)
    rows = {"all": (["paper", "--method", "paper", "--max-time", "7200"], reality.BELIEVED, 3)}
    for name in (field.name for field in dataclasses.fields(PaperRules)):
        path = METHODS / f"without_{name}.py"
        path.write_text(METHOD.format(rule=name))
        rows[f"without {name}"] = (["paper", "--method", str(path), "--max-time", "7200"], reality.BELIEVED, 3)
    consistency.main(__doc__, rows, Path("runs/paper_rules.jsonl"))
