"""Writes the table: messages/*.keyframe, *.delta and cases.json, what every client must print after each of them. Messages are
those of a recording, the same cut in parts, cut off, damaged, or made by hand; numbers come from the decoder below, which is
schema/message.fbs in its plainest form, and outcomes are stated.

    build/venv/bin/python tests/conformance/make.py      after the wire format has changed
"""

import json
import math
import pathlib
import random
import struct

import crumple
import flatbuffers
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
    """A surface as a viewer must come to hold it."""

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

with crumple.Recording(HERE.parents[1] / "recordings/built_in_roof_drop.mcap") as recording:
    told = {f"{kind}{tick}": data for kind in ("key", "delta") for tick, _, data in recording.messages(f"car/car/{kind}/0")}


def held_after(tick, key=None):
    """The surface of a recorded tick, whose hash the server stated."""
    message = DeltaT.InitFromPackedBuf(told[f"delta{tick}"]) if key else KeyframeT.InitFromPackedBuf(told[f"key{tick}"])
    numbers = unpack(message.packed, message.count)
    if key:
        assert message.keyframe == key.tick
        numbers = [signed(a + b) for a, b in zip(key.quanta, numbers)]
    held = Held(message.tick, numbers, key.quantum if key else message.quantum)
    assert held.hash == message.hash and held.tick == tick
    return held


ASSET = KeyframeT.InitFromPackedBuf(told["key19"]).asset
a19 = held_after(19)
a26, a27 = held_after(26, a19), held_after(27, a19)
b29 = held_after(29)
b32, b33 = held_after(32, b29), held_after(33, b29)
some = random.Random(1)
wild = Held(5, [some.randint(-32768, 32767) for _ in range(3 * 40)], 0.0005)
wilder = Held(6, [some.choice((-32768, 32767)) for _ in range(3 * 40)], 0.0005)

messages = {f"{name}.{'keyframe' if name.startswith('key') else 'delta'}": told[name]
            for name in ("key19", "delta26", "delta27", "key29", "delta32", "delta33")}


def made(name, data):
    messages[name] = data
    return name


def cut(name, make, *bounds):
    return [made(name.replace(".", f"_{k + 1}of3."), make(first, end - first))
            for k, (first, end) in enumerate(zip(bounds, bounds[1:]))]


nodes = len(a19.quanta) // 3
key19_parts = cut("key19.keyframe", lambda first, count: keyframe(a19, first, count), 0, 100, 333, nodes)
key29_parts = cut("key29.keyframe", lambda first, count: keyframe(b29, first, count), 0, 100, 333, nodes)
delta26_parts = cut("delta26.delta", lambda first, count: delta(a26, a19, first, count), 0, 100, 333, nodes)
delta6_parts = cut("delta6_wild.delta", lambda first, count: delta(wilder, wild, first, count), 0, 7, 23, 40)

words = [int(each) for each in DeltaT.InitFromPackedBuf(told["delta26"]).packed]
number = next(k for k, word in enumerate(words) if word) + 1  # after the widths of the first block that has any
damaged = bytearray(told["delta26"])
damaged[damaged.find(struct.pack(f"<{len(words)}H", *words)) + 2 * number] ^= 1
made("delta26_damaged.delta", bytes(damaged))

hostile = {
    "key_no_bytes.keyframe": b"",
    "key_of_four_bytes.keyframe": told["key19"][:4],
    "key_half.keyframe": told["key19"][: len(told["key19"]) // 2],
    "key_without_its_end.keyframe": told["key19"][:-16],
    "key_without_numbers.keyframe": keyframe(b29, packed=None),
    "key_without_asset.keyframe": keyframe(b29, asset=None),
    "key_asset_of_15.keyframe": keyframe(b29, asset=ASSET[:15]),
    "key_quantum_0.keyframe": keyframe(b29, quantum=0.0),
    "key_quantum_2.keyframe": keyframe(b29, quantum=2.0),
    "key_quantum_nan.keyframe": keyframe(b29, quantum=math.nan),
    "key_no_nodes.keyframe": keyframe(b29, nodeCount=0),
    "key_too_many_nodes.keyframe": keyframe(b29, nodeCount=200_001),
    "delta_half.delta": told["delta26"][: len(told["delta26"]) // 2],
    "delta_older_than_its_keyframe.delta": delta(a26, a19, tick=18),
    "delta_of_no_node.delta": delta(a26, a19, count=0, packed=[]),
    "delta_beyond_the_last_node.delta": delta(a26, a19, first=nodes - 15, count=16, packed=[0]),
    "delta_first_wraps.delta": delta(a26, a19, first=2**32 - 1, count=16, packed=[0]),
    "delta_count_wraps.delta": delta(a26, a19, first=0, count=2**32 - 1, packed=[0]),
    "delta_of_another_car.delta": delta(a26, a19, nodeCount=nodes + 1),
    "delta_width_17.delta": delta(a26, a19, count=16, packed=[17] + 17 * [1]),
    "delta_bit_15.delta": delta(a26, a19, count=16, packed=[0x8000]),
    "delta_a_word_too_few.delta": delta(a26, a19, count=16, packed=[1]),
    "delta_a_word_too_many.delta": delta(a26, a19, count=16, packed=[0, 0]),
    "delta_a_block_too_few.delta": delta(a26, a19, count=17, packed=[0]),
    "delta_old_and_wrong.delta": delta(a19, a19, tick=19, count=16, packed=[0x8000]),
}
for name, data in hostile.items():
    made(name, data)

keyed = [("key19.keyframe", "applied", a19)]
cases = {
    "deltas are against the keyframe, not against each other": keyed + [
        ("delta26.delta", "applied", a26), ("delta27.delta", "applied", a27), ("delta27.delta", "old", a27)],
    "what is older is dropped": keyed + [
        ("delta27.delta", "applied", a27), ("delta26.delta", "old", a27), ("key19.keyframe", "old", a27)],
    "a delta before its keyframe asks for it": [
        ("delta26.delta", "missing keyframe", None), *keyed, ("delta26.delta", "applied", a26)],
    "a delta against another keyframe asks for that": keyed + [
        ("delta32.delta", "missing keyframe", a19), ("key29.keyframe", "applied", b29), ("delta32.delta", "applied", b32),
        ("delta27.delta", "old", b32), (made("delta40_against_19.delta", delta(a27, a19, tick=40)), "old", b32),
        ("delta33.delta", "applied", b33)],
    "a keyframe in parts is whole with its last part, in any order": [
        (key29_parts[2], "part", None), (key29_parts[0], "part", None), (key29_parts[0], "part", None),
        (key29_parts[1], "applied", b29), ("delta32.delta", "applied", b32)],
    "a delta in parts is whole with its last part, in any order": [
        (made("key5_wild.keyframe", keyframe(wild)), "applied", wild), (delta6_parts[1], "part", wild),
        (delta6_parts[2], "part", wild), (delta6_parts[1], "part", wild), (delta6_parts[0], "applied", wilder)],
    "a surface is whole when its hash is met, though a part in which nothing moved is missing": keyed + [
        (delta26_parts[1], "part", a19), (delta26_parts[2], "applied", a26), (delta26_parts[0], "old", a26)],
    "parts of an older keyframe do not disturb those of a newer": [
        (key19_parts[0], "part", None), (key29_parts[0], "part", None), (key19_parts[1], "old", None),
        (key29_parts[1], "part", None), (key29_parts[2], "applied", b29)],
    "a whole delta makes parts of an older one old": keyed + [
        (delta26_parts[0], "part", a19), ("delta27.delta", "applied", a27), (delta26_parts[1], "old", a27),
        (delta26_parts[2], "old", a27)],
    "a keyframe of the tick that deltas gave is the base of what follows": keyed + [
        (made("delta29_against_19.delta", delta(b29, a19)), "applied", b29), ("delta32.delta", "missing keyframe", b29),
        ("key29.keyframe", "old", b29), ("delta32.delta", "applied", b32)],
    "what is damaged is not shown": keyed + [
        ("delta26_damaged.delta", "part", a19), ("delta26.delta", "applied", a26)],
    "numbers of 16 bits wrap": [
        ("key5_wild.keyframe", "applied", wild),
        (made("delta6_wild.delta", delta(wilder, wild)), "applied", wilder)],
    "a refused keyframe changes nothing": keyed + [
        (name, "refused", a19) for name in hostile if name.startswith("key")] + [("key29.keyframe", "applied", b29)],
    "a refused delta changes nothing": keyed + [
        (name, "refused", a19) for name in hostile if name.startswith("delta")] + [("delta26.delta", "applied", a26)],
    "a refused part leaves those that came": [
        (key29_parts[0], "part", None), ("key_half.keyframe", "refused", None), (key29_parts[1], "part", None),
        ("key_quantum_nan.keyframe", "refused", None), (key29_parts[2], "applied", b29)],
}

for old in (HERE / "messages").glob("*"):
    old.unlink()
for name, data in messages.items():
    (HERE / "messages" / name).write_bytes(data)
lines = []
for name, steps in cases.items():
    rows = [json.dumps([message, {"outcome": outcome, **dict(held or {})}]) for message, outcome, held in steps]
    lines.append(f"{json.dumps(name)}: [\n  " + ",\n  ".join(rows) + "\n]")
(HERE / "cases.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
