"""Draws what `crumple fit` found: crush as published and ours, and the force of the barrier over time and over the car's way.

    python -m crumple.fit_chart DATA.json PICTURE.png     the program calls it with the data of server/cli/fit_command.cpp
"""

from __future__ import annotations

import json
import sys
import textwrap
from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402

# Okabe and Ito's colours, which nearly everybody can tell apart.
INK = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"]
REPEATABILITY = 0.05  # by which two tests of one car differ
GRAVITY = 9.80665
MOST_CURVES = 6


def draw_crush(axes: Axes, hits: list[dict[str, Any]]) -> None:
    known = [hit for hit in hits if hit["crush"] > 0]
    most = 1.1 * max([max(hit["crush"], hit["ours"]) for hit in known], default=0.1) * 1000
    axes.fill_between([0, most], [0, most * (1 - REPEATABILITY)], [0, most * (1 + REPEATABILITY)], color="#dddddd",
                      label="two tests of one car differ so much")
    axes.plot([0, most], [0, most], color="#888888", linewidth=0.8)
    cars = list(dict.fromkeys(hit["car"] for hit in known))
    for car in cars:
        own = [hit for hit in known if hit["car"] == car]
        axes.plot([1000 * hit["crush"] for hit in own], [1000 * hit["ours"] for hit in own], marker="o", linewidth=1.2,
                  color=INK[cars.index(car) % len(INK)])
        for hit in own if len(known) <= 12 else []:
            axes.annotate(f"{hit['kmh']:.0f} km/h", (1000 * hit["crush"], 1000 * hit["ours"]), textcoords="offset points",
                          xytext=(6, -10), fontsize=8)
    axes.set(xlim=(0, most), ylim=(0, most), xlabel="residual crush as published, mm", ylabel="ours, mm")
    axes.legend(fontsize=8)


def draw_force(axes: Axes, hits: list[dict[str, Any]]) -> None:
    """Over time if a pulse is published, else over the car's way."""
    pulses = [hit for hit in hits if hit["published_force"]]
    for index, hit in enumerate(pulses[:MOST_CURVES]):
        for name, line, label in (("published_force", "-", "published"), ("force_by_sixtieth", "--", "ours")):
            values = [value / GRAVITY for value in hit[name]]
            axes.stairs(values, [1000 * k / 60 for k in range(len(values) + 1)], color=INK[index % len(INK)], linestyle=line,
                        linewidth=2, label=f"{hit['test']}, {label}")
    if pulses:
        axes.set(xlabel="time since contact, ms (means of 1/60 s)")
    else:
        depth: dict[int, float] = {}  # m, by car: where the next hit of it begins
        for index, hit in enumerate(hits[:MOST_CURVES]):
            start = depth.get(hit["car"], 0.0)
            depth[hit["car"]] = hit["ours"]
            axes.plot([1000 * (start + x) for x in hit["travel"]], [force / GRAVITY for force in hit["force"]], color=INK[index % len(INK)],
                      label=f"{hit['test']}, {hit['kmh']:.0f} km/h, ours")
        axes.set(xlabel="way of the car since contact, from the crush before, mm")
    axes.set(ylabel="force of the barrier over the car's mass, g")
    axes.legend(fontsize=8)


def main() -> None:
    with open(sys.argv[1], encoding="utf-8", errors="replace") as file:
        data = json.load(file)
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 5))
    draw_crush(left, data["hits"])
    draw_force(right, data["hits"])
    for axes in (left, right):
        axes.grid(color="#eeeeee", linewidth=0.6)
        axes.set_axisbelow(True)
    figure.suptitle(textwrap.shorten(data["title"], 120), fontsize=10)
    try:
        figure.savefig(sys.argv[2], dpi=120, bbox_inches="tight", format="png")
    except OSError as error:
        sys.exit(f"{error.strerror}; give another --picture.")


if __name__ == "__main__":
    main()
