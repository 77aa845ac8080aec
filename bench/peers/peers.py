"""Times the peers and finds how far each is from its own converged answer: peers.csv and peers_convergence.csv.

    peers.py [--quick] FOLDER CAR...

FOLDER takes the two files; the first CAR (a baked car of a few thousand nodes) is the one for convergence. Every row of both
comes from playing scene.py's scene in a process of its own (play.py), one at a time. A row with `error` in its note has no
figures: the peer cannot play it, and the note says why.
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
# Peer, model, what one iteration solves once, iterations a step when timed, largest count for the converged answer, its unit.
# Jolt stops at 500: at sub-steps of 8 us its float positions near 2 m round the push itself by 1 %.
peers = [
    ("jolt", "XPBD edge+volume", springs, 5, 500, "sub-step"),
    ("pypbd", "PBD edge+volume", springs, 5, 2000, "iteration"),
    ("pypbd", "XPBD edge+volume", springs, 5, 2000, "iteration"),
    ("pypbd", "PBD-FEM", cells, 5, 2000, "iteration"),
    ("pypbd", "XPBD-FEM", cells, 5, 2000, "iteration"),
    ("rapier", "edge+volume", springs, 5, 1000, "sub-step"),
    ("rapier", "corotational", cells, 5, 1000, "sub-step"),
    ("rapier", "neo-hookean", cells, 5, 1000, "sub-step"),
    ("rapier", "corotational, FEM", cells, 5, 1000, "sub-step"),
    ("mujoco", "implicit", cells, 1, 100, "sub-step"),
]
quick_peers = [("jolt", "XPBD edge+volume"), ("pypbd", "PBD edge+volume"), ("rapier", "edge+volume")]
counts = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000]
timeout = 300  # s for one play


def machine():
    name = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if "model name" in line), platform.processor())
    return f"{name}, {len(os.sched_getaffinity(0))} cores"


def run(scene, peer, model, threads, iterations):
    """The answer of one play: its JSON and the final positions; or a sentence."""
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


def speed_rows(scene, repeats, chosen):
    for peer, model, solved, iterations, _, unit in chosen:
        for threads in (1, 2):
            solves = len(scene.tet) + (len(scene.edge) if solved == springs else 0)
            row = dict(peer=peer, model=model, mesh=scene.name, nodes=len(scene.node), tets=len(scene.tet),
                       edges=len(scene.edge), threads=threads, iterations_per_step=iterations, iteration_is=unit,
                       solved_per_iteration=solves)
            runs = [run(scene, peer, model, threads, iterations) for _ in range(repeats)]
            if isinstance(runs[-1], str):
                yield row | dict(note=runs[-1])
                continue
            times = [ms for answer, _ in runs for ms in answer["ms"][1:]]  # the first step also touches memory
            best, median = min(times), statistics.median(times)
            per = 1e6 / iterations / solves
            yield row | dict(version=runs[0][0]["version"], build_ms=min(a["build_ms"] for a, _ in runs), best_ms=best,
                             median_ms=median, best_ms_per_iteration=best / iterations, best_ns_per_solve=best * per,
                             median_ns_per_solve=median * per, note=f"{repeats} runs of {play.steps} steps")


def convergence_rows(scene, threads, chosen):
    for peer, model, _, _, largest, unit in chosen:
        row = dict(peer=peer, model=model, mesh=scene.name, nodes=len(scene.node), threads=threads, iteration_is=unit)
        found = {n: run(scene, peer, model, threads, n) for n in counts if n <= largest}
        failed = {n: answer for n, answer in found.items() if isinstance(answer, str)}
        for n, answer in failed.items():
            yield row | dict(iterations_per_step=n, note=answer)
        found = {n: answer for n, answer in found.items() if n not in failed}
        if not found:
            continue
        reference = found[max(found)][1]
        scale = np.linalg.norm(reference - scene.node, axis=1).max()
        error = {n: 100 * np.linalg.norm(x - reference) / np.sqrt(len(x)) / scale for n, (_, x) in found.items()}
        worst = {n: 100 * np.linalg.norm(x - reference, axis=1).max() / scale for n, (_, x) in found.items()}
        spread = 100 * np.linalg.norm(reference - scene.node) / np.sqrt(len(reference)) / scale
        *earlier, last = sorted(found)
        within = next((n for k, n in enumerate(earlier) if all(error[m] <= 1 for m in earlier[k:])), None)
        verdict = f"within 1 % of its answer at {last} from {within} on" if within else \
            f"never within 1 % of its answer at {last}" + ("" if np.isfinite(error[last]) else ": not finite")
        for n in sorted(found):
            times = found[n][0]["ms"]
            yield row | dict(version=found[n][0]["version"], iterations_per_step=n, reference=last,
                             rms_displacement_percent=spread, rms_error_percent=error[n],
                             max_error_percent=worst[n], median_ms=statistics.median(times), best_ms=min(times), note=verdict)


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
    folder, *cars = [a for a in arguments if a != "--quick"]
    meshes = [play.car(path) for path in cars]
    if not any(len(mesh.node) > 40000 for mesh in meshes):
        meshes.append(play.grid((89, 24, 22)))  # 51,750 nodes, 234,960 tets
    if not quick:
        meshes.append(play.grid((29, 11, 11)))
    chosen = [peer for peer in peers if peer[:2] in quick_peers or not quick]
    folder = pathlib.Path(folder)
    write(folder / "peers.csv", ["peer", "version", "model", "mesh", "nodes", "tets", "edges", "threads", "iterations_per_step",
                                 "iteration_is", "solved_per_iteration", "build_ms", "best_ms", "median_ms",
                                 "best_ms_per_iteration", "best_ns_per_solve", "median_ns_per_solve"],
          (row for mesh in meshes for row in speed_rows(mesh, 2 if quick else 4, chosen)))
    write(folder / "peers_convergence.csv", ["peer", "version", "model", "mesh", "nodes", "threads", "iterations_per_step",
                                             "iteration_is", "reference", "rms_displacement_percent",
                                             "rms_error_percent", "max_error_percent", "best_ms",
                                             "median_ms"],
          convergence_rows(meshes[0], 2, chosen))


if __name__ == "__main__":
    main(sys.argv[1:])
