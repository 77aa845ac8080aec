"""Runs the conformance table with the Python package. run.py specifies its input and output."""

import json
import pathlib
import sys

import numpy as np
from crumple._library import Error, check, ffi, lib
from crumple.session import View


def begin():
    view = View(scene=ffi.new("char[]", b"main"))
    check(lib.crumple_follow(view._handle, b"a", 0))
    return view


def take(view, path):
    before, count = view.surface("a"), view.statistics()
    data = path.read_bytes()
    key = f"crumple/1/main/car/a/{'key' if path.suffix == '.keyframe' else 'delta'}/0"
    try:
        check(lib.crumple_feed(view._handle, key.encode(), data, len(data)))
    except Error:
        return "refused"
    now, counted = view.surface("a"), view.statistics()
    if counted.older > count.older:
        return "old"
    if counted.asked > count.asked:
        return "missing keyframe"
    return "part" if (now and now.tick) == (before and before.tick) else "applied"


def numbers_of(view, own):
    vertices = view.vertices("a", own=own)
    rows = np.concatenate([vertices.position, vertices.normal, vertices.tangent], 1)
    return {"own": rows.tolist(), "poses": [[*pose.position, *pose.orientation] for pose in view.part_poses("a")]}


view, asset, own = begin(), None, None
for line in sys.stdin:
    if not line.strip():
        view.close()
        view, asset, own = begin(), None, None
        continue
    path = pathlib.Path(line.strip())
    if path.suffix == ".car":
        asset = view.add_asset(path.read_bytes())
        print(json.dumps({"outcome": "held"}))
        continue
    if path.suffix == ".own":
        rows = np.frombuffer(path.read_bytes(), np.float32, offset=4).reshape(-1, 9)
        own = view.map(asset, rows[:, :3], rows[:, 3:6], rows[:, 6:])
        print(json.dumps({"outcome": "mapped", "vertices": own.count, "on_vertices": own.on_vertices, "farthest": own.farthest}))
        continue
    said = {"outcome": take(view, path)}
    if surface := view.surface("a"):
        numbers = surface.quanta.ravel().tolist()
        said |= {"tick": surface.tick, "hash": f"{surface.hash:016x}", "nodes": len(surface.quanta),
                 "quantum_um": round(1e6 * surface.quantum), "sum": sum(numbers),
                 "moment": sum(k * each for k, each in enumerate(numbers))}
        if own:
            said |= numbers_of(view, own)
    print(json.dumps(said))
