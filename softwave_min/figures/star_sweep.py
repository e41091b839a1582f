"""Every star that was tried, its measures of the error against the paper's numbers."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt

from softwave_min.experiments.closed_loop import TRANSIENT
from softwave_min.experiments.star import choice
from softwave_min.figures.style import BLUE, INK, Drawing
from softwave_min.paper.tolerance import SHARE
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

SHOWN_MEASURES = {
    "rmse": ("o", "RMSE of the distance, whole run"),
    "rmse_settled": ("s", f"the same after {TRANSIENT:.0f} s"),
    "cross_track": ("D", "RMSE of the distance to the star's edges"),
    "largest_settled": ("^", f"largest distance after {TRANSIENT:.0f} s"),
    "root_integral_square": ("x", r"$(\int e^2\,\mathrm{d}t)^{1/2}$, m s$^{1/2}$"),
}


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:  # noqa: ARG001
    """One line per star: its measures in the sea drawn, against the paper's numbers."""
    table, chosen = store.read_table("star_sweep"), choice()
    figure, axes = plt.subplots(figsize=(7.0, 6.4))
    least, most = min(chosen.rmse.values()), max(chosen.rmse.values())
    axes.axvspan(least * (1 - SHARE), most * (1 + SHARE), color="#ececec", zorder=0)
    axes.axvspan(least, most, color="#cfcfcf", zorder=0)
    stars = table.groupby(["drawing", "manner", "laps", "previewed", "outer_radius"], sort=False)
    star, labels = chosen.path, []
    own = star.drawing, star.manner, star.laps, True, star.outer_radius
    for row, (key, group) in enumerate(stars):
        values = group.set_index("measure")
        for measure, (marker, _) in reversed(SHOWN_MEASURES.items()):
            look: Any = {"color": INK, "mfc": "white", "markersize": 5}
            if values.candidate[measure]:
                edge = "white" if marker != "x" else None
                look = {"color": BLUE, "mfc": BLUE, "mec": edge, "markersize": 9}
            axes.plot(values[chosen.case][measure], row, marker, **look)
        failed = int(group.solves_failed.iloc[0])
        nominal = "nominal: " if key == own else ""
        labels.append(nominal + _described(key) + (f" [{failed}]" if failed else ""))
    for marker, label in SHOWN_MEASURES.values():
        axes.plot([], [], marker, color=INK, markerfacecolor="white", label=label)
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel(f"measure of the error in {chosen.case}, m")
    figure.legend(loc="outside upper center", ncols=2)
    drawing = Drawing(
        figure,
        caption=(
            "Which star gives the paper's numbers? One line per star: its drawing, how it is "
            "followed, laps in a run, whether the NMPC is told the coming path (else the next "
            "point is held over the horizon), outer radius; in brackets the solves that did not "
            f"converge. Marks: measures of the error in {chosen.case}. Dark band: the paper's "
            f"numbers; light band: {100 * SHARE:.0f} % beyond them. Large filled marks: within "
            f"{100 * SHARE:.0f} % of the paper's number in each of the three seas "
            f"({table.candidate.sum()} of all {len(table)} combinations of star and measure)."
        ),
        alt=(
            f"A chart with {len(labels)} lines and {len(SHOWN_MEASURES)} kinds of marks on a "
            "logarithmic axis. Followed along its edges with preview, a star within reach is left "
            "of the band of the paper's numbers by nearly every measure that is a length. Longer "
            "jumps and a reference that is held over the horizon move the marks to the right."
        ),
    )
    return {"star_sweep": drawing}


def _described(key: Any) -> str:
    drawing, manner, laps, previewed, radius = key
    how = "along edges" if manner == "edges" else "by jumps"
    told = "told" if previewed else "held"
    laps_in_words = f"{laps} lap{'s' if laps > 1 else ''}"
    return f"{drawing.replace('_', ' ')}, {how}, {laps_in_words}, {told}, {radius:.2f} m"
