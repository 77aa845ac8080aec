"""Two equal cars that hit each other head-on, in Rapier's soft bodies and in ours: time of a tick, crush and restitution.

    pairs.py [--kmh 50] [--rounds 3] CAR...

Rapier is the only other engine that we know with plastic bodies, contact between them and friction. CAR is a baked car; both
engines get its tets, masses, modulus and yield strain. Rapier: corotational cells, plastic flow at once, its default number of
sub-steps (4) and three others. Its material does not harden, and its bodies have no rigid frame, so it is crushed much deeper: the
depth itself is no error, but how much it depends on the number of sub-steps is. Ours: `crumple_pairs CAR --scene head-on`,
default settings. One thread each, in turn; of the means of all ticks the least and the median count. Prints a table in Markdown.
"""

import argparse
import pathlib
import re
import statistics
import subprocess
import time

import numpy as np
import rapier3d as rp

import scene as play

program = pathlib.Path(__file__).resolve().parents[2] / "build/bench/crumple_pairs"
seconds, dt, gap, yield_strain = 0.35, 1 / 60, 0.1, 0.009


def rapier(car, speed, substeps):
    world = rp.PhysicsWorld(gravity=(0, 0, 0))
    world.set_num_threads(1)
    world.integration_parameters.dt = dt
    world.integration_parameters.num_solver_iterations = substeps
    material = rp.SoftBodyMaterial(young_modulus=play.young_modulus, poisson_ratio=0.0, plastic_yield=yield_strain,
                                   plastic_creep=1e6, plastic_max=10.0)
    nose = car.node[:, 0].max()
    outside = play.surface(car.tet).astype("u4")
    bodies = []
    for way in (1, -1):  # the second is the first one turned about z
        node = (car.node - [nose + gap / 2, 0, 0]) * [way, way, 1]
        builder = rp.SoftBodyBuilder(node).cells(car.tet.astype("u4")).surface(outside).material(material)
        builder = builder.cell_model(rp.SoftBodyCellModel.COROTATIONAL).masses(car.mass.tolist()).can_sleep(False)
        bodies.append(world.soft_bodies[world.add_soft_body(builder)])
        bodies[-1].particle_velocities = np.tile([way * speed, 0.0, 0.0], (len(node), 1))
    times = []
    for _ in range(round(seconds / dt)):
        begin = time.perf_counter()
        world.step()
        times.append(1e3 * (time.perf_counter() - begin))
    front, middle = car.node[:, 0] > nose - 0.15, np.abs(car.node[:, 0] - np.median(car.node[:, 0])) < 0.5
    length = car.node[front, 0].mean() - car.node[middle, 0].mean()
    crush, velocity = [], []
    for way, body in zip((1, -1), bodies):
        found = np.array(body.particle_positions)
        crush.append(1e3 * (length - way * (found[front, 0].mean() - found[middle, 0].mean())))
        velocity.append(np.average(np.array(body.particle_velocities)[:, 0], weights=car.mass))
    return statistics.mean(times), max(times), crush, (velocity[1] - velocity[0]) / (2 * speed)


def crumple(path, kmh):
    text = subprocess.run([program, path, "--scene", "head-on", "--kmh", str(kmh)], check=True, capture_output=True, text=True)
    row = next(line for line in text.stdout.splitlines() if line.startswith("| head-on |"))
    cell = [[float(x) for x in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", each)] for each in row.split("|")[2:-1]]
    return *cell[-1], cell[0], (cell[1][1] - cell[1][0]) / 2


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("car", nargs="+")
    parser.add_argument("--kmh", type=float, default=50)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    print("| nodes a car | engine, sub-steps | ms a tick: least, median | slowest tick | crush of both, mm | restitution |")
    print("|---|---|---|---|---|---|")
    for path in options.car:
        car = play.car(path)
        engines = {f"Rapier, {count}": lambda count=count: rapier(car, options.kmh / 3.6, count) for count in (4, 8, 16, 32)}
        engines = {"crumple, default": lambda: crumple(path, options.kmh), **engines}
        plays = {name: [] for name in engines}
        for _ in range(options.rounds):
            for name, run in engines.items():
                plays[name].append(run())
        for name, found in plays.items():
            means = [each[0] for each in found]
            print(f"| {len(car.node)} | {name} | {min(means):.1f}, {statistics.median(means):.1f} | "
                  f"{min(each[1] for each in found):.1f} | {found[0][2][0]:.0f}, {found[0][2][1]:.0f} | {found[0][3]:.3f} |", flush=True)


if __name__ == "__main__":
    main()
