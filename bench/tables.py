# Prints tables 6.1 to 6.9 of Ille 2020 beside ours, as Markdown. In: thesis.csv in this folder, and one or more JSON files of
# crumple_bench. Times are ms. Ours are the best of the repetitions, with their median in brackets.
import csv
import json
import os
import pathlib
import statistics
import subprocess
import sys

here = pathlib.Path(__file__).parent
MEDIUM = (3674, 5000)  # the combination of tables 6.1, 6.3 and 6.6


def read_thesis():
    lines = [line for line in (here / "thesis.csv").open() if not line.startswith("#")]
    return {(r["table"], int(r["surface"]), int(r["nodes"]), r["column"]): float(r["value"]) for r in csv.DictReader(lines)}


class Runs:
    """Reads the measurements of crumple_bench by room, car (surface, nodes) and threads."""

    def __init__(self, files):
        self.runs, self.contexts = {}, []
        for file in files:
            report = json.loads(pathlib.Path(file).read_text())
            self.contexts.append(report["context"])
            for run in report["benchmarks"]:
                if run["run_type"] != "iteration":
                    continue
                room, car, *rest = run["name"].split("/")
                surface, nodes = map(int, car.split("-"))
                threads = int(rest[0]) if rest and rest[0].isdigit() else 1
                self.runs.setdefault((room, surface, nodes, threads), []).append(run)
        self.cars = sorted({key[1:3] for key in self.runs})
        self.threads = max((key[3] for key in self.runs), default=1)

    def __call__(self, room, car, threads=1, field="real_time"):
        return [run[field] for run in self.runs.get((room, *car, threads), [])]

    def fact(self, room, car, field, threads=1):
        values = self(room, car, threads, field)
        return values[0] if values else None


def number(value):
    if value is None:
        return "–"
    if value == 0:
        return "0"
    digits = max(0, 2 - int(f"{abs(value):e}".split("e")[1]))
    return f"{value:,.{digits}f}"


def ours(values):
    return f"**{number(min(values))}** ({number(statistics.median(values))})" if values else "–"


def best(values):
    return min(values) if values else None


def add(*lists):
    """Adds up runs that belong together, repetition by repetition."""
    return [sum(values) for values in zip(*lists)] if all(lists) else []


def ratio(a, b):
    return f"{number(a / b)} x" if a and b else "–"


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows]) + "\n"


def initialization(runs, thesis, name, title, threads):
    """Tables 6.1, 6.3, 6.6: one car, by step."""
    columns = ["reading", "constraints", "mapping", "total"]
    steps = {
        "reading": add(runs("read_surface", MEDIUM), runs("read_tets", MEDIUM)),
        "constraints": runs("constraints", MEDIUM, threads),
        "mapping": runs("skin", MEDIUM, threads),
    }
    steps["total"] = add(*steps.values())
    rows = [["thesis"] + [number(thesis[name, *MEDIUM, c]) for c in columns], ["ours"] + [ours(steps[c]) for c in columns]]
    return f"### {name} {title}\n" + table(["", "file reading", "constraint generation", "barycentric mapping", "total"], rows)


def map_and_constrain(runs, car, threads):
    return add(runs("constraints", car, threads), runs("skin", car, threads))


def table_62(runs, thesis):
    rows = []
    for car in runs.cars:
        serial, parallel = (map_and_constrain(runs, car, threads) for threads in (1, runs.threads))
        se, pa = (thesis["6.2", *car, c] for c in ("se", "pa"))
        rows.append([*car, number(se), ours(serial), number(pa), ours(parallel), ratio(se, best(serial)),
                     ratio(pa, best(parallel))])
    head = ["surface", "nodes", "se thesis", "se ours", "pa thesis", "pa ours", "se gain", "pa gain"]
    return "### 6.2 Initialization, serial (se) and parallel (pa)\n" + table(head, rows)


def table_64(runs, thesis):
    rows = []
    for car in runs.cars:
        count = runs.fact("load", car, "vertices")
        found, inside = (runs.fact("skin", car, field) for field in ("coincident", "contained"))
        rows.append([*car, number(thesis["6.4", *car, "quota"]), f"{found / count:.2f}", f"{inside / count:.2f}",
                     f"{1 - (found + inside) / count:.2f}"])
    head = ["surface", "nodes", "on a node, thesis", "on a node, ours", "inside a tet", "on the nearest tet"]
    return "### 6.4 Share of the surface vertices that are mapped directly to a node\n" + table(head, rows)


def table_65(runs, thesis):
    rows = []
    for car in runs.cars:
        parallel, whole = map_and_constrain(runs, car, runs.threads), runs("assemble", car, runs.threads)
        pa, pd = (thesis["6.5", *car, c] for c in ("pa", "pd"))
        rows.append([*car, number(pa), number(pd), ours(parallel), ours(whole), ratio(pd, best(parallel)),
                     ratio(pd, best(whole))])
    head = ["surface", "nodes", "pa thesis", "pd thesis", "constraints + mapping, ours", "whole assembly, ours", "gain",
            "gain, whole"]
    return "### 6.5 Parallel initialization without (pa) and with (pd) direct mapping\n" + table(head, rows)


def table_67(runs, thesis):
    rows = []
    for car in runs.cars:
        pd, dd = (thesis["6.7", *car, c] for c in ("pd", "dd"))
        whole, load = runs("assemble", car, runs.threads), runs("load", car)
        megabytes = runs.fact("load", car, "bytes") / 1e6
        rows.append([*car, number(pd), ours(whole), number(dd), ours(load), ratio(dd, best(load)), number(megabytes)])
    head = ["surface", "nodes", "generated (pd), thesis", "generated, ours", "loaded (dd), thesis", "loaded, ours", "gain",
            "file, MB"]
    return "### 6.7 Initialization generated (pd) or loaded from a file (dd)\n" + table(head, rows)


def loop(runs, thesis, name, title, threads):
    """Tables 6.8, 6.9: every car, by room."""
    rooms = {"cp": "contacts", "cs": "classic_1", "bc": "update", "total": "loop"}
    rows = []
    for car in runs.cars:
        row = list(car)
        for column, room in rooms.items():
            row += [number(thesis[name, *car, column]), ours(runs(room, car, threads))]
        rows.append(row + [ratio(thesis[name, *car, "total"], best(runs("loop", car, threads)))])
    head = ["surface", "nodes"] + [f"{c} {who}" for c in rooms for who in ("thesis", "ours")] + ["gain"]
    return f"### {name} {title}\n" + table(head, rows)


def classic_ns(runs, car, further):
    """Returns ns per constraint of the first iteration, which also changes the rest values, or of a further iteration."""
    constraints = runs.fact("load", car, "edges") + runs.fact("load", car, "tets")
    one, five = best(runs("classic_1", car)), best(runs("classic_5", car))
    if not constraints or not one or not five:
        return None
    return ((five - one) / 4 if further else one) * 1e6 / constraints


def beyond(runs):
    rows = []
    for car in runs.cars:
        tets, steps = runs.fact("load", car, "tets"), runs.fact("nodal_6", car, "substeps")
        sweep = (best(runs("nodal_6", car)) - best(runs("nodal_2", car))) / 4 / steps
        flow, contacts = (best(runs("nodal_6", car, 1, f)) for f in ("flow_ms", "contacts_ms"))
        rows.append([*car, f"{tets:,.0f}", f"{tets + runs.fact('load', car, 'edges'):,.0f}",
                     number(classic_ns(runs, car, False)),
                     number(classic_ns(runs, car, True)), number(sweep * 1e6 / tets if sweep > 0 else None), number(flow * 1e6 / tets),
                     number(contacts * 1e3), number(best(runs("tick", car))), number(best(runs("delta", car)) * 1e3),
                     f"{runs.fact('delta', car, 'bytes'):,.0f}", number(best(runs("keyframe", car)) * 1e3)])
    head = ["surface", "nodes", "tets", "constraints", "classic, ns per constraint, first iteration", "classic, ns per constraint, further iterations",
            "nodal, ns per tet and sweep", "flow, ns per tet and sub-step", "contacts, µs per sub-step",
            "nodal tick at the default, ms", "delta, µs", "delta, bytes", "keyframe, µs"]
    return "### Beyond the thesis: one car, one thread, best\n" + table(head, rows)


def goals(runs):
    rows = []

    def goal(what, car, worst, limit, thesis, unit):
        rows.append([what, f"{car[0]} x {car[1]}", f"{number(worst)} {unit}", f"{limit} {unit}", thesis,
                     "–" if worst is None else "yes" if worst <= limit else "**no**"])

    for car in [car for car in runs.cars if car[1] == 50000]:
        goal("loading, median", car, statistics.median(runs("load", car)), 50, "782 ms", "ms")
        goal("constraints + mapping, parallel, worst single run", car, max(map_and_constrain(runs, car, runs.threads)), 1000,
             "3,300 ms", "ms")
        goal("classic per constraint, serial, first iteration", car, classic_ns(runs, car, False), 27, "27 ns", "ns")
    head = ["figure", "car", "ours", "wanted, at most", "thesis (3674 x 50000)", "met"]
    return "### Goals at ~50,000 nodes\n" + (table(head, rows) if rows else "No car of 50,000 nodes was measured.\n")


def processor():
    for line in open("/proc/cpuinfo"):
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return "unknown processor"


def commit():
    git = lambda *arguments: subprocess.run(["git", "-C", here, *arguments], capture_output=True, text=True).stdout.strip()
    name = git("rev-parse", "--short", "--verify", "--quiet", "HEAD") or "none"
    return name + (" with changes" if git("status", "--porcelain") else "")


def heading(runs):
    first = runs.contexts[0]
    load = max(context["load_avg"][0] for context in runs.contexts)
    cores = os.cpu_count()
    lines = [
        "# Tables 6.1 to 6.9 of the thesis, and ours",
        f"{first['date'][:10]}, commit {commit()}, {processor()}, {cores} cores; parallel: {runs.threads} threads. "
        "Thesis: Intel Core i5-8500, 3.00 GHz, 6 cores.",
        "Times are in ms. Our figures are the **best** (median) of the repetitions. Serial parts of the loop (6.8 and below) are "
        "processor time; all other figures are wall time.",
    ]
    if load > 1.5:  # the benchmark's own thread counts as 1
        lines.append(f"**Other programs also used the machine: load {load:.1f} on {cores} cores. So wall times are too high, "
                     "those of parallel parts most.**")
    missing = [car for car in [(s, n) for s in (1259, 3674) for n in (1000, 5000, 10000, 50000)] if car not in runs.cars]
    if missing:
        lines.append("Not measured: " + ", ".join(f"{s} x {n}" for s, n in missing) + ".")
    return "\n\n".join(lines) + "\n"


def main():
    runs, thesis = Runs(sys.argv[1:]), read_thesis()
    parts = [heading(runs)]
    if MEDIUM in runs.cars:
        parts.append("In 6.1, 6.3 and 6.6 our program reads the surface from OBJ and the tets from Medit text. A Python process "
                     f"reads the tets in {number(best(runs('read_tets', MEDIUM)))} ms, and most of this time passes before it "
                     "has started. Our mapping always uses a search tree and direct mapping, so 6.3 and 6.6 show the same "
                     "measurement.")
        parts.append(initialization(runs, thesis, "6.1", "Serial initialization, 3674 x 5000", 1))
    parts.append("In 6.2 and 6.5 our figures are constraints + mapping; the thesis's figures also contain about 40 ms of file "
                 "reading. The whole assembly also orders nodes and vertices, paints regions, writes the file, reads it back and "
                 "checks it.")
    parts.append(table_62(runs, thesis).replace("2,910", "2,910 (sic: 29,100)"))
    if MEDIUM in runs.cars:
        parts.append(initialization(runs, thesis, "6.3", "Parallel initialization, 3674 x 5000", runs.threads))
    parts += [table_64(runs, thesis), table_65(runs, thesis)]
    if MEDIUM in runs.cars:
        parts.append(initialization(runs, thesis, "6.6", "Parallel initialization with direct mapping, 3674 x 5000",
                                    runs.threads))
    parts.append(table_67(runs, thesis))
    parts.append("cp: collision projection (coarse test and contacts of a tick); cs: constraint solving, one iteration of "
                 "`classic`; bc: barycentric update of the surface. Our total is the loop as the server runs it, with the work "
                 "between these three. In 6.9 the thesis spreads one car over its threads; we put one car on each thread and "
                 "divide the time by the number of cars.")
    parts.append(loop(runs, thesis, "6.8", "Deformation loop, serial", 1))
    parts.append(loop(runs, thesis, "6.9", f"Deformation loop, parallel ({runs.threads} threads)", runs.threads))
    parts += [beyond(runs), goals(runs)]
    print("\n".join(parts))


if __name__ == "__main__":
    main()
