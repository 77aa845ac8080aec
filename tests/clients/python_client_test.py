"""A host and viewer in plain Python: PyPI eclipse-zenoh and flatbuffers, and the code that flatc generates from schema/.

Starts a server, spawns a car, drives it into a wall, and reads keyframes and deltas until the dent shows. Then reads the
recording of it with PyPI mcap: by its index, and with no schema but its own. Also the shortest example of the contract for
other languages.

    PYTHONPATH=build/schema/python python tests/clients/python_client_test.py build/crumple CAR
"""

import importlib
import json
import pathlib
import queue
import re
import subprocess
import sys
import tempfile
import time

import flatbuffers
import zenoh
from mcap.exceptions import McapError
from mcap.reader import make_reader

PATIENCE = 60  # s for a message that must arrive


def table(name):
    return getattr(importlib.import_module(f"crumple.schema.{name}"), name)


def made(name, **fields):
    """Makes an object of the generated object API with these fields."""
    module = importlib.import_module(f"crumple.schema.{name}")
    thing = getattr(module, name + "T")()
    for field, value in fields.items():
        assert hasattr(thing, field), f"{name} has no {field}"
        setattr(thing, field, value)
    return thing


def packed(thing):
    builder = flatbuffers.Builder()
    builder.Finish(thing.Pack(builder))
    return bytes(builder.Output())


def vec3(x=0.0, y=0.0, z=0.0):
    return made("Vec3", x=x, y=y, z=z)


def pose(x=0.0, y=0.0, z=0.0):
    return made("Pose", position=made("Vec3d", x=x, y=y, z=z), orientation=made("Quat", x=0.0, y=0.0, z=0.0, w=1.0))


class Server:
    def __init__(self, program, car, recording):
        command = [program, "serve", "--car", car, "--listen", "tcp/127.0.0.1:0", "--scene", "py", "--record", recording]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        first = self.process.stdout.readline()
        assert first, "the server did not start; it says why above"
        self.endpoint = re.search(r"tcp/[0-9.:]+", first).group()
        self.asset = re.search(r"car ([0-9a-f]{16})", self.process.stdout.readline()).group(1)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        assert self.process.wait(PATIENCE) == 0, "the server did not end cleanly"


def order(session, key, kind, body):
    Order = importlib.import_module("crumple.schema.Order").Order
    command = packed(made("Command", orderType=getattr(Order, kind), order=body))
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:  # until the session knows the server's queryable
        for reply in session.get(key, payload=command, timeout=10):
            assert reply.ok is not None, bytes(reply.err.payload)
            answer = table("Answer").GetRootAs(bytes(reply.ok.payload))
            assert answer.Ok(), answer.Sentence()
            return
    raise AssertionError("no server answers")


def unpack(words, count):
    """Unpacks as schema/message.fbs says: blocks of 16 nodes, each axis in as many bits as it needs."""
    out, last, at = [0] * (3 * count), [0, 0, 0], 0
    for first in range(0, count, 16):
        head, at = words[at], at + 1
        for axis in range(3):
            width = head >> 5 * axis & 31
            bits = sum(word << 16 * i for i, word in enumerate(words[at : at + width]))
            at += width
            for node in range(first, min(first + 16, count)):
                zigzag = bits >> width * (node - first) & ((1 << width) - 1)
                last[axis] += zigzag >> 1 if zigzag % 2 == 0 else -(zigzag + 1 >> 1)
                out[3 * node + axis] = (last[axis] + 32768) % 65536 - 32768
    assert at == len(words)
    return out


class Surface:
    """Displacements in quanta of the newest tick. Keyframes replace them; deltas give the differences from the keyframe."""

    def __init__(self):
        self.keyframe, self.key, self.now = None, [], []

    @staticmethod
    def numbers(message):
        assert message.Count() == message.NodeCount(), "a car this small comes in one part"
        return unpack([message.Packed(i) for i in range(message.PackedLength())], message.Count())

    def take_keyframe(self, message):
        self.keyframe = message.Tick()
        self.now = self.key = self.numbers(message)

    def take_delta(self, message):
        if message.Keyframe() != self.keyframe:
            return  # its keyframe was lost, or has not come yet
        self.now = [(a + b + 32768) % 65536 - 32768 for a, b in zip(self.key, self.numbers(message))]

    def deepest(self):
        return max((abs(q) for q in self.now), default=0)


def crash(session, asset):
    inbox = queue.Queue()
    root = "crumple/1/py/"
    subscribers = [session.declare_subscriber(root + key, inbox.put) for key in ("car/py1/key/0", "car/py1/delta/0")]
    poses = session.declare_publisher(root + "host/python/poses")
    obstacles = session.declare_publisher(root + "host/python/obstacles")
    order(session, root + "car/py1", "Spawn", made("Spawn", asset=asset, host="python", pose=pose()))

    Shape = importlib.import_module("crumple.schema.Shape").Shape
    wall = made("Obstacle", id=1, shape=Shape.box, size=vec3(1.0, 5.0, 5.0), pose=pose(x=6.0), friction=0.3)
    surface, deltas, sequence = Surface(), 0, 0
    for reply in session.get(root + "car/py1/key/0", timeout=10):  # like a viewer that starts late
        surface.take_keyframe(table("Keyframe").GetRootAs(bytes(reply.ok.payload)))
    assert surface.keyframe is not None and surface.deepest() == 0, "a car that was just spawned has no dent"

    start = time.monotonic()
    while time.monotonic() < start + PATIENCE and not (deltas and surface.deepest() > 20):
        if not deltas:  # after a contact the car follows its own motion
            sequence += 1
            obstacles.put(packed(made("Obstacles", sequence=sequence, obstacles=[wall])))
            x = 10.0 * (time.monotonic() - start)
            car = made("CarPose", car="py1", pose=pose(x=x), velocity=vec3(x=10.0), angularVelocity=vec3())
            poses.put(packed(made("Poses", sequence=sequence, time=x / 10, cars=[car])))
        try:
            sample = inbox.get(timeout=1 / 60)
        except queue.Empty:
            continue
        data = bytes(sample.payload)
        if str(sample.key_expr).endswith("/key/0"):
            surface.take_keyframe(table("Keyframe").GetRootAs(data))
        else:
            surface.take_delta(table("Delta").GetRootAs(data))
            deltas += 1
    for subscriber in subscribers:
        subscriber.undeclare()
    assert surface.deepest() > 20, f"no dent after {deltas} deltas"
    print(f"{deltas} deltas, deepest displacement {0.5 * surface.deepest():.1f} mm")


def explained(schema, data, folder):
    """Converts a message to JSON with only flatc and the schema in the recording."""
    (folder / "own.bfbs").write_bytes(schema.data)
    (folder / "message.bin").write_bytes(data)
    flatc = pathlib.Path(sys.executable).parent / "flatc"
    subprocess.run([flatc, "--json", "--strict-json", "--raw-binary", "--root-type", schema.name, "-o", folder,
                    folder / "own.bfbs", "--", folder / "message.bin"], check=True)
    return json.loads((folder / "message.json").read_text())


def by_index(path):
    """Reads all messages by the index at the end of the file, and checks the index."""
    with open(path, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary and summary.chunk_indexes and summary.attachment_indexes and summary.metadata_indexes, f"{path}: no index"
        messages = [(channel.topic, message.sequence, message.log_time, message.data, schema)
                    for schema, channel, message in reader.iter_messages(log_time_order=False)]
        assert summary.statistics.message_count == len(messages)
        assert all(schema.encoding == "flatbuffer" for schema in summary.schemas.values())
        return messages


def opens(path):
    try:
        return bool(by_index(path))
    except (AssertionError, McapError):
        return False


def check_recording(program, folder):
    recording, cut, whole = folder / "py.mcap", folder / "cut.mcap", folder / "whole.mcap"
    messages = by_index(recording)
    reactions = next(m for m in messages if m[0] == "crumple/1/py/host/python/reactions")
    told = explained(reactions[4], reactions[3], folder)
    mine = table("Reactions").GetRootAs(reactions[3])
    assert told["tick"] == mine.Tick() == reactions[1] and told["cars"][0]["car"] == "py1", told
    assert abs(told["cars"][0]["impulse"]["x"] - mine.Cars(0).Impulse().X()) < 1, told

    cut.write_bytes(recording.read_bytes()[:-3000])
    assert not opens(cut), "a file that was cut has no index"
    subprocess.run([program, "recover", cut, "-o", whole], check=True)
    kept = [m[:4] for m in by_index(whole)]
    assert kept and kept == [m[:4] for m in messages][: len(kept)], "recover changed messages"
    assert kept[-1][0].endswith(("/tick", "/health")), "recover ends within a tick"
    print(f"{len(messages)} messages recorded, {len(kept)} after a cut")


def main(program, car):
    with tempfile.TemporaryDirectory(prefix="crumple_test_") as name:
        folder = pathlib.Path(name)
        with Server(program, car, folder / "py.mcap") as server:
            config = zenoh.Config()
            config.insert_json5("mode", '"client"')
            config.insert_json5("connect/endpoints", f'["{server.endpoint}"]')
            config.insert_json5("scouting/multicast/enabled", "false")
            with zenoh.open(config) as session:
                crash(session, server.asset)
        check_recording(program, folder)


if __name__ == "__main__":
    main(*sys.argv[1:3])
