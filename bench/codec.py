"""Compares codecs for the surface of a crashing car: bits per vertex and frame, error, time.

    codec.py FOLDER [-o PICTURE.png]

FOLDER has the files of crumple_codec. The program writes all rows to codec.csv in this folder and draws the picture. It quantises
the vertices (or the nodes of the skin) and encodes their differences from the undamaged car, which is the last keyframe of a car in
its first crash. Differences from the previous frame would be shorter, but one lost message would spoil all later ones.
  raw          int16
  planes+zstd  all low bytes, then all high bytes, zigzag, zstd at level 3
  steps+planes+zstd  the same, applied to the differences from the previous point
  meshopt      meshoptimizer's vertex codec v1, 8 bytes per vertex; followed by zstd
  packed       ours: schema/message.fbs, whole messages, timed in C++ by crumple_codec
Surface level 1, for far viewers, is `nodes, packed` at 4 mm in every sixth tick, so it takes a sixth of these bits per vertex and
tick. The sizes of the other codecs count only the numbers, without a message around them. Times are the best of several calls of
the library, on arrays that are ready for it.
"""

import argparse
import csv
import pathlib
import time

import matplotlib
import meshopt
import numpy as np
import zstandard

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

QUANTA = (0.25, 0.5, 1.0, 4.0)  # mm; 4: surface level 1, for far viewers, which is sent only every sixth tick
REPETITIONS = 20
SHOWN = 0.5  # mm: drawn with large marks
COLOURS = {"raw": "#999999", "planes+zstd": "#E69F00", "steps+planes+zstd": "#009E73", "meshopt": "#56B4E9", "meshopt+zstd": "#0072B2", "packed": "#D55E00"}

compressor, decompressor = zstandard.ZstdCompressor(level=3), zstandard.ZstdDecompressor()


def zigzag(quanta):
    return ((quanta << 1) ^ (quanta >> 15)).astype(np.uint16)


def steps(quanta):
    return np.diff(quanta, axis=0, prepend=np.zeros((1, 3), np.int16))


def planes(quanta):
    bytes_of = zigzag(quanta).T.copy().view(np.uint8).reshape(-1, 2)
    return np.ascontiguousarray(bytes_of.T).tobytes()


def padded(quanta):
    return np.hstack([quanta, np.zeros((len(quanta), 1), np.int16)])


# name: (prepared array, encode, decode)
CODECS = {
    "raw": (lambda q: q.tobytes(), lambda a: a, lambda a, b: b),
    "planes+zstd": (planes, compressor.compress, lambda a, b: decompressor.decompress(b)),
    "steps+planes+zstd": (lambda q: planes(steps(q)), compressor.compress, lambda a, b: decompressor.decompress(b)),
    "meshopt": (padded, meshopt.encode_vertex_buffer, lambda a, b: meshopt.decode_vertex_buffer(b, len(a), 8)),
    "meshopt+zstd": (
        padded,
        lambda a: compressor.compress(bytes(meshopt.encode_vertex_buffer(a))),
        lambda a, b: meshopt.decode_vertex_buffer(decompressor.decompress(b), len(a), 8),
    ),
}


def best(work):
    times = []
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        out = work()
        times.append(time.perf_counter() - start)
    return min(times), out


def read(path):
    """Reads frames of (vertices, nodes), as displacements in m."""
    data = path.read_bytes()
    frames, vertices, nodes = np.frombuffer(data, "<u4", 3)
    numbers = np.frombuffer(data, "<f4", offset=12).reshape(frames, vertices + nodes, 3)
    return [(frame[:vertices], frame[vertices:]) for frame in numbers]


def rows_of(path):
    car, scene = path.stem.rsplit("-", 1)
    frames = read(path)
    for sent in ("vertices", "nodes"):
        for name, (ready, encode, decode) in CODECS.items():
            for quantum in QUANTA:
                bits, encode_ms, decode_ms = [], 0, 0
                for vertex, node in frames:
                    moved = vertex if sent == "vertices" else node
                    array = ready(np.round(moved * np.float32(1e3 / quantum)).astype(np.int16))
                    seconds, message = best(lambda: encode(array))
                    encode_ms += 2e7 * seconds / len(vertex) / len(frames)
                    decode_ms += 2e7 * best(lambda: decode(array, message))[0] / len(vertex) / len(frames)
                    bits.append(8 * len(message) / len(vertex))
                yield dict(car=car, scene=scene, codec=f"{sent}, {name}", quantum_mm=quantum, frames=len(frames),
                           vertices=len(frames[0][0]), bits=np.mean(bits), worst_bits=max(bits), encode_ms=encode_ms,
                           decode_ms=decode_ms)


def draw(rows, path):
    cars, scenes = sorted({row["car"] for row in rows}), sorted({row["scene"] for row in rows})
    names = [(car, scene) for scene in scenes for car in cars]
    figure, axes = plt.subplots(len(scenes), len(cars), figsize=(3.8 * len(cars), 3 * len(scenes)), sharex=True, sharey=True,
                                squeeze=False)
    for axis, (car, scene) in zip(axes.flat, names):
        axis.axvspan(0.5, 4, color="#F0E442", alpha=0.25, lw=0)
        for row in rows:
            if (row["car"], row["scene"]) != (car, scene):
                continue
            sent, name = row["codec"].split(", ")
            large = float(row["quantum_mm"]) == SHOWN
            axis.plot(float(row["bits"]), float(row["quantum_mm"]), "o" if sent == "nodes" else "s", color=COLOURS[name],
                      ms=9 if large else 5, mfc=COLOURS[name] if sent == "nodes" else "white")
        axis.set(xscale="log", yscale="log", title=f"{car}, {scene}")
        axis.set_xticks([1, 2, 4, 8, 16, 32, 64], [1, 2, 4, 8, 16, 32, 64])
        axis.set_yticks(QUANTA, QUANTA)
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    figure.supxlabel("bits per vertex and frame, mean of the crash; yellow: the goal", y=0.07, fontsize=10)
    figure.supylabel("quantum, mm (twice the largest error on an axis)", fontsize=10)
    marks = [plt.Line2D([], [], marker="o", ls="", color=colour, label=name) for name, colour in COLOURS.items()]
    marks += [plt.Line2D([], [], marker=m, ls="", color="black", mfc=f, label=label)
              for m, f, label in (("o", "black", "nodes of the skin"), ("s", "white", "vertices"))]
    figure.legend(handles=marks, loc="lower center", ncols=len(marks), frameon=False)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    figure.savefig(path, dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("-o", dest="picture", type=pathlib.Path, help="default: FOLDER/codec.png")
    options = parser.parse_args()
    with open(options.folder / "codec_ours.csv") as file:
        rows = list(csv.DictReader(file))
    for path in sorted(options.folder.glob("*.frames")):
        rows += rows_of(path)
    with open(options.folder / "codec.csv", "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), restval="")
        table.writeheader()
        for row in rows:
            table.writerow({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()})
    draw(rows, options.picture or options.folder / "codec.png")


if __name__ == "__main__":
    main()
