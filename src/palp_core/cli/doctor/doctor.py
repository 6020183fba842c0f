"""``palp doctor``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.options import GraphOption, JsonOption
from palp_core.cli.output import print_json, print_text
from palp_core.counted import counted

if TYPE_CHECKING:
    from palp_core.cli.doctor.diagnostic import Diagnostic
    from palp_core.graph.discovery.run_directory import RunRecord

_ORDER = ("error", "warning", "note", "ok")


def doctor(
    *,
    report: Annotated[
        bool, typer.Option("--report", "-r", help="Also what was looked at and found in order.")
    ] = False,
    include_warnings: Annotated[
        bool, typer.Option("--include-warnings", "-iw", help="Status 1 for warnings, too.")
    ] = False,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """It only looks: a healthy run does not notice. Status 1 if there is an error."""
    from palp_core.cli.doctor.graph import examine_graph, examine_standing
    from palp_core.cli.doctor.host import examine_host
    from palp_core.cli.doctor.runs import examine_runs
    from palp_core.graph.discovery.running_graph import RunningGraph

    records, findings = _graphs(graph)
    placed = [
        (RunningGraph(record), f"graph {record.id}, " if len(records) > 1 else "") for record in records
    ]
    findings += [found.placed(of, one.record.id) for one, of in placed for found in examine_standing(one)]
    findings += [*examine_host(), *examine_runs()]
    findings += [found.placed(of, one.record.id) for one, of in placed for found in examine_graph(one)]
    counts = {level: sum(finding.level == level for finding in findings) for level in _ORDER}
    if as_json:
        print_json({"graphs": [record.graph for record in records], **counts, "findings": findings})
    else:
        _print(findings, counts, len(records), report=report)
    if counts["error"] or (include_warnings and counts["warning"]):
        raise typer.Exit(1)


def _graphs(name: str | None) -> tuple[list[RunRecord], list[Diagnostic]]:
    """Return the graph that is named, or those of this folder, and a word on those that are left out."""
    from palp_core.cli.doctor.diagnostic import remark
    from palp_core.graph.discovery.choice import choose, line_of, meant
    from palp_core.graph.discovery.run_directory import running

    if name is not None:
        return [choose(name).record], []
    records = running()
    chosen = meant(records, None)
    advice = "look at it: palp doctor --graph"
    return chosen, [
        remark(
            f"graph {record.id}",
            f"is another folder's, and not looked at: {line_of(record)}",
            f"{advice} {record.id}",
        )
        for record in records
        if record not in chosen
    ]


def _print(findings: list[Diagnostic], counts: dict[str, int], graphs: int, *, report: bool) -> None:
    for finding in sorted(findings, key=lambda finding: _ORDER.index(finding.level)):
        if finding.level == "ok" and not report:
            continue
        print_text(f"{finding.level.upper():<8} {finding.where}: {finding.what}")
        if finding.advice:
            print_text(f"         -> {finding.advice}")
    print_text(
        f"{counted(counts['error'], 'error')}, {counted(counts['warning'], 'warning')}, "
        f"{counted(counts['note'], 'note')}; "
        f"{counted(counts['ok'], 'check')} passed; {counted(graphs, 'graph')} running"
    )
