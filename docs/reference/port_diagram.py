"""Sphinx's directive `pydrake_system`, as Drake's own documentation has it: a system with its ports to either side."""

from __future__ import annotations

import html
from typing import Any

import yaml
from docutils import nodes
from docutils.parsers.rst import Directive

STYLE = (
    "border-collapse:separate;border-spacing:0 3px;margin:12px 0",
    "text-align:right;padding:2px 10px;border:0;font-family:monospace;font-size:90%",
    "background:#e8eef7;border:1px solid #6b86b3;border-radius:4px;padding:10px 22px;font-weight:bold",
    "text-align:left;padding:2px 10px;border:0;font-family:monospace;font-size:90%",
)


def port_table(text: str) -> str:
    """HTML of a system that a directive's content names: name, input_ports and output_ports, in YAML."""
    said = yaml.safe_load(text)
    inputs = [f"{html.escape(str(port))} &rarr;" for port in said.get("input_ports") or []]
    outputs = [f"&rarr; {html.escape(str(port))}" for port in said.get("output_ports") or []]
    rows = max(len(inputs), len(outputs), 1)
    table, left, middle, right = STYLE
    lines = [f'<table style="{table}">']
    for i in range(rows):
        cells = [f'<td style="{left}">{inputs[i] if i < len(inputs) else ""}</td>']
        if i == 0:
            cells.append(f'<td rowspan="{rows}" style="{middle}">{html.escape(str(said["name"]))}</td>')
        cells.append(f'<td style="{right}">{outputs[i] if i < len(outputs) else ""}</td>')
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return "\n".join([*lines, "</table>"])


class PydrakeSystem(Directive):
    """The directive."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """The table."""
        return [nodes.raw("", port_table("\n".join(self.content)), format="html")]


def setup(app: Any) -> dict[str, bool]:
    """What Sphinx calls."""
    app.add_directive("pydrake_system", PydrakeSystem)
    return {"parallel_read_safe": True}
