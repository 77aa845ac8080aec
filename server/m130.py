"""Makes one model of the car m130 and its wheels, which its package keeps in files of their own.

    python server/m130.py metadrive_simulator-0.2.6.0-....whl m130.glb

The car is "130" by mononofu, CC-BY-4.0. Places of the wheels are those of the package's MVehicle, but for their height, which is
that of the wheel arches.
"""

import base64
import copy
import json
import pathlib
import struct
import sys
import zipfile

FOLDER = "metadrive/assets/models/vehicle/130"
FRONT, REAR, SIDE, HEIGHT = -1.335, 1.153, 0.803, 0.31  # m, hubs in the coordinates of the body: -z is forward, y is up
LISTS = ("accessors", "bufferViews", "materials", "meshes", "textures", "images", "samplers", "buffers")


def shifted(entry, by):
    """The entry with every index into another list raised by as much as that list has grown."""
    lists = {"bufferView": "bufferViews", "buffer": "buffers", "indices": "accessors", "material": "materials", "mesh": "meshes",
             "source": "images", "sampler": "samplers"}
    out = {}
    for name, value in entry.items():
        if name in lists and isinstance(value, int):
            value += by[lists[name]]
        elif name == "attributes":
            value = {each: index + by["accessors"] for each, index in value.items()}
        elif name.endswith("Texture"):
            value = {**value, "index": value["index"] + by["textures"]}
        elif isinstance(value, dict):
            value = shifted(value, by)
        elif isinstance(value, list):
            value = [shifted(each, by) if isinstance(each, dict) else each for each in value]
        out[name] = value
    return out


def add(car, wheel, name, position, turn):
    """Hangs all of the wheel's nodes below a new node of the car."""
    first = len(car["nodes"])
    for node in wheel["nodes"]:
        car["nodes"].append(dict(node, name=f"{name} {node.get('name', '')}"))
        if "children" in node:
            car["nodes"][-1]["children"] = [first + child for child in node["children"]]
    roots = [first + root for root in wheel["scenes"][wheel.get("scene", 0)]["nodes"]]
    car["nodes"].append({"name": name, "translation": position, "rotation": turn, "children": roots})
    car["scenes"][car.get("scene", 0)]["nodes"].append(len(car["nodes"]) - 1)


def main():
    package, out = sys.argv[1:]
    files = zipfile.ZipFile(package)
    car, wheel = (json.loads(files.read(f"{FOLDER}/{name}.gltf")) for name in ("vehicle", "right_tire_front"))  # all four are alike
    for primitive in (each for mesh in wheel["meshes"] for each in mesh["primitives"]):
        primitive["attributes"].pop("COLOR_0", None)  # white
    by = {name: len(car.get(name, [])) for name in LISTS}
    for name in LISTS:
        if name in wheel:
            car.setdefault(name, []).extend(shifted(copy.deepcopy(each), by) for each in wheel[name])
    for node in wheel["nodes"]:
        if "mesh" in node:
            node["mesh"] += by["meshes"]
    for end, z in (("front", FRONT), ("rear", REAR)):
        for side, x, turn in (("left", -SIDE, [0, 1, 0, 0]), ("right", SIDE, [0, 0, 0, 1])):
            add(car, wheel, f"wheel {end} {side}", [x, HEIGHT, z], turn)

    blob = bytearray()
    start = []
    for buffer in car["buffers"]:
        blob += b"\0" * (-len(blob) % 4)
        start.append(len(blob))
        blob += base64.b64decode(buffer["uri"].partition(",")[2])
    for view in car["bufferViews"]:
        view["byteOffset"] = view.get("byteOffset", 0) + start[view["buffer"]]
        view["buffer"] = 0
    blob += b"\0" * (-len(blob) % 4)
    car["buffers"] = [{"byteLength": len(blob)}]
    car["asset"]["copyright"] = '"130" by mononofu, CC-BY-4.0'
    text = json.dumps(car, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    pathlib.Path(out).write_bytes(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)) + struct.pack("<I4s", len(text), b"JSON") + text
                                  + struct.pack("<I4s", len(blob), b"BIN\0") + blob)


if __name__ == "__main__":
    main()
