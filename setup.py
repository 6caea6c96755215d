"""The metadata is in pyproject.toml; this only sees to it that nothing is built without half of the package."""

from pathlib import Path

from setuptools import setup

# Links to folders at the top. Where git keeps no symbolic links they are small text files, and setuptools would leave
# those folders out without a word.
LINKED = ("systems", "diagrams", "hardware")

missing = [name for name in LINKED if not (Path("tfg_drake") / name / "__init__.py").is_file()]
if missing:
    raise SystemExit(
        f"tfg_drake/{missing[0]} is not a link to {missing[0]}/, as git makes it where core.symlinks is true; "
        "mend it with: git config core.symlinks true && git checkout -- tfg_drake"
    )

setup()
