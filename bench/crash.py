"""Writes the page of bench/crash: published crash tests beside ours.

    crash.py FOLDER PAGE.md PICTURES --about TEXT

in: table.csv and curves.csv of crumple_crash in FOLDER, and the published pulse in bench/crash_tests. out: the page, and its pictures in the
folder PICTURES, which the page links relative to itself.
"""

import argparse
import collections
import csv
import json
import pathlib
import re

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

ROOT = pathlib.Path(__file__).resolve().parents[1]
TESTS = ROOT / "bench" / "crash_tests"
GRAVITY = 9.80665
CAMRY = 1719  # kg
# Okabe and Ito's colours, which nearly everybody can tell apart: one for each body; levels differ in the line.
INK = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"]
LINES = ["-", "--", ":"]
# What the pictures show: axes and words under them.
FIGURES = {
    "repeated": ("energy of all hits so far, kJ", "residual crush, mean of C1 to C6, mm",
                 "**One car, five hits.** Residual crush adds up. Published: NHTSA tests 1201 to 1205, a Ford Taurus of 1986. Ours: the default material."),
    "force": ("way of the car since contact, mm", "force of the barrier over the car's mass, g",
              "**Force over crush.** Published: NHTSA test 10146, a Toyota Camry LE of 2018 at 57 km/h; the sum of 176 load cells over the mass, over the way "
              "of the rear seat crossmember. Ours: one scale fitted to this test, means of 1/240 s."),
    "pulse": ("time since contact, ms", "g",
              "**The same over time.** The engine stops before the cabin does, so force over mass and the cabin's deceleration differ in the test. In our car "
              "they are the same, because it is one rigid mass. The barrier's force is the goal."),
    "profile": ("across the car from its left to its right, m", "residual crush, mm",
                "**C1 to C6.** Six depths at equal spaces over the damaged width, 16 to 20 inches above the ground. Published: NHTSA tests 1205, 10146 "
                "and 7292."),
    "restitution": ("speed, km/h", "restitution",
                    "**How fast it bounces back.** Grey: what tests give, 0.2 to 0.4 at walking speed (SAE 931842) and 0.09 to 0.17 above 45 km/h; the dot is "
                    "NHTSA test 10146. Ours: the default material."),
    "speeds": ("published crush at the second speed, mm", "ours, mm",
               "**Another speed of the same model.** Ten models of 1996 to 2023. One scale is fitted to the slower test, and the faster one is computed. "
               "Grey: two tests of one car differ by 5 %."),
    "overlap": ("published", "ours",
                "**Small overlap.** Eight tests of IIHS against rigid barriers that meet a fifth or a quarter of the front (Brach, SAE 2019-01-0418). Ours: "
                "the default material. Our car has no wheel and no suspension, on which real cars slide along the barrier or snag."),
}
# Why a goal is missed, by how its row begins: what was tried, and what is not known.
REASONS = {
    "Taurus 1986": "The real nose is flat and ours are round, so C1 and C6 of our first and last hits are too small (see the profile). Finer lattices of "
                   "m130 and of the sedan are softer than their coarse ones.",
    "the same with all stresses": "As above: one factor cannot serve bodies and levels that differ.",
    "hits 3 to 5": "As above.",
    "crush of the five hits over": "A lattice of 1,000 nodes has edges as long as the crush of the first hit.",
    "Camry 2018": "One scale cannot meet travel and crush together: of the real cabin's 746 mm 274 are not crush, because the engine stops before it. Our "
                  "car is one mass, and its travel is little more than its crush.",
    "ten models": "The worst are the Corolla of 1998 and the ID.4. Their crush grows by 5 and 30 % while the energy grows by 50 and 110 %: they "
                  "stiffen more than any one material here, and one test does not tell.",
    "restitution at a wall": "Restitution falls with the crush; the value at 57 km/h is at the lower end of what tests give.",
    "… at a pole": "The nose wraps round the pole and holds it.",
    "A (kN/m)": "A is just above the tests' range, and B of two bodies just below it: our force reaches a plateau, so a line through it starts higher and rises less. A published A assumes that no car is crushed below 8 km/h.",
    "NHTSA 7292": "The rails of the real cars passed beside each other; our cars have no rails. The offset of the middles, 0.5 m, is ours: our data do not "
                  "give it. The changes of speed and the slope of the profile agree.",
    "NHTSA 4363": "The published figures are an expert's planar fit, whose point of impact is an input; our contact finds its own, and both our cars have "
                  "the same shape. The yaw of the first car is the difference of two large moments.",
    "NHTSA 4438": "As for 4363.",
    "IIHS small overlap": "A real car has no rail in its outer quarter: it gives way there and slides past, on wheel and suspension. Ours is as strong there "
                          "as in its middle, and stops.",
    "crush at 50 km/h over": "Sub-steps of 4 ms see a hit of 70 ms in 17 pieces; more sub-steps converge.",
}


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def pulse():
    return [{key: float(value) for key, value in row.items()} for row in read(TESTS / "camry_2018_pulse.csv")]


def published(figure, panel):
    """Gives (x, y, label) of a curve that was measured, beside those of curves.csv."""
    if figure == "force":
        rows = [row for row in pulse() if 0 <= row["t_s"] <= 0.1]
        return [1000 * row["x_m"] for row in rows], [1000 * row["F_barrier_kN"] / CAMRY / GRAVITY for row in rows]
    if figure == "pulse":
        rows = [row for row in pulse() if 0 <= row["t_s"] <= 0.12]
        force = panel.startswith("force")
        return [1000 * row["t_s"] for row in rows], [1000 * row["F_barrier_kN"] / CAMRY / GRAVITY if force else -row["a_g"] for row in rows]
    return None


def style(label, labels):
    """Gives (colour, line): the colour tells the body, the line its level."""
    bodies = list(dict.fromkeys(re.sub(r" \d+$", "", each) for each in labels))
    body = re.sub(r" \d+$", "", label)
    levels = [each for each in labels if re.sub(r" \d+$", "", each) == body]
    return INK[bodies.index(body) % len(INK)], LINES[levels.index(label) % len(LINES)]


def draw(figure, curves, path):
    panels = list(dict.fromkeys(row["panel"] for row in curves))
    columns = min(len(panels), 3 if figure != "profile" else 2)
    lines = -(-len(panels) // columns)
    picture, axes = pyplot.subplots(lines, columns, figsize=(5.2 * columns, 4.2 * lines), squeeze=False)
    x_label, y_label, _ = FIGURES[figure]
    for each in axes.flat[len(panels):]:
        each.axis("off")
    for panel, each in zip(panels, axes.flat):
        points = collections.defaultdict(list)
        for row in curves:
            if row["panel"] == panel:
                points[row["label"]].append((float(row["x"]), float(row["y"])))
        ours = [label for label in points if not label.startswith("NHTSA")]
        if measured := published(figure, panel):
            each.plot(*measured, color="black", linewidth=1.6, label="published")
        if figure == "restitution":
            each.fill_between([5, 12], 0.2, 0.4, color="#dddddd")
            each.fill_between([45, 60], 0.09, 0.17, color="#dddddd")
            each.plot([57.09], [0.166], "o", color="black") if panel == "wall" else None
            each.set_ylim(0, 0.6)
        if figure in ("speeds", "overlap"):
            most = 1.1 * max(max(x, y) for line in points.values() for x, y in line)
            if figure == "speeds":
                each.fill_between([0, most], [0, 0.95 * most], [0, 1.05 * most], color="#dddddd")
            each.plot([0, most], [0, most], color="#888888", linewidth=0.8)
        for label, line in points.items():
            if label.startswith("NHTSA"):
                each.plot(*zip(*line), color="black", marker="o", linewidth=1.6, label="published")
            elif figure in ("speeds", "overlap"):
                each.plot(*zip(*line), "o", color=style(label, ours)[0], label=label)
            else:
                colour, stroke = style(label, ours)
                few = len(line) <= 8
                each.plot(*zip(*line), color=colour, linestyle=stroke, marker="." if few else None, linewidth=1.2, label=label)
        each.set(title=panel, xlabel=x_label, ylabel=y_label)
        each.title.set_fontsize(10)
        each.grid(color="#eeeeee", linewidth=0.6)
        each.set_axisbelow(True)
        each.legend(fontsize=7)
    picture.tight_layout()
    picture.savefig(path, dpi=100)
    pyplot.close(picture)


def table(rows):
    out = ["| what | asked | measured |", "|---|---|---|"]
    for row in rows:
        measured = f"**{row['measured']}**" if row["met"] == "no" else row["measured"]
        out.append(f"| {row['what']} | {row['asked'] or '–'} | {measured} |")
    return out


def presets():
    out = ["| preset | Young's modulus, MPa | fitted to |", "|---|---|---|"]
    for path in sorted((ROOT / "clients" / "presets" / "classes").glob("*.json")):
        preset = json.loads(path.read_text())
        out.append(f"| [{path.stem}](../clients/presets/classes/{path.name}) | {preset['parameters'][0]['young_modulus'] / 1e6:.1f} | {preset['about']} |")
    return out


def main():
    parser = argparse.ArgumentParser(description="Writes the page of bench/crash.")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("page", type=pathlib.Path)
    parser.add_argument("pictures", type=pathlib.Path)
    parser.add_argument("--about", default="")
    options = parser.parse_args()
    rows, curves = read(options.folder / "table.csv"), read(options.folder / "curves.csv")
    options.pictures.mkdir(parents=True, exist_ok=True)
    text = ["# Crashes beside published tests", "",
            f"`bench/crash` writes this page. {options.about}", "",
            "No mesh of the tested cars is at hand. Each of our bodies is scaled to the length, width and mass of the tested car. A row gives all bodies, "
            "a number after a name is that of the nodes, and without one it is the finest level. A bold row misses what is asked; the reasons follow below.",
            "Crush is measured as NHTSA does: the mean (C1/2 + C2 + C3 + C4 + C5 + C6/2)/5 of six depths over the damaged width, at the height of bumpers. "
            "14 tests of one model in several laboratories differ by 5 % (NHTSA tests 474 to 552), so no model need be closer.", ""]
    text += table(rows) + [""]
    missed = [row for row in rows if row["met"] == "no"]
    head = ""
    reasons = []
    for row in rows:
        head = row["what"] if not row["what"].startswith("…") else head
        for begin, reason in REASONS.items():
            about = row["what"] if row["what"].startswith("… at a pole") else head
            if row in missed and about.startswith(begin) and f"- {begin}: {reason}" not in reasons:
                reasons.append(f"- {begin}: {reason}")
    if reasons:
        text += ["## Why", ""] + reasons + [""]
    for figure in FIGURES:
        own = [row for row in curves if row["figure"] == figure]
        if not own:
            continue
        path = options.pictures / f"crash_{figure}.png"
        draw(figure, own, path)
        text += [FIGURES[figure][2], "", f"![{figure}]({path.relative_to(options.page.parent.resolve())})", ""]
    text += ["## Presets by class", "",
             "`clients/presets/classes/make` fits them with `crumple fit`, each to the tests in the CSV file beside it. All but the scale of the stresses is the "
             "default's.", ""] + presets() + [""]
    text += ["## Sources", "",
             "Crush, speeds, masses and pulses: NHTSA's vehicle crash test database, US Government work, public domain; the files in "
             "[crash_tests](crash_tests) name each test. Lengths of cars and kerb weights: the makers'. Oblique crashes: Rose et al., SAE 2006-01-0908. Small overlap: Brach, SAE "
             "2019-01-0418.", ""]
    options.page.write_text("\n".join(text))


if __name__ == "__main__":
    main()
