"""Draws the stability matrix: python stability.py CSV -o PNG

in: what crumple_stability wrote; out: a row a start (all random scenes are one), a column a method, in each cell a colour and a
letter for what happened, with the share of inverted tets or the shape error in % beside it.
"""

import argparse
import collections
import csv

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.patches import Patch, Rectangle

# Okabe and Ito's colours, which the colour-blind can tell apart too; the worst outcome is last.
OUTCOMES = {
    "recovered": ("R", "#009E73"),
    "wrong rest": ("W", "#F0E442"),
    "inverted": ("I", "#E69F00"),
    "passed": ("P", "#56B4E9"),
    "exploded": ("X", "#D55E00"),
    "not finite": ("N", "#999999"),
}
RANDOM = "random scene"


def read_cells(path):
    """Returns (methods, starts, {(method, start): [row, ...]}) in the file's order. All random scenes count as one start."""
    cells = collections.defaultdict(list)
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            start = RANDOM + "s" if row["start"].startswith(RANDOM) else row["start"]
            cells[row["method"], start].append(row)
    if not cells:
        raise SystemExit(f"{path}: it has no rows; write it with crumple_stability.")
    return list(dict.fromkeys(m for m, _ in cells)), list(dict.fromkeys(s for _, s in cells)), cells


def describe(rows):
    """Returns the worst outcome of the rows, and the text of the cell."""
    outcomes = [row["outcome"] for row in rows]
    worst = max(outcomes, key=list(OUTCOMES).index)
    letter = OUTCOMES[worst][0]
    if len(rows) > 1:
        return worst, f"{letter} {outcomes.count(worst)}/{len(rows)}"
    row = rows[0]
    figure = {"wrong rest": f" {float(row['shape_error_percent']):.2g}", "inverted": f" {float(row['inverted_percent']):.2g}"}
    return worst, letter + figure.get(worst, "")


def draw(methods, starts, cells, path):
    figure, axes = pyplot.subplots(figsize=(3.2 + 1.05 * len(methods), 1.2 + 0.24 * len(starts)))
    for x, method in enumerate(methods):
        for y, start in enumerate(starts):
            if (method, start) not in cells:
                continue
            outcome, text = describe(cells[method, start])
            axes.add_patch(Rectangle((x, y), 1, 1, facecolor=OUTCOMES[outcome][1], edgecolor="white"))
            axes.text(x + 0.5, y + 0.52, text, ha="center", va="center", fontsize=7)
    axes.set_xlim(0, len(methods))
    axes.set_ylim(len(starts), 0)
    axes.set_xticks([x + 0.5 for x in range(len(methods))], methods, fontsize=8)
    axes.set_yticks([y + 0.5 for y in range(len(starts))], starts, fontsize=7)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    legend = [Patch(color=colour, label=f"{letter}  {name}") for name, (letter, colour) in OUTCOMES.items()]
    axes.legend(handles=legend, loc="upper center", bbox_to_anchor=(0.3, 0), ncols=6, fontsize=7, frameon=False,
                title="I: % of tets inverted.  W: rms shape error, % of the diagonal.  N/M: in N of M scenes.",
                title_fontsize=7)
    figure.savefig(path, dpi=150, bbox_inches="tight")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("csv")
    parser.add_argument("-o", required=True, metavar="PNG", dest="png")
    options = parser.parse_args()
    draw(*read_cells(options.csv), options.png)


if __name__ == "__main__":
    main()
