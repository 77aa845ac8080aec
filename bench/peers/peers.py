"""Measures the times of the peers and ours, and each one's distance from its own converged result: peers.csv, peers_convergence.csv.

    peers.py [--quick] FOLDER CAR

The program writes the two files to FOLDER. For every figure a separate process (play.py) plays the scene of scene.py, one process at
a time. Peers that are compared run alternately, so that all see the same state of the machine. The time of a play is the mean time
of a step without the first one, which also touches memory and fills caches. Best and median are over several plays.
  peers.csv              the time of one iteration on a grid of 234,960 tets: the time of a step with three times as many
                         iterations, minus the time with `iterations_per_step`, divided by the difference of the iterations
  peers_convergence.csv  the error of each number of iterations against the largest number, on CAR (a baked car of a few thousand
                         nodes). answer_moves_percent: the distance of the result with half as many iterations. Rows with more
                         than one play are the fastest within 1 %, on one and on two threads.
A row with `error` in its note has no figures, because the peer cannot play it. The note says why.
"""

import csv
import json
import os
import pathlib
import pickle
import platform
import statistics
import subprocess
import sys
import tempfile

import numpy as np

import scene as play

springs, cells = "edges+tets", "tets"
# Peer, model, the constraints that one iteration solves once, the number of iterations for the converged result, its unit. For each
# peer these are the models that may be its fastest. Left out after one measurement on a hull of 2,428 nodes: pyPBD's XPBD of edges
# and volumes (33 times slower to 1 % than its PBD) and XPBD-FEM (never within 1 %), Rapier's corotational and neo-Hookean
# constraints (17 and 9 times slower than edges and volumes). Jolt stops at 500: at sub-steps of 8 us its float positions near 2 m
# round the push itself by 1 %. PBD-FEM does not settle: its results at 100 to 1,600 iterations are 0.2 to 0.4 % apart.
peers = [
    ("crumple", "nodal, 1 sub-step", cells, 200, "sweep"),
    ("crumple", "nodal, 2 sub-steps", cells, 200, "sweep"),
    ("jolt", "XPBD edge+volume", springs, 500, "sub-step"),
    ("pypbd", "PBD edge+volume", springs, 200, "iteration"),
    ("pypbd", "PBD-FEM", cells, 100, "iteration"),
    ("rapier", "edge+volume", springs, 100, "sub-step"),
    ("rapier", "corotational, FEM", cells, 50, "sub-step"),
    ("mujoco", "implicit", cells, 20, "sub-step"),
]
quick_peers = [("crumple", "nodal, 1 sub-step"), ("jolt", "XPBD edge+volume"), ("pypbd", "PBD edge+volume"),
               ("rapier", "edge+volume")]
counts = [1, 2, 3, 4, 6, 8, 10, 15, 20, 30, 40, 50, 70, 100, 200, 500, 1000]
wanted, enough = 1, 0.2  # % of the largest displacement: the wanted error, and the error at which a curve may end
timeout = 300  # s for one play


def machine():
    name = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if "model name" in line), platform.processor())
    return f"{name}, {len(os.sched_getaffinity(0))} cores"


def run(scene, peer, model, threads, iterations):
    """Plays once. Returns its JSON and the final positions, or a sentence about the error."""
    with tempfile.TemporaryDirectory() as folder:
        source, out = f"{folder}/scene", f"{folder}/out"
        with open(source, "wb") as stream:
            pickle.dump(scene, stream)
        command = [sys.executable, pathlib.Path(__file__).with_name("play.py"), peer, model, str(threads), str(iterations)]
        try:
            done = subprocess.run([*command, source, out], capture_output=True, text=True, timeout=timeout, cwd=folder)
        except subprocess.TimeoutExpired:
            return f"error: not done after {timeout} s"
        if done.returncode:
            return "error: " + ((done.stderr.strip() or f"ended by signal {-done.returncode}").splitlines()[-1])
        return json.loads(done.stdout.splitlines()[-1]), np.fromfile(out, "<f4").reshape(-1, 3)


def milliseconds(play):
    return statistics.mean(play[0]["ms"][1:])


def speed_rows(scene, rounds, chosen):
    few, many = 4, 12
    jobs = [(*each, threads) for each in chosen for threads in (1, 2)]
    plays = {job: [] for job in jobs}
    for _ in range(rounds):
        for job in jobs:
            if not any(isinstance(answer, str) for pair in plays[job] for answer in pair):
                plays[job].append([run(scene, *job[:2], job[-1], count) for count in (few, many)])
    for (peer, model, solved, _, unit, threads), pairs in plays.items():
        solves = len(scene.tet) + (len(scene.edge) if solved == springs else 0)
        row = dict(peer=peer, model=model, mesh=scene.name, nodes=len(scene.node), tets=len(scene.tet), edges=len(scene.edge),
                   threads=threads, iterations_per_step=few, iteration_is=unit, solved_per_iteration=solves)
        failed = [answer for pair in pairs for answer in pair if isinstance(answer, str)]
        if failed:
            yield row | dict(note=failed[0])
            continue
        steps = [milliseconds(pair[0]) for pair in pairs]
        between = [(milliseconds(pair[1]) - milliseconds(pair[0])) / (many - few) for pair in pairs]
        least = (min(milliseconds(pair[1]) for pair in pairs) - min(steps)) / (many - few)
        yield row | dict(version=pairs[0][0][0]["version"], build_ms=min(pair[0][0]["build_ms"] for pair in pairs),
                         best_ms=min(steps), median_ms=statistics.median(steps), best_ms_per_iteration=least,
                         median_ms_per_iteration=statistics.median(between), best_ns_per_solve=1e6 * least / solves,
                         note=f"{rounds} rounds of {play.steps} steps")


class Curve:
    """Plays one model of one peer on one scene: its converged result, and each number of iterations on each number of threads."""

    def __init__(self, scene, peer, model, _, largest, unit):
        self.scene, self.peer, self.model, self.unit = scene, peer, model, unit
        self.answer, self.failed, self.plays = None, {}, {}
        half = self.play(1, largest // 2)
        self.answer = self.play(1, largest)
        if self.answer is None:
            return
        self.largest, self.scale = largest, np.linalg.norm(self.answer[1] - scene.node, axis=1).max()
        self.moves = self.error(half) if half else float("nan")
        for threads in (1, 2):
            for count in counts:
                found = count < largest // 2 and self.play(threads, count)
                if found and self.error(found) <= enough:
                    break

    def play(self, threads, count):
        found = run(self.scene, self.peer, self.model, threads, count)
        if isinstance(found, str):
            self.failed[threads, count] = found
            return None
        self.plays.setdefault((threads, count), []).append(found)
        return found

    def error(self, found, norm=lambda apart: np.sqrt((apart ** 2).mean())):
        return 100 * norm(np.linalg.norm(found[1] - self.answer[1], axis=1)) / self.scale

    def within(self, threads):
        """Returns the first number of iterations from which on all errors are small enough."""
        tried = [count for t, count in sorted(self.plays) if t == threads and count < self.largest]
        return next((n for k, n in enumerate(tried) if all(self.error(self.plays[threads, m][0]) <= wanted
                                                           for m in tried[k:])), None)

    def rows(self):
        row = dict(peer=self.peer, model=self.model, mesh=self.scene.name, nodes=len(self.scene.node), iteration_is=self.unit)
        for (threads, count), why in self.failed.items():
            yield row | dict(threads=threads, iterations_per_step=count, note=why)
        if self.answer is None:
            return
        for (threads, count), plays in sorted(self.plays.items()):
            n = self.within(threads)
            times = [milliseconds(each) for each in plays]
            yield row | dict(version=plays[0][0]["version"], threads=threads, iterations_per_step=count, reference=self.largest,
                             answer_moves_percent=self.moves, rms_error_percent=self.error(plays[0]),
                             max_error_percent=self.error(plays[0], np.max), best_ms=min(times),
                             median_ms=statistics.median(times), plays=len(plays),
                             note=f"within {wanted} % from {n} on" if n else f"never within {wanted} %")


def convergence_rows(scene, rounds, chosen):
    curves = []
    for each in chosen:
        curves.append(Curve(scene, *each))
        print(*each[:2], "found", flush=True)
    finals = [(curve, threads, curve.within(threads)) for curve in curves if curve.answer for threads in (1, 2)]
    for _ in range(rounds):
        for curve, threads, count in finals:
            if count:
                curve.play(threads, count)
    for curve in curves:
        yield from curve.rows()


def write(name, columns, rows):
    place = machine()
    with open(name, "w", newline="") as stream:
        out = csv.DictWriter(stream, columns + ["machine", "note"], restval="")
        out.writeheader()
        for row in rows:
            short = {key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()}
            out.writerow(short | dict(machine=place))
            stream.flush()
            print(*(f"{key}={value}" for key, value in short.items()), flush=True)


def main(arguments):
    quick = "--quick" in arguments
    folder, car = [a for a in arguments if a != "--quick"]
    chosen = [peer for peer in peers if peer[:2] in quick_peers or not quick]
    folder = pathlib.Path(folder)
    write(folder / "peers.csv", ["peer", "version", "model", "mesh", "nodes", "tets", "edges", "threads", "iterations_per_step",
                                 "iteration_is", "solved_per_iteration", "build_ms", "best_ms", "median_ms",
                                 "best_ms_per_iteration", "median_ms_per_iteration", "best_ns_per_solve"],
          speed_rows(play.grid((89, 24, 22)), 3, [peer for peer in peers if peer[:2] in quick_peers]))
    write(folder / "peers_convergence.csv", ["peer", "version", "model", "mesh", "nodes", "threads", "iterations_per_step",
                                             "iteration_is", "reference", "answer_moves_percent", "rms_error_percent",
                                             "max_error_percent", "best_ms", "median_ms", "plays"],
          convergence_rows(play.car(car), 3 if quick else 7, chosen))


if __name__ == "__main__":
    main(sys.argv[1:])
