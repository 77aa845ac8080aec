"""Writes the page of bench/run: error against time, the goals of the default solver, the thesis's tables, the stability matrix.

    chart.py FOLDER [--quick]

in: chart.csv (crumple_chart) in FOLDER, and other results of bench/run if they are there: peers.csv and peers_convergence.csv
(bench/peers), scene.csv (crumple_scene), stability.csv, outside.csv (crumple_outside), the reports of crumple_bench in cars/*.json,
tables.md, pairs.md (crumple_pairs). out: page.md and its PNGs in FOLDER. If a goal was not measured, the page says so.
"""

import argparse
import collections
import csv
import math
import pathlib
import re

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

import scene
import stability
from outside import Outside
from tables import Runs, best, commit, map_and_constrain, number, table

DEFAULT = 0  # iterations in chart.csv if Parameters::tolerance ends the sweeps (server/sim/material.h)
SUBSTEPS = 4  # Parameters::substeps
WANTED = 1  # % of the largest displacement
SCENES = {"wall": "wall, 50 km/h", "pole": "pole, 50 km/h", "elastic push": "elastic push of 0.20 m"}
# Okabe and Ito's colours with a different mark each, so that the colour-blind can tell them apart.
METHODS = {
    "nodal": ("#000000", "o"),
    "nodal, path given": ("#0072B2", "s"),
    "classic": ("#E69F00", "^"),
    "coloured": ("#56B4E9", "v"),
    "averaged jacobi": ("#009E73", "<"),
    "relaxed jacobi": ("#CC79A7", ">"),
    "naive jacobi": ("#999999", "x"),
    "xpbd": ("#D55E00", "D"),
}
PEERS = {"crumple": ("#000000", "*"), "jolt": ("#E69F00", "P"), "pypbd": ("#009E73", "X"), "rapier": ("#D55E00", "h"), "mujoco": ("#CC79A7", "d")}


def read(path):
    """Reads the rows of a CSV. Numbers become floats, empty fields nan. Returns no rows if the file does not exist."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        for key, value in row.items():
            if key in ("hash", "commit"):
                continue
            try:
                row[key] = float(value) if value else math.nan
            except ValueError:
                pass
    return rows


def pick(rows, **wanted):
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def front(points):
    """Returns the points (ms, error) that no other point beats in both, sorted by ms."""
    out = []
    for ms, error in sorted(points):
        if not out or error < out[-1][1]:
            out.append((ms, error))
    return out


def within(rows, ms="ms_best", error="error_percent", count="iterations"):
    """Returns the fastest row of a method from which on all larger counts have at most the wanted error; None if there is none."""
    counted = sorted((row for row in rows if row[count] != DEFAULT), key=lambda row: row[count])
    good = [row for row in rows if row[count] == DEFAULT and row[error] <= WANTED]
    good += [row for k, row in enumerate(counted) if all(later[error] <= WANTED for later in counted[k:])]
    return min(good, key=lambda row: row[ms], default=None)


def peer_rows(folder):
    """Returns the rows of peers against their own converged results, without the rows of these results."""
    rows = [row for row in read(folder / "peers_convergence.csv") if not str(row["note"]).startswith("error")]
    return [row for row in rows if row["iterations_per_step"] != row["reference"]]


def log_log(axes, x, y):
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)


def save(figure, path):
    figure.savefig(path, dpi=130, bbox_inches="tight")
    pyplot.close(figure)


def counted(rows):
    """Returns the rows with a fixed number of iterations."""
    return [row for row in rows if row["iterations"] != DEFAULT]


def points(rows, x="ms_best"):
    return [(row[x], row["error_percent"]) for row in rows if row[x] > 0 and row["error_percent"] > 0]


def draw_methods(axes, rows):
    drawn = []
    for method, (colour, mark) in METHODS.items():
        line = points(counted(pick(rows, method=method)))
        if line:
            axes.plot(*zip(*line), color=colour, marker=mark, markersize=5, linewidth=1.2, label=method)
        elif pick(rows, method=method):
            axes.plot([], [], color=colour, marker=mark, label=method + " (its result is never finite)")
        drawn += line if method != "nodal, path given" else []
    default = points(pick(rows, method="nodal", iterations=DEFAULT))
    axes.plot(*zip(*front(drawn + default)), color="#F0E442", linewidth=7, alpha=0.7, zorder=0, label="Pareto front")
    axes.plot(*zip(*default), "*", markersize=17, color="#F0E442", markeredgecolor="black", zorder=9,
              label="our default: nodal with its tolerance")
    axes.axhline(WANTED, color="black", linewidth=0.8, linestyle=":")


def draw_peers(axes, peers):
    for peer, (colour, mark) in PEERS.items():
        line = front(points([row | dict(ms_best=row["best_ms"], error_percent=row["rms_error_percent"])
                             for row in peers if row["peer"] == peer]))
        if line:
            axes.plot(*zip(*line), color=colour, marker=mark, linestyle="--", linewidth=1.2,
                      label=f"{peer}, its best model (dashed)")


def peers_within(peers, **wanted):
    """Returns (model, its fastest row within 1 % or None) for each model of a peer."""
    chosen = pick(peers, **wanted)
    return [(model, within(pick(chosen, model=model), "best_ms", "rms_error_percent", "iterations_per_step"))
            for model in dict.fromkeys(row["model"] for row in chosen)]


def quickest(peers, **wanted):
    return min((row for _, row in peers_within(peers, **wanted) if row), key=lambda row: row["best_ms"], default=None)


def peers_car(rows, peers, car):
    """Returns the car whose elastic push is shown beside the peers': the car that they ran on, if it was measured."""
    return peers[0]["mesh"] if peers and pick(rows, scene="elastic push", car=peers[0]["mesh"]) else car


def draw_frontier(rows, peers, car, path):
    scenes = [scene for scene in SCENES if points(pick(rows, scene=scene, car=car))]
    figure, all_axes = pyplot.subplots(1, len(scenes), figsize=(6.2 * len(scenes), 5.6), sharex=True, sharey=True,
                                       squeeze=False)
    for axes, scene in zip(all_axes[0], scenes):
        beside = peers if scene == "elastic push" else []
        chosen = pick(rows, scene=scene, car=peers_car(rows, beside, car))
        log_log(axes, "ms a tick of 1/60 s, one thread", "")
        draw_methods(axes, chosen)
        axes.set_title(f"{SCENES[scene]}: {chosen[0]['car']}, {chosen[0]['nodes']:,.0f} nodes", fontsize=10)
        if beside:
            draw_peers(axes, pick(beside, threads=1))
            axes.set_title(axes.get_title() + f"\ndashed: the elastic push of bench/peers (it moves front nodes)\n"
                           f"on {beside[0]['mesh']}, {beside[0]['nodes']:,.0f} nodes", fontsize=8)
        axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, frameon=False)
        axes.set_ylim(1e-3, 120)  # smaller errors are rounding
    all_axes[0][0].set_ylabel("error, rms, % of the largest displacement,\nagainst the method's own converged result")
    save(figure, path)


def draw_iterations(rows, path):
    figure, axes = pyplot.subplots(figsize=(6.5, 4.8))
    log_log(axes, "sweeps a sub-step", "error of nodal, rms, % of the largest displacement")
    colours = [colour for colour, _ in METHODS.values()]
    cars = list(dict.fromkeys(row["car"] for row in pick(rows, method="nodal")))
    for car, colour in zip(cars, colours):
        for scene, style in (("wall", "-"), ("pole", "--"), ("head-on", ":")):
            line = points(counted(pick(rows, method="nodal", car=car, scene=scene)), "iterations")
            if line:
                axes.plot(*zip(*line), style, marker="o", markersize=4, color=colour, label=f"{car}, {scene}")
    counts = sorted({row["iterations"] for row in counted(pick(rows, method="nodal"))})
    axes.set_xticks(counts, [f"{count:.0f}" for count in counts])
    axes.minorticks_off()
    axes.axhline(WANTED, color="black", linewidth=0.8, linestyle=":")
    axes.legend(fontsize=7)
    save(figure, path)


def slope(line):
    """Fits a straight line through (log x, log y) by least squares; None for fewer than two points."""
    xs, ys = zip(*((math.log(x), math.log(y)) for x, y in line))
    x, y = sum(xs) / len(xs), sum(ys) / len(ys)
    squares = sum((a - x) ** 2 for a in xs)
    return sum((a - x) * (b - y) for a, b in zip(xs, ys)) / squares if squares else None


def draw_nodes(rows, path):
    figure, axes = pyplot.subplots(figsize=(6.5, 4.8))
    log_log(axes, "nodes", "ms a tick of 1/60 s, nodal at its default, one thread")
    slopes = {}
    for scene, (colour, mark) in zip(("wall", "pole"), (("#000000", "o"), ("#D55E00", "^"))):
        chosen = sorted(pick(rows, method="nodal", scene=scene, iterations=DEFAULT), key=lambda row: row["nodes"])
        line = [(row["nodes"], row["ms_best"]) for row in chosen]
        slopes[scene] = slope(line) if line else None
        label = SCENES[scene] + (f": slope {slopes[scene]:.2f}" if slopes[scene] is not None else "")
        axes.plot(*zip(*line), mark, linestyle="-", color=colour, label=label)
        for row in chosen if scene == "wall" else []:
            axes.annotate(row["car"], (row["nodes"], row["ms_best"]), fontsize=7, xytext=(5, -9), textcoords="offset points")
    axes.axhline(1000 / 60, color="black", linewidth=0.8, linestyle=":", label="duration of a tick")
    axes.legend(fontsize=8)
    save(figure, path)
    return slopes


def draw_threads(rows, path):
    """Draws ms against threads. Returns whether anything was measured on more than one thread."""
    lines = collections.defaultdict(list)
    for row in pick(rows, method="nodal", iterations=DEFAULT, scene="wall"):
        lines[f"{row['car']}, {row['nodes']:,.0f} nodes"].append((row["threads"], row["ms_best"]))
    lines = {car: sorted(line) for car, line in lines.items() if len(line) > 1}
    if not lines:
        return False
    figure, axes = pyplot.subplots(figsize=(6.5, 4.8))
    log_log(axes, "threads (1: processor time; more: wall time)", f"ms a tick, nodal at its default, {SCENES['wall']}")
    for (car, line), (colour, mark) in zip(lines.items(), METHODS.values()):
        axes.plot(*zip(*line), marker=mark, color=colour, label=f"{car}: {line[0][1] / line[-1][1]:.2f} x")
        axes.plot([n for n, _ in line], [line[0][1] / n for n, _ in line], linestyle=":", color=colour, linewidth=0.8)
    threads = sorted({n for line in lines.values() for n, _ in line})
    axes.set_xticks(threads, [f"{n:.0f}" for n in threads])
    axes.minorticks_off()
    axes.legend(fontsize=7, title="dotted: ideal", title_fontsize=7)
    save(figure, path)
    return True


def times_to_one_percent(rows, car):
    """Returns Markdown: ms to come within 1 % by method, and the ratio to ours."""
    out = []
    for method in METHODS:
        line = [method]
        for scene in SCENES:
            chosen = pick(rows, method=method, scene=scene, car=car)
            ours = within(pick(rows, method="nodal" if scene == "elastic push" else "nodal, path given", scene=scene, car=car))
            row = within(chosen)
            if not chosen:
                line.append("–")
            elif not row:
                finite = [r["error_percent"] for r in chosen if r["error_percent"] >= 0]
                last = f"{number(min(finite))} % at best" if finite else "not finite"
                line.append(f"never in up to {max(r['iterations'] for r in chosen):.0f} ({last})")
            else:
                more = f", {number(row['ms_best'] / ours['ms_best'])} x ours" if ours and not method.startswith("nodal") else ""
                line.append(f"**{number(row['ms_best'])}** ({number(row['ms_median'])}) at {row['iterations']:.0f}{more}"
                            .replace(" at 0", " at the default"))
        if set(line[1:]) != {"–"}:
            out.append(line)
    return table(["ms to 1 %", *SCENES.values()], out)


def peers_to_one_percent(peers):
    ours = {threads: quickest(peers, peer="crumple", threads=threads) for threads in (1, 2)}
    out = []
    for peer in dict.fromkeys(row["peer"] for row in peers):
        on = {threads: dict(peers_within(peers, peer=peer, threads=threads)) for threads in (1, 2)}
        for model in on[1]:
            moves = pick(peers, peer=peer, model=model)[0]["answer_moves_percent"]
            line = [f"{peer}, {model}", number(moves) + " %"]
            for threads in (1, 2):
                row = on[threads].get(model)
                line += [f"**{number(row['best_ms'])}** ({number(row['median_ms'])}) at {row['iterations_per_step']:.0f}",
                         f"{number(row['best_ms'] / ours[threads]['best_ms'])} x" if ours[threads] else ""] if row else \
                    ["never", ""]
            out.append(line)
    return table(["peer, model", "its result changes by", "ms to 1 %, one thread", "times ours", "ms to 1 %, two threads", "times ours"], out)


def kernels(rows):
    chosen = [row for row in rows if row["scene"].startswith("kernel")]
    out = [[row["car"], row["scene"].split()[1], row["method"], f"{row['tets']:,.0f}", number(row["ms_best"]),
            number(1e6 * row["ms_best"] / row["tets"]), number(1e6 * row["ms_median"] / row["tets"])] for row in chosen]
    return table(["car", "pass", "instructions", "tets", "ms, best", "ns a tet, best", "ns a tet, median"], out)


def accuracy(rows):
    """Returns the tables of nodal at its default by car and scene, and of the time steps."""
    out = []
    for row in pick(rows, iterations=DEFAULT):
        if row["scene"] in ("wall", "pole", "head-on") and row["method"].startswith("nodal") and "path" not in row["method"]:
            out.append([row["car"], f"{row['nodes']:,.0f}", row["scene"], row["method"],
                        *(number(None if math.isnan(row[key]) else row[key])
                          for key in ("error_percent", "max_percent", "ms_best", "ms_median", "crush_mm")),
                        "–" if math.isnan(row["energy_ratio"]) else f"{row['energy_ratio']:.4f}"])
    return table(["car", "nodes", "scene", "method", "error, %", "largest, %", "ms, best", "ms, median", "residual crush, mm",
                  "energy after / before"], out)


class Bars:
    """Returns the table of the goals of the default solver, as far as they were measured."""

    def __init__(self, rows, folder, car):
        self.all, self.rows = rows, pick(rows, threads=1)
        self.folder, self.car, self.lines = folder, car, []
        self.runs = Runs(sorted((folder / "cars").glob("*.json")))
        self.large = max(rows, key=lambda row: row["nodes"])
        self.cells = read(folder / "stability.csv")
        self.outside = Outside(folder)

    def add(self, what, bar, measured, met=None):
        self.lines.append([what, bar, measured or "not measured in this run",
                           "–" if met is None else "yes" if met else "**no**"])

    def errors(self):
        chosen = [row for row in pick(self.rows, method="nodal", iterations=DEFAULT)
                  if row["scene"] in ("wall", "pole") and row["error_percent"] >= 0]
        worst = max(chosen, key=lambda row: row["error_percent"])
        cars = ", ".join(dict.fromkeys(row["car"] for row in chosen))
        self.add("solver error at the default, wall and pole at 50 km/h", "≤ 1 %",
                 f"at most {number(worst['error_percent'])} % ({worst['car']}, {worst['scene']}; cars: {cars})",
                 worst["error_percent"] <= WANTED)
        for method in ("classic", "xpbd"):
            ours = within(pick(self.rows, method="nodal, path given", scene="wall", car=self.car))
            chosen = pick(self.rows, method=method, scene="wall", car=self.car)
            self.gain(f"time to 1 % against {method}, wall, {self.car}", ours, within(chosen), chosen, "ms_best")

    def gain(self, what, ours, theirs, all_theirs, ms):
        """A method that never comes within 1 % needs at least the time of its longest setting."""
        longest = max((row[ms] for row in all_theirs), default=None)
        if not ours or not longest:
            return self.add(what, "≥ 20 x less", None)
        times = (theirs[ms] if theirs else longest) / ours["ms_best"]
        said = f"{number(times)} x" if theirs else f"over {number(times)} x: it is not within 1 % at any measured setting"
        self.add(what, "≥ 20 x less", said, times >= 20 if theirs or times >= 20 else None)

    def peers(self):
        rows = peer_rows(self.folder)
        for peer in ("jolt", "pypbd", "rapier", "mujoco"):
            said, times = [], []
            for threads in (1, 2):
                ours, theirs = (quickest(rows, peer=each, threads=threads) for each in ("crumple", peer))
                if not ours or not pick(rows, peer=peer):
                    continue
                times.append(theirs["best_ms"] / ours["best_ms"] if theirs else math.inf)
                said.append(f"{threads} thread(s): " + (f"{number(times[-1])} x ({theirs['model']})" if theirs else "never"))
            car = f", {rows[0]['mesh']}" if rows else ""
            self.add(f"time to 1 % against {peer}, elastic push{car}", "≥ 20 x less", "; ".join(said),
                     min(times) >= 20 if times else None)
        at = {(row["peer"], row["threads"]): row["best_ms_per_iteration"] for row in read(self.folder / "peers.csv")}
        both = [(threads, at.get(("crumple", threads)), at.get(("jolt", threads))) for threads in (2, 1)]
        said = [f"{threads} thread(s): {number(ours)} ms, Jolt's iteration {number(theirs)} ms, {number(theirs / ours)} x"
                for threads, ours, theirs in both if ours and theirs]
        _, ours, theirs = both[0]
        self.add("one sweep over a grid of 234,960 tets, with all work between two sweeps", "2 threads: ≤ 1.4 ms, ≥ 6 x less than Jolt",
                 "; ".join(said), ours <= 1.4 and theirs >= 6 * ours if said else None)

    def sweep(self, threads):
        """Returns the ms of one sweep within a tick (from 10 and 24 sweeps in a sub-step), and the tets, of the largest car."""
        rows = pick(self.all, car=self.large["car"], scene="wall", method="nodal", threads=threads)
        at = {row["iterations"]: row for row in rows}
        if self.large["nodes"] < 40000 or not {10, 24} <= at.keys():
            return None, None
        return (at[24]["ms_best"] - at[10]["ms_best"]) / 14 / SUBSTEPS, at[10]["tets"]

    def speed(self):
        fastest = min(pick(self.rows, scene="kernel sweep", car=self.large["car"]), key=lambda row: row["ms_best"])
        ns = 1e6 * fastest["ms_best"] / fastest["tets"]
        ms, tets = self.sweep(1)
        used = f"; {number(1e6 * ms / tets)} in a tick, with moduli and mixing" if ms else ""
        self.add("ns per tet per sweep, 1 thread", "≤ 10", f"{number(ns)} ({fastest['car']}, {fastest['method']}){used}",
                 (1e6 * ms / tets if ms else ns) <= 10)
        twice = [(a["ms_best"] / b["ms_best"], b["car"]) for b in pick(self.all, threads=2, iterations=DEFAULT, scene="wall")
                 for a in self.rows if all(a[key] == b[key] for key in ("scene", "car", "method", "iterations"))]
        said = ", ".join(f"{number(times)} x ({car})" for times, car in twice)
        beside = {row["threads"]: row["ms_best"] for row in pick(self.all, scene="side by side")}
        if beside:
            said += f"; two cars that share nothing, each on its own thread: {number(beside[1] / beside[2])} x"
        self.add("speed of two threads over one, whole tick", "≥ 1.8 x", said, min(twice)[0] >= 1.8 if twice else None)
        ticks = [row for row in pick(self.all, method="nodal", iterations=DEFAULT, scene="wall") if 4000 < row["nodes"] < 6000]
        for row in sorted(ticks, key=lambda row: -row["threads"])[:1]:
            self.add("whole tick of a crashing car of 5k nodes, 2 threads", "≤ 4 ms", f"{number(row['ms_best'])} "
                     f"({number(row['ms_median'])}) ms on {row['threads']:.0f} thread(s), {row['nodes']:,.0f} nodes",
                     row["ms_best"] <= 4)
        untouched = max(pick(self.rows, scene="untouched"), key=lambda row: row["ms_best"])
        self.add("a car that nothing touches", "≤ 1 µs", f"{number(1e3 * untouched['ms_best'])} µs",
                 untouched["ms_best"] <= 1e-3)

    def physics(self):
        steps = [row for row in self.rows if "sub-steps" in row["method"] and row["car"] == self.car]
        if steps:
            crush = [row["crush_mm"] for row in steps]
            text = " / ".join(f"{value:.0f}" for value in crush)
            self.add("residual crush in a wall crash, by number of sub-steps a tick", "within 3 %",
                     f"{text} mm at 4 / 8 / 16 / 32 ({self.car}, 50 km/h)", max(crush) <= 1.03 * min(crush))
        energy = [row for row in pick(self.rows, method="nodal", iterations=DEFAULT) if row["energy_ratio"] > 0]
        worst = max(energy, key=lambda row: abs(row["energy_ratio"] - 1))
        self.add("energy balance at the default", "≤ 2 %", f"{100 * (worst['energy_ratio'] - 1):+.2f} % at worst "
                 f"({worst['car']}, {worst['scene']})", abs(worst["energy_ratio"] - 1) <= 0.02)
        pushes = [row for row in pick(self.rows, scene="push in 1 tick")]
        if pushes:
            def apart(row):
                forty = pick(self.rows, scene="push in 40 ticks", car=row["car"])[0]
                return 100 * abs(row["crush_mm"] / forty["crush_mm"] - 1)
            crush, shape = max(map(apart, pushes)), max(row["error_percent"] for row in pushes)
            self.add("a wall moves in by 0.40 m in one tick, compared with forty ticks", "within 3 %",
                     f"crush differs by {number(crush)} %, surface by {number(shape)} % rms", max(crush, shape) <= 3)

    def bake(self):
        car = (3674, 50000)
        if car not in self.runs.cars:
            self.add("whole loop of table 6.9, 50k nodes", "≤ 2 ms", None)
            return
        loop = best(self.runs("loop", car, self.runs.threads))
        self.add("whole loop of table 6.9, 50k nodes", "≤ 2 ms",
                 f"{number(loop)} ms a car with `classic`, {self.runs.threads} cars on {self.runs.threads} threads", loop <= 2)
        made = best(map_and_constrain(self.runs, car, self.runs.threads))
        load = best(self.runs("load", car))
        self.add("colouring, constraints and skin at bake, 50k nodes", "≤ 0.3 s",
                 f"{number(made)} ms for constraints and skin, {number(load)} ms for loading with colouring", made + load <= 300)

    def stability(self):
        cells = [row for row in self.cells if row["method"] == "nodal"]
        if not cells:
            return
        random = [row for row in cells if row["start"].startswith(stability.RANDOM)]
        plates = [row for row in cells if "plate" in row["start"]]
        starts = [row for row in cells if row not in random and row not in plates]
        lost = [row["start"] + " (" + row["outcome"] + ")" for row in starts if row["outcome"] != "recovered"]
        self.add("hostile starts from which the car recovers", "all", f"{len(starts) - len(lost)} of {len(starts)}" + (": not " + "; ".join(lost)
                                                                                                  if lost else ""), not lost)
        bad = [row for row in random if row["outcome"] in ("exploded", "not finite")]
        self.add("random scenes that end non-finite or exploded", "0", f"{len(bad)} of {len(random)}", not bad)
        held = [int(re.search(r"(\d+) m/s", row["start"])[1]) for row in plates if row["outcome"] == "recovered"]
        self.add("contact of a 2 cm plate", "holds at 300 m/s", f"holds at {', '.join(map(str, sorted(set(held))))} m/s" if held else
                 "none held",
                 300 in held and len(held) == len(plates))

    def others(self):
        sets, dents = self.outside.sets(), self.outside.dents()
        self.add("plastic set of the bar, yield 0.02", "each within 1 %", ", ".join(
            f"{100 * off:+.2f} % at {sweeps:.0f}" for sweeps, off in sets) + " sweeps" if sets else None,
            all(abs(off) <= 0.01 for _, off in sets) if sets else None)
        worst = {case: max((off for name, off in dents if name == case), key=abs) for case in dict(dents)}
        self.add("permanent dent against CalculiX, three cases", "within 10 %", ", ".join(
            f"{case} {100 * off:+.1f} %" for case, off in worst.items()) + " at worst" if worst else None,
            all(abs(off) <= 0.1 for off in worst.values()) if worst else None)
        pairs = [(a["hash"], b["hash"]) for b in self.all if b["threads"] > 1 for a in self.rows
                 if all(a[key] == b[key] for key in ("scene", "car", "method", "iterations"))]
        same = sum(a == b for a, b in pairs)
        self.add("same bits on any number of threads, with vector or scalar instructions", "yes", f"{same} of {len(pairs)} plays on more threads end with "
                 "the same hash as on one thread; the tests compare vector with scalar instructions", same == len(pairs) if pairs else None)

    def text(self):
        for part in (self.errors, self.peers, self.speed, self.physics, self.bake, self.stability, self.others):
            part()
        return table(["what", "goal", "measured, best (median)", "met"], self.lines)


def page(all_rows, folder, quick):
    rows = pick(all_rows, threads=1)
    car = rows[0]["car"]
    peers = peer_rows(folder)
    draw_frontier(rows, peers, car, folder / "chart.png")
    draw_iterations(rows, folder / "iterations.png")
    slopes = draw_nodes(rows, folder / "nodes.png")
    yield "# Accuracy and speed, measured"
    yield (f"Machine: {rows[0]['machine']}. The figures were measured at commit {rows[0]['commit']}; this page was written at "
           f"commit {commit()}. Times are processor time of one thread, unless a section says otherwise. The error is the rms "
           "distance of the surface's vertices from the converged result of the same method, in % of the largest displacement "
           "(bench/chart.cpp says how it is measured).")
    load = max((context["load_avg"][0] for context in Runs(sorted((folder / "cars").glob("*.json"))).contexts), default=0)
    if load > 1.5:  # the benchmark's own thread counts as 1
        yield (f"**Other programs also used the machine (load {load:.1f}), and shared its caches. So wall times are too high; "
               "all times on more than one thread are wall times.**")
    if quick:
        left = ["all baselines except `classic` and xpbd", "these two on the pole, in the elastic push and beyond 100 iterations",
                "errors of cars of more than 12,000 nodes", "980 of 1,000 random scenes, and long rubbing",
                "five of the thesis's eight combinations", "peers, and dents beside CalculiX (if the page shows them, they are "
                "from an earlier full run)"]
        yield "**This was a quick run. It left out: " + "; ".join(left) + ".**"
    yield "![Error against time](chart.png)"
    yield (f"The table gives the milliseconds a tick that each method needs to come within {WANTED} % of its converged result, on "
           f"the car {car}: the best time, the median in brackets, and after \"at\" the number of iterations.\n")
    yield times_to_one_percent(rows, car)
    yield ("In the crashes the other methods are compared with `nodal, path given`, because they all follow the same given path. "
           "If a method never comes within 1 %, the result that its error is measured against is not converged either, so the "
           "error in the table is too small.")
    if peers:
        yield (f"The elastic push of bench/peers runs on {peers[0]['mesh']}, {peers[0]['nodes']:,.0f} nodes. It moves nodes at the "
               "nose by 0.20 m in twelve steps of 1/60 s, quasi-statically. The programs took turns. The table gives the wall "
               "time of a step in milliseconds, best (median), at the fewest iterations from which on the error stays within 1 % "
               "of the method's own converged result. The second column says by how much this result changes when its "
               "iterations double. An iteration of crumple is a sweep; its model names the number of sub-steps in a step.\n")
        yield peers_to_one_percent(peers)
    yield "## What the default solver must reach"
    yield Bars(all_rows, folder, car).text()
    yield "## Solver error, time steps, mesh"
    yield ("All rows show `nodal` at its default. If a row names sub-steps, its error is measured against 64 sub-steps of 24 "
           "sweeps, so it contains the error of the time steps and of the solver. Compare the cars to see how crush and time "
           "change with the mesh.\n")
    yield accuracy(rows)
    yield "![Error against sweeps](iterations.png)"
    if pick(rows, scene="head-on"):
        yield "`head-on` is a car that meets its like at 50 km/h each: the error of the first car, the time of both."
    outside = Outside(folder)
    if outside.ours:
        outside.draw(folder / "outside.png")
        yield "## Dents beside CalculiX"
        yield ("CalculiX and crumple compute the same meshes with the same moduli, yield and hardening. CalculiX computes von Mises "
               "flow, and crumple a crushable foam. So only the residual deformations must agree. On the bar, and nearly in the "
               "tube's walls, the forces must agree too (bench/peers/calculix.py gives the reasons). bench/peers/calculix.csv has "
               "all figures, and those of MuJoCo's bar.\n")
        yield outside.text()
        yield "![Dents and forces beside CalculiX](outside.png)"
    cars = read(folder / "scene.csv")
    if cars:
        scene.draw(cars, folder / "scene.png")
        yield "## Cars in one tick, against accuracy\n\n![Cars in a tick of 1/60 s against accuracy](scene.png)"
        yield scene.text(cars)
    yield "## Time against nodes"
    yield ("Slopes of the lines on logarithmic axes: " +
           "; ".join(f"{scene} {value:.2f}" for scene, value in slopes.items() if value is not None) + ".")
    yield "![Time against nodes](nodes.png)"
    if draw_threads(all_rows, folder / "threads.png"):
        yield "## Time against threads\n\n![Time against threads](threads.png)"
    yield "## One pass over all tets, one thread"
    yield kernels(rows)
    cells = folder / "stability.csv"
    if cells.exists():
        stability.draw(*stability.read_cells(cells), folder / "stability.png")
        yield "## Stability\n\n![Every method against every hostile start](stability.png)"
    if (folder / "pairs.md").exists():
        yield "## Cars that hit each other\n\n" + re.sub(r"^## ", "### ", (folder / "pairs.md").read_text().strip(), flags=re.M)
    wire = read_codecs(folder / "codec.csv")
    if wire:
        yield "## Bits on the network\n\n![Bits per vertex and frame](codec.png)"
        yield wire
    if (folder / "tables.md").exists():
        yield re.sub(r"^#", "##", (folder / "tables.md").read_text(), flags=re.M)


def read_codecs(path):
    """Returns the rows of codec.py at half a millimetre, and of surface level 1."""
    if not path.exists():
        return ""
    with open(path) as file:
        rows = [row for row in csv.DictReader(file) if (float(row["quantum_mm"]), row["codec"]) == (4, "nodes, packed") or
                float(row["quantum_mm"]) == 0.5]
    columns = {"car": "car", "scene": "scene", "codec": "codec", "quantum_mm": "quantum, mm", "bits": "bits per vertex and frame",
               "worst_bits": "worst frame", "most_mm": "largest error, mm", "encode_ms": "encode, ms per 20,000 vertices", "decode_ms": "decode, ms"}
    lines = ["| " + " | ".join(columns.values()) + " |", "|" + "---|" * len(columns)]
    order = sorted(rows, key=lambda row: (row["car"], row["scene"], float(row["bits"])))
    lines += ["| " + " | ".join(row[name] or "–" for name in columns) + " |" for row in order]
    text = ("Rows with `packed` count whole messages; the others count only the numbers. Far viewers receive `packed` with a quantum "
            "of 4 mm, every sixth tick (bench/codec.py).")
    return text + "\n\n" + "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    rows = read(options.folder / "chart.csv")
    if not rows:
        raise SystemExit(f"{options.folder}/chart.csv: it is missing or has no rows; write it with crumple_chart.")
    (options.folder / "page.md").write_text("\n\n".join(page(rows, options.folder, options.quick)) + "\n")


if __name__ == "__main__":
    main()
