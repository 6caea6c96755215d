"""Missions where tags are few, or none, so that walls have to do: errors and NEES, a spacing of tags a row.

    python benchmarks/tag_spacing.py
    python benchmarks/tag_spacing.py --rows "paper, none" --seeds 3

Rows, columns and --out are as of consistency.py: a mission that this version has run already is not run again.
"""

from __future__ import annotations

from pathlib import Path

import consistency
import reality

SPACINGS = ("1", "4", "10", "none")
ROWS = {
    f"paper, {spacing}": (["paper", "--world", "paper", "--tag-spacing", spacing], reality.BELIEVED, 5)
    for spacing in SPACINGS
}
ROWS |= {
    f"{world}, {spacing}": ([world, "--world", world, "--tag-spacing", spacing], reality.BELIEVED, 5)
    for world in ("house", "house_real", "paper_real")
    for spacing in ("4", "none")
}
ROWS["house, five people"] = (["house", "--set", "reality.people=5"], reality.BELIEVED, 6)
ROWS["paper, tags alone"] = (["paper", "--set", "explorer.landmarks=tags"], reality.BELIEVED, 20)

if __name__ == "__main__":
    consistency.main(__doc__, ROWS, Path("runs/tag_spacing.jsonl"))
