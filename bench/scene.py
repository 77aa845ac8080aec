"""A part of the page of bench/run: how many cars one tick of 1/60 s can compute, against accuracy.

The rows are those of crumple_scene.
"""

import math

from matplotlib import pyplot

from tables import number, table

HITS = {"tapped": ("#0072B2", "o"), "crashing": ("#D55E00", "s")}
LINES = ("-", "--", ":", "-.")  # finest level first


def pick(rows, **wanted):
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def shown(value):
    return "–" if math.isnan(value) else number(value)


def draw(rows, path):
    figure, axes = pyplot.subplots(figsize=(7.5, 5.5))
    levels = sorted({row["nodes"] for row in rows if row["scene"] in HITS}, reverse=True)
    for hit, (colour, mark) in HITS.items():
        for level, line in zip(levels, LINES):
            default = [row for row in pick(rows, scene=hit, nodes=level) if row["tolerance"] > 0]
            most = max(row["substeps"] for row in default)
            chosen = [row for row in pick(rows, scene=hit, nodes=level) if row["tolerance"] == 0 and row["substeps"] == most]
            for row in default:
                usual = row["substeps"] == most
                axes.plot(row["cars_per_tick"], row["error_percent"], "*", markersize=14 if usual else 9, color=colour,
                          markeredgecolor="black", zorder=9)
                if not usual:
                    axes.annotate(f"{row['substeps']:.0f} sub", (row["cars_per_tick"], row["error_percent"]), fontsize=7,
                                  xytext=(4, -8), textcoords="offset points")
            axes.plot([row["cars_per_tick"] for row in chosen], [row["error_percent"] for row in chosen], color=colour,
                      marker=mark, linestyle=line, label=f"{hit}, {level:.0f} nodes")
            for row in chosen:
                axes.annotate(f"{row['iterations']:.0f}", (row["cars_per_tick"], row["error_percent"]), fontsize=7,
                              xytext=(4, 3), textcoords="offset points")
    for importance, mark in ((1, "^"), (0.1, "v")):
        chosen = [row for row in rows if row["scene"] == "overload" and abs(row["importance"] - importance) < 1e-3]
        axes.plot([row["cars_per_tick"] for row in chosen], [row["error_percent"] for row in chosen], color="#009E73",
                  marker=mark, label=f"crashing under a budget, importance {importance}")
    for row, line in zip(pick(rows, scene="asleep"), LINES):
        axes.axvline(row["cars_per_tick"], color="#999999", linestyle=line, label=f"asleep, {row['nodes']:.0f} nodes")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(f"cars in a tick of 1/60 s, {rows[0]['threads']:.0f} threads")
    axes.set_ylabel("error of the surface, rms, % of the largest displacement")
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=130, bbox_inches="tight")
    pyplot.close(figure)


def bars(rows):
    for row in pick(rows, scene="asleep"):
        yield [f"a car that nothing touches, {row['nodes']:.0f} nodes", "≤ 1 µs a tick", f"{number(row['us_best'])} µs",
               "yes" if row["us_best"] <= 1 else "**no**"]
    tap, all_awake = pick(rows, scene="sub-step of a tap"), pick(rows, scene="sub-step of a tap, all awake")
    if tap and all_awake:
        share, apart = 100 * tap[0]["us_best"] / all_awake[0]["us_best"], tap[0]["diagonal_percent"]
        visits = 100 * tap[0]["work"] / all_awake[0]["work"]
        yield ["a tap, compared with a solve of the whole car", "≤ 5 %", f"{number(share)} % of the time, {number(visits)} % of the visits",
               "yes" if share <= 5 else "**no**"]
        yield ["difference of their shapes at the end, rms", "≤ 0.1 % of the diagonal", f"{number(apart)} %", "yes" if apart <= 0.1 else "**no**"]


def text(rows):
    out = ["Cars hit a wall side by side. The numbers beside the marks are sweeps. Stars show the default; the small stars have 2 or 1 "
           "sub-steps a tick instead of 4. The error is the distance from the result of the finest level with 100 sweeps.\n",
           table(["what", "goal", "measured", "met"], list(bars(rows)))]
    changes = [row for row in rows if row["scene"].startswith(("switch", "crash on"))]
    if changes:
        out += ["\nA car crashes into a pole on the finest level, then changes its level. The table says how far its surface moves when "
                "the level changes and, in the rows with \"woken\", when the car is woken afterwards. For comparison, \"crash on the "
                "level\" computes the whole crash on the other level.\n",
                table(["what", "other level, nodes", "rms, mm", "largest, mm", "rms, % of the largest displacement"],
                      [[row["scene"], number(row["nodes"]), shown(row["error_mm"]), shown(row["max_mm"]),
                        shown(row["error_percent"])] for row in changes])]
    return "\n".join(out)
