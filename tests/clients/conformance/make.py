"""Writes the table: messages/*.keyframe, *.delta and cases.json, what every client must print after each of them. Messages are
those of a recording, the same cut in parts, cut off, damaged, or made by hand; numbers come from the decoder below, which is
schema/message.fbs in its plainest form, and outcomes are stated.

    build/venv/bin/python tests/clients/conformance/make.py      after the wire format has changed
"""

import json
import math
import pathlib
import random
import struct

import crumple
import flatbuffers
import numpy as np
import own
from crumple.schema.Delta import DeltaT
from crumple.schema.Keyframe import KeyframeT

HERE = pathlib.Path(__file__).parent
MASK = 2**64 - 1
BLOCK = 16  # nodes


def xxh64(data):
    p1, p2, p3, p4, p5 = 11400714785074694791, 14029467366897019727, 1609587929392839161, 9650029242287828579, 2870177450012600261
    turn = lambda x, bits: (x << bits | x >> 64 - bits) & MASK
    step = lambda lane, word: turn((lane + word * p2) & MASK, 31) * p1 & MASK
    at, lanes = 0, [(p1 + p2) & MASK, p2, 0, -p1 & MASK]
    while len(data) - at >= 32:
        lanes = [step(lane, word) for lane, word in zip(lanes, struct.unpack_from("<4Q", data, at))]
        at += 32
    hash_ = p5
    if at:
        hash_ = sum(turn(lane, bits) for lane, bits in zip(lanes, (1, 7, 12, 18))) & MASK
        for lane in lanes:
            hash_ = ((hash_ ^ step(0, lane)) * p1 + p4) & MASK
    hash_ = (hash_ + len(data)) & MASK
    while len(data) - at >= 8:
        hash_ = (turn(hash_ ^ step(0, *struct.unpack_from("<Q", data, at)), 27) * p1 + p4) & MASK
        at += 8
    if len(data) - at >= 4:
        hash_ = (turn(hash_ ^ struct.unpack_from("<I", data, at)[0] * p1 & MASK, 23) * p2 + p3) & MASK
        at += 4
    for byte in data[at:]:
        hash_ = turn(hash_ ^ byte * p5 & MASK, 11) * p1 & MASK
    hash_ = (hash_ ^ hash_ >> 33) * p2 & MASK
    hash_ = (hash_ ^ hash_ >> 29) * p3 & MASK
    return hash_ ^ hash_ >> 32


def signed(number):
    return (number + 2**15) % 2**16 - 2**15


def unpack(words, count):
    words, last, out = list(map(int, words)), [0, 0, 0], []
    for first in range(0, count, BLOCK):
        head, nodes = words.pop(0), [[], [], []]
        for axis in range(3):
            width = head >> 5 * axis & 31
            bits = sum(words.pop(0) << 16 * k for k in range(width))
            for k in range(min(BLOCK, count - first)):
                zigzag = bits >> width * k & 2**width - 1
                last[axis] = signed(last[axis] + (zigzag >> 1 ^ -(zigzag & 1)))
                nodes[axis].append(last[axis])
        out += [each for node in zip(*nodes) for each in node]
    assert not words
    return out


def pack(quanta):
    words, last = [], [0, 0, 0]
    for first in range(0, len(quanta), 3 * BLOCK):
        head, body = 0, []
        for axis in range(3):
            numbers = []
            for each in quanta[first + axis : first + 3 * BLOCK : 3]:
                step = signed(each - last[axis])
                numbers.append(2 * step if step >= 0 else -2 * step - 1)
                last[axis] = each
            width = max(numbers).bit_length()
            bits = sum(number << width * k for k, number in enumerate(numbers))
            head |= width << 5 * axis
            body += [bits >> 16 * k & 0xFFFF for k in range(width)]
        words += [head, *body]
    return words


class Held:
    """A surface that a viewer must end with."""

    def __init__(self, tick, quanta, quantum):
        self.tick, self.quanta, self.quantum = tick, quanta, quantum
        self.hash = xxh64(struct.pack(f"<{len(quanta)}h", *quanta))

    def __iter__(self):
        yield "tick", self.tick
        yield "hash", f"{self.hash:016x}"
        yield "nodes", len(self.quanta) // 3
        yield "quantum_um", round(1e6 * self.quantum)
        yield "sum", sum(self.quanta)
        yield "moment", sum(k * each for k, each in enumerate(self.quanta))


def build(message, **changes):
    for name, value in changes.items():
        setattr(message, name, value)
    builder = flatbuffers.Builder(0)
    builder.Finish(message.Pack(builder))
    return bytes(builder.Output())


def keyframe(held, first=0, count=None, **changes):
    message = KeyframeT()
    nodes = len(held.quanta) // 3
    count = nodes - first if count is None else count
    message.tick, message.asset, message.quantum, message.hash = held.tick, ASSET, held.quantum, held.hash
    message.nodeCount, message.first, message.count = nodes, first, count
    message.packed = pack(held.quanta[3 * first : 3 * (first + count)])
    return build(message, **changes)


def delta(held, key, first=0, count=None, **changes):
    message = DeltaT()
    nodes = len(held.quanta) // 3
    count = nodes - first if count is None else count
    message.tick, message.keyframe, message.hash = held.tick, key.tick, held.hash
    message.nodeCount, message.first, message.count = nodes, first, count
    steps = [signed(now - then) for now, then in zip(held.quanta, key.quanta)]
    message.packed = pack(steps[3 * first : 3 * (first + count)])
    return build(message, **changes)


# ---- what was told in a recorded crash

with crumple.Recording(HERE.parents[2] / "recordings/built_in_roof_drop.mcap") as recording:
    told = {f"{kind}{tick}": data for kind in ("key", "delta") for tick, _, data in recording.messages(f"car/car/{kind}/0")}


# Two keyframes in a row with two deltas each.
groups = [[tick] for tick in sorted(int(name[3:]) for name in told if name.startswith("key"))]
for group in groups:
    group += [tick for name, data in told.items() if name.startswith("delta")
              for tick in [int(name[5:])] if DeltaT.InitFromPackedBuf(data).keyframe == group[0]]
pair = next((one, two) for one, two in zip(groups[1:], groups[2:]) if len(one) > 2 and len(two) > 2)
told = {name: told[f"{name.split('_')[0]}{tick}"]
        for group, names in zip(pair, (("key_a", "delta_a1", "delta_a2"), ("key_b", "delta_b1", "delta_b2")))
        for name, tick in zip(names, group)}


def held_after(name, key=None):
    """The surface of a recorded message, with the hash from the server."""
    message = (DeltaT if key else KeyframeT).InitFromPackedBuf(told[name])
    numbers = unpack(message.packed, message.count)
    if key:
        assert message.keyframe == key.tick
        numbers = [signed(a + b) for a, b in zip(key.quanta, numbers)]
    held = Held(message.tick, numbers, key.quantum if key else message.quantum)
    assert held.hash == message.hash
    return held


ASSET = KeyframeT.InitFromPackedBuf(told["key_a"]).asset
a = held_after("key_a")
a1, a2 = held_after("delta_a1", a), held_after("delta_a2", a)
b = held_after("key_b")
b1, b2 = held_after("delta_b1", b), held_after("delta_b2", b)
some = random.Random(1)
wild = Held(5, [some.randint(-32768, 32767) for _ in range(3 * 40)], 0.0005)
quiet = Held(7, wild.quanta[:21] + 99 * [9], 0.0005)
another = Held(b.tick, wild.quanta, 0.0005)
wilder = Held(6, [some.choice((-32768, 32767)) for _ in range(3 * 40)], 0.0005)

messages = {f"{name}.{'keyframe' if name.startswith('key') else 'delta'}": told[name]
            for name in ("key_a", "delta_a1", "delta_a2", "key_b", "delta_b1", "delta_b2")}


def made(name, data):
    messages[name] = data
    return name


def cut(name, make, *bounds):
    return [made(name.replace(".", f"_{k + 1}of3."), make(first, end - first))
            for k, (first, end) in enumerate(zip(bounds, bounds[1:]))]


nodes = len(a.quanta) // 3
a_parts = cut("key_a.keyframe", lambda first, count: keyframe(a, first, count), 0, 100, 333, nodes)
b_parts = cut("key_b.keyframe", lambda first, count: keyframe(b, first, count), 0, 100, 333, nodes)
a1_parts = cut("delta_a1.delta", lambda first, count: delta(a1, a, first, count), 0, 100, 333, nodes)
quiet_parts = cut("delta7_quiet.delta", lambda first, count: delta(quiet, wild, first, count), 0, 7, 23, 40)
delta6_parts = cut("delta6_wild.delta", lambda first, count: delta(wilder, wild, first, count), 0, 7, 23, 40)

words = [int(each) for each in DeltaT.InitFromPackedBuf(told["delta_a1"]).packed]
number = next(k for k, word in enumerate(words) if word) + 1  # after the widths of the first block with numbers
damaged = bytearray(told["delta_a1"])
damaged[damaged.find(struct.pack(f"<{len(words)}H", *words)) + 2 * number] ^= 1
made("delta_a1_damaged.delta", bytes(damaged))

hostile = {
    "key_no_bytes.keyframe": b"",
    "key_of_four_bytes.keyframe": told["key_a"][:4],
    "key_half.keyframe": told["key_a"][: len(told["key_a"]) // 2],
    "key_without_its_end.keyframe": told["key_a"][:-16],
    "key_without_numbers.keyframe": keyframe(b, packed=None),
    "key_without_asset.keyframe": keyframe(b, asset=None),
    "key_asset_of_15.keyframe": keyframe(b, asset=ASSET[:15]),
    "key_quantum_0.keyframe": keyframe(b, quantum=0.0),
    "key_quantum_2.keyframe": keyframe(b, quantum=2.0),
    "key_quantum_nan.keyframe": keyframe(b, quantum=math.nan),
    "key_no_nodes.keyframe": keyframe(b, nodeCount=0),
    "key_too_many_nodes.keyframe": keyframe(b, nodeCount=200_001),
    "delta_half.delta": told["delta_a1"][: len(told["delta_a1"]) // 2],
    "delta_older_than_its_keyframe.delta": delta(a1, a, tick=a.tick - 1),
    "delta_of_no_node.delta": delta(a1, a, count=0, packed=[]),
    "delta_beyond_the_last_node.delta": delta(a1, a, first=nodes - 15, count=16, packed=[0]),
    "delta_first_wraps.delta": delta(a1, a, first=2**32 - 1, count=16, packed=[0]),
    "delta_count_wraps.delta": delta(a1, a, first=0, count=2**32 - 1, packed=[0]),
    "delta_of_another_car.delta": delta(a1, a, nodeCount=nodes + 1),
    "delta_width_17.delta": delta(a1, a, count=16, packed=[17] + 17 * [1]),
    "delta_bit_15.delta": delta(a1, a, count=16, packed=[0x8000]),
    "delta_a_word_too_few.delta": delta(a1, a, count=16, packed=[1]),
    "delta_a_word_too_many.delta": delta(a1, a, count=16, packed=[0, 0]),
    "delta_a_block_too_few.delta": delta(a1, a, count=17, packed=[0]),
    "delta_old_and_wrong.delta": delta(a, a, count=16, packed=[0x8000]),
}
for name, data in hostile.items():
    made(name, data)

keyed = [("key_a.keyframe", "applied", a)]
cases = {
    "deltas are against the keyframe, not against each other": keyed + [
        ("delta_a1.delta", "applied", a1), ("delta_a2.delta", "applied", a2), ("delta_a2.delta", "old", a2)],
    "what is older is dropped": keyed + [
        ("delta_a2.delta", "applied", a2), ("delta_a1.delta", "old", a2), ("key_a.keyframe", "old", a2)],
    "a delta before its keyframe asks for it": [
        ("delta_a1.delta", "missing keyframe", None), *keyed, ("delta_a1.delta", "applied", a1)],
    "a delta against another keyframe asks for that": keyed + [
        ("delta_b1.delta", "missing keyframe", a), ("key_b.keyframe", "applied", b), ("delta_b1.delta", "applied", b1),
        ("delta_a2.delta", "old", b1), (made("delta_late_against_a.delta", delta(a2, a, tick=b2.tick + 7)), "old", b1),
        ("delta_b2.delta", "applied", b2)],
    "a keyframe in parts is whole with its last part, in any order": [
        (b_parts[2], "part", None), (b_parts[0], "part", None), (b_parts[0], "part", None),
        (b_parts[1], "applied", b), ("delta_b1.delta", "applied", b1)],
    "a delta in parts is whole with its last part, in any order": [
        (made("key5_wild.keyframe", keyframe(wild)), "applied", wild), (delta6_parts[1], "part", wild),
        (delta6_parts[2], "part", wild), (delta6_parts[1], "part", wild), (delta6_parts[0], "applied", wilder)],
    "a surface is whole when its hash is met, though a part in which nothing moved is missing": [
        ("key5_wild.keyframe", "applied", wild), (quiet_parts[1], "part", wild), (quiet_parts[2], "applied", quiet),
        (quiet_parts[0], "old", quiet)],
    "parts of an older keyframe do not disturb those of a newer": [
        (a_parts[0], "part", None), (b_parts[0], "part", None), (a_parts[1], "old", None),
        (b_parts[1], "part", None), (b_parts[2], "applied", b)],
    "a whole delta makes parts of an older one old": keyed + [
        (a1_parts[0], "part", a), ("delta_a2.delta", "applied", a2), (a1_parts[1], "old", a2),
        (a1_parts[2], "old", a2)],
    "a keyframe of the tick that deltas gave is the base of what follows": keyed + [
        (made("delta_b_against_a.delta", delta(b, a)), "applied", b), ("delta_b1.delta", "missing keyframe", b),
        ("key_b.keyframe", "old", b), ("delta_b1.delta", "applied", b1)],
    "what is damaged is not shown": keyed + [
        ("delta_a1_damaged.delta", "part", a), ("delta_a1.delta", "applied", a1)],
    "a keyframe of another baked car takes the place of all that was": keyed + [
        (made("key_of_another_car.keyframe", keyframe(another, asset="0123456789abcdef")), "applied", another),
        ("delta_late_against_a.delta", "old", another)],
    "numbers of 16 bits wrap": [
        ("key5_wild.keyframe", "applied", wild),
        (made("delta6_wild.delta", delta(wilder, wild)), "applied", wilder)],
    "a refused keyframe changes nothing": keyed + [
        (name, "refused", a) for name in hostile if name.startswith("key")] + [("key_b.keyframe", "applied", b)],
    "a refused delta changes nothing": keyed + [
        (name, "refused", a) for name in hostile if name.startswith("delta")] + [("delta_a1.delta", "applied", a1)],
    "a refused part leaves those that came": [
        (b_parts[0], "part", None), ("key_half.keyframe", "refused", None), (b_parts[1], "part", None),
        ("key_quantum_nan.keyframe", "refused", None), (b_parts[2], "applied", b)],
}

# ---- a mesh of the game's own, and parts

box, mesh, car, mine = own.make()
made("box.car", box)
made("box.own", mesh)
ASSET = f"{xxh64(box):016x}"
dent = np.exp(-((car.node[car.used] - [2, 0.5, 0.5]) ** 2).sum(1) / 0.9)[:, None] * [-0.4, -0.15, 0.1]
turned = 0.3 * (car.node[car.used] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]]).T)  # all of it, with some stretch
still, bent, rolled = (Held(tick, [int(x) for x in np.rint(moved / 0.0005).ravel()], 0.0005)
                       for tick, moved in ((3, 0 * dent), (4, dent), (9, turned)))


def and_own(held):
    moved = np.array(held.quanta).reshape(-1, 3) * held.quantum
    return {**dict(held), "own": mine.now(moved), "poses": [[float(x) for x in pose] for pose in car.poses(moved)]}


cases["vertices of the game and parts follow the dents"] = [
    ("box.car", "held", None), ("box.own", "mapped", {"vertices": len(mine.rows), "on_vertices": int(mine.on_vertices), "farthest": mine.farthest}),
    (made("key3_box.keyframe", keyframe(still)), "applied", and_own(still)),
    (made("delta4_box.delta", delta(bent, still)), "applied", and_own(bent)),
    (made("key9_box.keyframe", keyframe(rolled)), "applied", and_own(rolled))]

for old in (HERE / "messages").glob("*"):
    old.unlink()
for name, data in messages.items():
    (HERE / "messages" / name).write_bytes(data)
lines = []
for name, steps in cases.items():
    rows = [json.dumps([message, {"outcome": outcome, **dict(held or {})}]) for message, outcome, held in steps]
    lines.append(f"{json.dumps(name)}: [\n  " + ",\n  ".join(rows) + "\n]")
(HERE / "cases.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
