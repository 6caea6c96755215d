"""The report of a comparison, as Markdown and as one HTML file that needs nothing else."""

from __future__ import annotations

import base64
import dataclasses
import html
import math
from collections import Counter
from collections.abc import Callable, Sequence

from tfg_drake.comparison.measures import MEASURES, Measure
from tfg_drake.comparison.runs import Run, of_shared_seeds, paired, sample, values
from tfg_drake.comparison.statistics import RESAMPLES, Interval, Spread, difference, ratio, spread

# Least number of pairs for a bootstrap interval, which is too narrow with fewer.
_ENOUGH = 8
_OUTCOMES = ("complete", "budget", "battery", "time_limit", "stuck", "apart", "fault", "failed", "interrupted")


@dataclasses.dataclass(frozen=True)
class Picture:
    """A figure of the report: the name of its file without suffix, what it shows, and the bytes of its PNG."""

    name: str
    caption: str
    png: bytes


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Contents of a report.

    title: what is compared, one line. methods: in their order; the others are compared with the first. runs: those
    there are; planned: how many there should be. command: repeats it. versions: what it ran with, one line.
    need_tags: the methods that map tags alone.
    """

    title: str
    methods: Sequence[str]
    runs: Sequence[Run]
    planned: int
    command: str
    versions: str
    need_tags: Sequence[str] = ()


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of texts: its title, a note that explains it, the names of its columns and its rows."""

    title: str
    note: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


def markdown(comparison: Comparison, pictures: Sequence[Picture]) -> str:
    """The report as Markdown; the figures are files beside it."""
    parts = [f"# {comparison.title}", *_introduction(comparison)]
    for picture in pictures:
        parts.append(f"![{picture.caption}]({picture.name}.png)\n\n{picture.caption}")
    for table in tables(comparison):
        parts.append(markdown_table(table))
    parts += ["## To repeat it", f"    {comparison.command}", comparison.versions]
    return "\n\n".join(parts) + "\n"


def markdown_table(table: Table) -> str:
    """A table as Markdown, under its title."""
    rows = [table.header, ["---"] * len(table.header), *table.rows]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n\n".join([f"## {table.title}", *([table.note] if table.note else []), "\n".join(lines)])


def page(comparison: Comparison, pictures: Sequence[Picture]) -> str:
    """The report as one HTML page with its figures inside."""
    title = html.escape(comparison.title)
    parts = [f"<h1>{title}</h1>", *(f"<p>{html.escape(text)}</p>" for text in _introduction(comparison))]
    for picture in pictures:
        source = f"data:image/png;base64,{base64.b64encode(picture.png).decode()}"
        caption = html.escape(picture.caption)
        parts.append(f'<figure><img src="{source}" alt="{caption}"><figcaption>{caption}</figcaption></figure>')
    parts += [_html_table(table) for table in tables(comparison)]
    parts.append(f"<h2>To repeat it</h2>\n<pre>{html.escape(comparison.command)}</pre>")
    parts.append(f"<p>{html.escape(comparison.versions)}</p>")
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>'
    return f'<!doctype html>\n<html lang="en"><head>{head}<style>{_STYLE}</style></head><body>\n' + (
        "\n".join(parts) + "\n</body></html>\n"
    )


def tables(comparison: Comparison) -> list[Table]:
    """The report's tables: outcomes, figures, comparisons with the first method, runs that did not complete."""
    methods, runs = comparison.methods, comparison.runs
    found = [_outcome_table(methods, runs), _figures_table(methods, of_shared_seeds(runs, methods))]
    if len(methods) > 1:
        found += _paired_tables(methods, runs)
    rest = [run for run in runs if run.outcome != "complete"]
    if rest:
        rows = [[run.method, str(run.seed), run.outcome, run.reason] for run in rest]
        note = "The folder of each holds its log. Of failed runs and faults nothing is counted above."
        if any(run.outcome == "time_limit" for run in rest):
            note += " What the time limit ended counts as it was then, with the limit as its time."
        found.append(Table("Runs that did not complete", note, ("method", "seed", "outcome", "why"), rows))
    return found


def text(mean: Spread, measure: Measure, runs: int = 0) -> str:
    """Mean, spread and interval: "0.147 ± 0.115 (0.101 to 0.192)", "-" for no run; ", n = 2" where more, `runs`, were
    made."""
    if not mean.n:
        return "-"
    value, few = measure.shown(mean.mean.value), f", n = {mean.n}" if mean.n < runs else ""
    if mean.n == 1:
        return value + few
    return f"{value} ± {mean.std:.{measure.digits}f} {_bounds(mean.mean, measure.shown)}{few}"


def _introduction(comparison: Comparison) -> list[str]:
    runs, methods = comparison.runs, comparison.methods
    seeds = len({run.seed for run in of_shared_seeds(runs, methods)})
    lines = [
        f"{', '.join(methods)}; {seeds} seed{'s' if seeds != 1 else ''} each, paired: on one seed every method has the"
        " same world, the same start and the same random numbers. All errors are those of the online estimate against"
        " the truth, at every odometry period, turns included."
    ]
    tags = {run.method: run.summary.get("landmarks_mapped") for run in runs if run.summary}
    alone = comparison.need_tags
    by_tags = [method for method in methods if tags.get(method)]
    if by_tags and (others := [method for method in methods if method in tags and tags[method] is None]):
        lines.append(
            f"The world's tags are seen by {', '.join(by_tags)}, not by {', '.join(others)}: "
            "--tag-spacing none is fairer"
            + (f", but not for {', '.join(alone)}, which maps tags alone." if alone else ".")
        )
    areas = {run.method: run.summary for run in runs if run.summary and run.summary.get("area_coverage") is not None}
    at_views = [method for method in methods if method in areas and areas[method].get("walls_mapped") is not None]
    if at_views and (others := [method for method in methods if method in areas and method not in at_views]):
        lines.append(
            f"The area seen is that from turns and glances by {', '.join(at_views)}, on the whole way by"
            f" {', '.join(others)}: compare the time to see 99 % of it, which counts the whole way of all."
        )
    if len(runs) < comparison.planned:
        lines.append(
            f"This report is partial: {len(runs)} of {comparison.planned} runs are done. Its figures are of the seeds"
            " that all methods with a run have."
        )
    return lines


def _outcome_table(methods: Sequence[str], runs: Sequence[Run]) -> Table:
    counts = {method: Counter(run.outcome for run in runs if run.method == method) for method in methods}
    shown = [outcome for outcome in _OUTCOMES if any(count[outcome] for count in counts.values())]
    rows = []
    for method, count in counts.items():
        contacts = sum((run.summary or {}).get("contacts") or 0 for run in runs if run.method == method)
        rows.append([method, str(sum(count.values())), *(str(count[outcome]) for outcome in shown), str(contacts)])
    return Table("Outcomes", "", ("method", "runs", *shown, "contacts in all"), rows)


def _figures_table(methods: Sequence[str], runs: Sequence[Run]) -> Table:
    rows, made = [], Counter(run.method for run in runs)
    for measure in _measures(runs):
        spreads = {method: spread(sample(runs, method, measure.read)) for method in methods}
        rows.append([measure.label, *(text(one, measure, made[method]) for method, one in spreads.items())])
    note = (
        "Mean ± standard deviation over the runs (n - 1), and the 95 % interval of the mean: Efron's BCa bootstrap, "
        f"{RESAMPLES} resamples; of fewer than {_ENOUGH} runs it is too narrow to be quoted. n: the runs that have the"
        " figure, where others lack it, such as the time until nothing was left of a mission that did not get there."
        " The figures of two methods may then be of different seeds."
    )
    return Table("Figures", note, ("", *methods), rows)


def _measures(runs: Sequence[Run]) -> list[Measure]:
    """Measures that some run has: without tags, none of theirs."""
    return [one for one in MEASURES if any(run.summary and one.read(run.summary) is not None for run in runs)]


def _paired_tables(methods: Sequence[str], runs: Sequence[Run]) -> list[Table]:
    """Differences to the first method and ratios to it."""
    first, *others = methods
    seeds = {method: {run.seed for run in runs if run.method == method and run.counts} for method in methods}
    pairs = {method: len(seeds[first] & seeds[method]) for method in others}
    header = ("", *(f"{method} ({pairs[method]} pairs)" for method in others))
    differences, ratios = [], []
    for measure in _measures(runs):
        mine = values(runs, first, measure.read)
        both = [paired(mine, values(runs, method, measure.read)) for method in others]
        few = [_few(len(one[0]), pairs[method]) for one, method in zip(both, others, strict=True)]
        cells = [_signed(difference(*one), measure.digits, len(one[0]), n) for one, n in zip(both, few, strict=True)]
        differences.append([measure.label, *cells])
        ratios.append([measure.label, *(_times(ratio(*one), n) for one, n in zip(both, few, strict=True))])
    on = (
        f"Over the seeds on which neither the method nor {first} failed, whatever ended the mission, less those where"
        " one lacks the figure (then with the number of pairs that are left)"
    )
    bold = f"Bold: the interval leaves out zero, from {_ENOUGH} pairs on, as of fewer it is too narrow"
    return [
        Table(
            f"Difference to {first}",
            f"{on}: the mean of the method minus {first}, with its 95 % paired bootstrap interval. {bold}; of twenty"
            " figures that do not differ one will by chance.",
            header,
            differences,
        ),
        Table(f"Ratio to {first}", f"{on}: the ratio of the means, with its interval.", header, ratios),
    ]


def _few(pairs: int, of: int) -> str:
    """The number of pairs, as it follows a figure that has fewer than its column; "" where it has as many."""
    return "" if pairs == of else f", {pairs} pair{'s' if pairs != 1 else ''}"


def _signed(one: Interval, digits: int, pairs: int, few: str) -> str:
    if math.isnan(one.value):
        return "-"
    shown = f"{{:+.{digits}f}}".format
    cell = f"{shown(one.value)} {_bounds(one, shown)}".strip() + few
    return f"**{cell}**" if pairs >= _ENOUGH and (one.low > 0.0 or one.high < 0.0) else cell


def _times(one: Interval, few: str) -> str:
    if math.isnan(one.value):
        return "-"
    shown = ("{:,.0f}" if one.value >= 100.0 else "{:#.3g}").format
    return f"{shown(one.value)} {_bounds(one, shown)}".strip() + few


def _bounds(one: Interval, shown: Callable[[float], str]) -> str:
    return "" if math.isnan(one.low) else f"({shown(one.low)} to {shown(one.high)})"


def _html_table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(name)}</th>" for name in table.header)
    rows = [f"<tr><th>{html.escape(row[0])}</th>{''.join(map(_html_cell, row[1:]))}</tr>" for row in table.rows]
    note = f"<p>{html.escape(table.note)}</p>" if table.note else ""
    body = f"<thead><tr>{head}</tr></thead>\n<tbody>{chr(10).join(rows)}</tbody>"
    return f"<h2>{html.escape(table.title)}</h2>{note}\n<div><table>{body}</table></div>"


def _html_cell(content: str) -> str:
    """A cell; an interval stands on a line of its own, which keeps the columns narrow."""
    value, bracket, bounds = html.escape(content.strip("*")).partition(" (")
    inner = f"{value}<br><small>({bounds}</small>" if bracket and " to " in bounds else value + bracket + bounds
    return f"<td><b>{inner}</b></td>" if content.startswith("**") else f"<td>{inner}</td>"


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2126; max-width: 62rem; margin: 2.5rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
figure { margin: 1.8rem 0; } img { width: 100%; } figcaption { color: #566069; font-size: .9rem; }
div { overflow-x: auto; } table { border-collapse: collapse; font-size: .86rem; line-height: 1.35; }
th, td { padding: .35rem .9rem .35rem 0; text-align: left; vertical-align: top; }
td { font-variant-numeric: tabular-nums; } tbody th { font-weight: 400; white-space: nowrap; }
thead th { border-bottom: 1.5px solid #1c2126; vertical-align: bottom; }
tbody tr { border-bottom: 1px solid #e4e7ea; } small { color: #566069; white-space: nowrap; }
pre { background: #f4f6f7; padding: .8rem 1rem; overflow-x: auto; }
"""
