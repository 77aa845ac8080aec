"""Plays the scene once in one peer. This is a separate process, so that its number of threads is fixed from the start.

    play.py PEER MODEL THREADS ITERATIONS SCENE OUT

SCENE is a pickled scene.Scene; OUT gets the final node positions as float32. Prints one line of JSON: version, milliseconds
to build, milliseconds of every step. Before each step it sets all velocities to zero (not timed). So every peer solves the same
problem as a quasi-static solver: it looks for the equilibrium of its own energy with the pushed nodes at their new place.
"""

import importlib.metadata
import json
import os
import pathlib
import pickle
import struct
import subprocess
import sys
import tempfile
import time

import numpy as np

import scene as play

bench_folder = pathlib.Path(__file__).resolve().parents[2] / "build/bench"


def clock(work):
    begin = time.perf_counter()
    result = work()
    return 1e3 * (time.perf_counter() - begin), result


def little_endian(scene):
    """Returns the scene in the format of the programs: counts, dt, speed; nodes, edges, tets with inverse masses and compliances."""
    inverse_mass = np.where(scene.fixed(), 0, 1 / scene.mass)
    edge = np.empty(len(scene.edge), [("node", "<i4", 2), ("compliance", "<f4")])
    edge["node"], edge["compliance"] = scene.edge, 1 / scene.edge_stiffness
    tet = np.empty(len(scene.tet), [("node", "<i4", 4), ("compliance", "<f4")])
    tet["node"], tet["compliance"] = scene.tet, 36 / scene.volume_stiffness  # Jolt constrains six times the volume
    return (struct.pack("<iiiff", len(scene.node), len(tet), len(edge), play.dt, play.speed)
            + np.column_stack([scene.node, inverse_mass, scene.pushed]).astype("<f4").tobytes()
            + edge.tobytes() + tet.tobytes())


def program(scene, *command):
    """Runs a peer that is a separate program. Returns its output and its positions. SCENE and OUT in its command are files."""
    with tempfile.TemporaryDirectory() as folder:
        files = {"SCENE": pathlib.Path(folder) / "scene.bin", "OUT": pathlib.Path(folder) / "out.bin"}
        files["SCENE"].write_bytes(little_endian(scene))
        text = subprocess.run([str(files.get(word, word)) for word in command], check=True, capture_output=True,
                              text=True).stdout
        return json.loads(text.splitlines()[-1]), np.fromfile(files["OUT"], "<f4").reshape(-1, 3)


def crumple(scene, model, threads, iterations):
    """Our solver. An iteration is a sweep, and the model gives the number of sub-steps in a step."""
    substeps = int(model.split()[1])
    answer, found = program(scene, bench_folder / "crumple_peer", "SCENE", "OUT", threads, substeps, iterations, play.steps)
    return "crumple", answer["build_ms"], answer["ms"], found


def jolt(scene, model, threads, iterations):
    """XPBD on edges and volumes with physical compliances; an iteration is a sub-step."""
    folder = bench_folder / "jolt"
    jars = ":".join(str(jar) for jar in folder.glob("*.jar"))
    answer, found = program(scene, "java", "-cp", f"{folder}:{jars}", "JoltPeer", folder / "libjoltjni.so", "SCENE", "OUT",
                            threads, iterations, play.steps)
    return f"jolt-jni {answer['version']}", answer["build_ms"], answer["ms"], found


def pypbd(scene, model, threads, iterations):
    import pypbd as pbd

    pbd.Logger.addConsoleSink(pbd.LogLevel.ERR)
    sim = pbd.Simulation.getCurrent()
    sim.initDefault()
    pbd.TimeManager.getCurrent().setTimeStepSize(play.dt)
    body = sim.getModel()
    tets = body.addTetModel(scene.node, scene.tet.astype("u4").ravel(), False, False)
    particles = body.getParticles()
    for i in range(len(scene.node)):
        particles.setMass(i, 0 if scene.anchored[i] or scene.pushed[i] else scene.mass[i])

    def build():
        if model == "XPBD edge+volume":
            for (a, b), k in zip(scene.edge.tolist(), scene.edge_stiffness.tolist()):
                body.addDistanceConstraint_XPBD(a, b, k)
            for (a, b, c, d), k in zip(scene.tet.tolist(), scene.volume_stiffness.tolist()):
                body.addVolumeConstraint_XPBD(a, b, c, d, k)
        else:
            method, stiffness = {"PBD edge+volume": (1, 1), "PBD-FEM": (2, play.young_modulus),
                                 "XPBD-FEM": (3, play.young_modulus)}[model]
            body.addSolidConstraints(tets, method, stiffness, 0, 1, False, False)
        body.initConstraintGroups()

    build_ms, _ = clock(build)
    stepper = sim.getTimeStep()
    stepper.setValueUInt(pbd.TimeStepController.NUM_SUB_STEPS, 1)
    stepper.setValueUInt(pbd.TimeStepController.MAX_ITERATIONS, iterations)
    pushed, times = np.flatnonzero(scene.pushed), []
    for step in range(play.steps):
        for i in range(len(scene.node)):
            particles.setVelocity(i, [0, 9.81 * play.dt, 0])  # cancels its gravity, which Python cannot set
        for i, target in zip(pushed, scene.targets(step)):
            particles.setPosition(int(i), target)
        times.append(clock(lambda: stepper.step(body))[0])
    found = np.array([particles.getPosition(i) for i in range(len(scene.node))])
    return f"pypbd {importlib.metadata.version('pypbd')}", build_ms, times, found


def rapier(scene, model, threads, iterations):
    import rapier3d as rp

    world = rp.PhysicsWorld(gravity=(0, 0, 0))
    world.set_num_threads(threads)
    world.integration_parameters.dt = play.dt
    world.integration_parameters.num_solver_iterations = iterations
    kind, _, solver = model.partition(", ")
    builder = rp.SoftBodyBuilder(scene.node).cells(scene.tet.astype("u4")).surface(play.surface(scene.tet).astype("u4"))
    builder = builder.material(rp.SoftBodyMaterial(young_modulus=play.young_modulus, poisson_ratio=0.0))
    if kind == "edge+volume":
        builder = builder.edges(scene.edge.astype("u4")).cell_model(rp.SoftBodyCellModel.VOLUME)
    else:
        builder = builder.cell_model(getattr(rp.SoftBodyCellModel, kind.upper().replace("-", "_")))
    if solver:
        builder = builder.solver(rp.SoftBodySolver.FEM)
    fixed = np.flatnonzero(scene.fixed())
    builder = builder.masses(scene.mass.tolist()).pinned_particles(fixed.astype("u4")).no_surface_collider().can_sleep(False)
    build_ms, handle = clock(lambda: world.add_soft_body(builder))
    body = world.soft_bodies[handle]
    pushed, times = np.flatnonzero(scene.pushed), []
    for step in range(play.steps):
        body.particle_velocities = np.zeros_like(scene.node)
        for i, target in zip(pushed, scene.targets(step)):
            body.set_particle_kinematic_target(int(i), target)
        times.append(clock(world.step)[0])
    return f"rapier3d {importlib.metadata.version('rapier3d')}", build_ms, times, np.array(body.particle_positions)


def mujoco(scene, model, threads, iterations):
    """Implicit steps. An iteration is a step of dt / iterations. The front is one body, too heavy to be slowed.

    At one sub-step it warns that its inner solve ran out of iterations."""
    import mujoco as mj

    text = lambda values: " ".join(format(v, ".9g") for v in np.ravel(values))
    bodies = ["world" if a else "front" if p else f"n{i}" for i, (a, p) in enumerate(zip(scene.anchored, scene.pushed))]
    free = np.flatnonzero(~scene.fixed())
    local = np.where(scene.fixed()[:, None], scene.node, 0)
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    parts = "".join(f'<body name="n{i}" pos="{text(scene.node[i])}"><inertial pos="0 0 0" mass="{scene.mass[i]:.9g}" '
                    f'diaginertia="1e-4 1e-4 1e-4"/>{slides}</body>' for i in free)
    xml = f"""<mujoco><option integrator="discrete" timestep="{play.dt / iterations}" gravity="0 0 0"/>
      <size memory="8G"/><worldbody>
      <body name="front"><inertial pos="0 0 0" mass="1e6" diaginertia="1 1 1"/><joint type="slide" axis="1 0 0"/></body>
      {parts}</worldbody><deformable>
      <flex name="car" dim="3" radius="0.001" body="{' '.join(bodies)}" vertex="{text(local)}"
        element="{' '.join(map(str, scene.tet.ravel()))}">
        <contact selfcollide="none" contype="0" conaffinity="0"/>
        <elasticity young="{play.young_modulus}" poisson="0" damping="0"/></flex></deformable></mujoco>"""
    build_ms, built = clock(lambda: mj.MjModel.from_xml_string(xml))
    data = mj.MjData(built)
    if threads > 1:
        mj.mju_threadpool(data, threads - 1)
    times = []
    for step in range(play.steps):
        data.qvel[:] = 0
        spent = 0
        for k in range(iterations):
            data.qpos[0], data.qvel[0] = -play.speed * play.dt * (step + k / iterations), -play.speed
            spent += clock(lambda: mj.mj_step(built, data))[0]
        times.append(spent)
    mj.mj_kinematics(built, data)
    mj.mj_flex(built, data)
    return f"mujoco-core {importlib.metadata.version('mujoco-core')}", build_ms, times, np.array(data.flexvert_xpos)


if __name__ == "__main__":
    peer, model, threads, iterations, source, out = sys.argv[1:]
    os.environ["OMP_NUM_THREADS"] = threads
    with open(source, "rb") as stream:
        loaded = pickle.load(stream)
    version, build, times, found = globals()[peer](loaded, model, int(threads), int(iterations))
    found.astype("<f4").tofile(out)
    print(json.dumps({"version": version, "build_ms": build, "ms": times}))
