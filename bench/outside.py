"""Compares our dents with CalculiX's: outside.csv (crumple_outside) with the committed peers/calculix*.csv.

Figures are compared with those of C3D10, the more accurate elements; those of C3D4, which are our own tets, are shown too. Only the
residual dents must agree (peers/calculix.py says why). Forces and the surroundings of the dent are only shown, because foam
compacts where a J2 material flows aside.
"""

import csv
import math
import pathlib

from matplotlib import pyplot

from tables import number, table

here = pathlib.Path(__file__).parent / "peers"
STAYS = {"bar": "residual elongation", "block": "residual dent at the middle", "tube": "residual shortening"}


def read(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        for key in row.keys() - {"hash", "commit"}:
            try:
                row[key] = float(row[key])
            except ValueError:
                pass
    return rows


def same(a, b, *keys):
    return all(a[key] == b[key] for key in keys)


class Outside:
    default = 0  # sweeps: the default tolerance decides

    def __init__(self, folder):
        path = folder / "outside.csv"
        self.ours = read(path) if path.exists() else []
        self.theirs = [row for row in read(here / "calculix.csv") if str(row["solver"]).startswith("CalculiX")]
        self.block, self.tube = read(here / "calculix_block.csv"), read(here / "calculix_tube.csv")

    def value(self, row, element):
        """Returns the CalculiX row for one of our rows."""
        keys = ("case", "nu", "yield", "hardening", "sides", "quantity")
        return next((each["value"] for each in self.theirs if each["element"] == element and same(each, row, *keys)), math.nan)

    def scalars(self):
        """Returns (our row at the default, our row with the most sweeps, C3D4's, C3D10's)."""
        rows = [row for row in self.ours if row["at"] == "" and not row["quantity"].startswith("highest")
                and not math.isnan(self.value(row, "C3D10"))]
        for row in rows:
            more = [each for each in rows if same(each, row, "case", "yield", "sides", "quantity")]
            if row["sweeps"] == self.default:
                yield row, max(more, key=lambda each: each["sweeps"]), self.value(row, "C3D4"), self.value(row, "C3D10")

    def dents(self):
        """Returns (case, relative error of the residual dent at the default sweeps) of every run."""
        return [(row["case"], row["value"] / fine - 1) for row, _, _, fine in self.scalars()
                if row["quantity"] == STAYS[row["case"]]]

    def sets(self):
        """Returns (sweeps, relative error of the bar's residual elongation against its closed form), yield 0.02."""
        bars = [row for row in self.ours if row["case"] == "bar" and row["yield"] == 0.02]
        closed = {row["sweeps"]: row["value"] for row in bars if row["quantity"] == "closed form"}
        return [(row["sweeps"], row["value"] / closed[row["sweeps"]] - 1) for row in bars if row["quantity"] == STAYS["bar"]]

    def profile(self, yield_strain, sides, element):
        """Returns x and height of the middle line after release. element: of CalculiX, or ours."""
        if element == "ours":
            return [(row["at"], row["value"]) for row in self.ours if row["quantity"] == "released_m" and
                    row["yield"] == yield_strain and row["sides"] == sides and row["sweeps"] == self.default]
        return [(row["x_m"], row["released_m"]) for row in self.block
                if row["yield"] == yield_strain and row["sides"] == sides and row["element"] == element]

    def apart(self, yield_strain, sides):
        """Returns the rms distance of the two profiles at our nodes, as a share of the dent."""
        fine = dict((round(x, 6), rise) for x, rise in self.profile(yield_strain, sides, "C3D10"))
        ours = sorted(self.profile(yield_strain, sides, "ours"))
        return math.sqrt(sum((rise - fine[round(x, 6)]) ** 2 for x, rise in ours) / len(ours)) / -min(fine.values())

    def text(self):
        rows = []
        for row, more, coarse, fine in self.scalars():
            unit, scale = ("kN", 1e-3) if row["unit"] == "N" else ("mm", 1e3)
            case = row["case"] + (f", {row['sides']}" if row["case"] == "block" else "")
            rows.append([case, row["yield"], f"{row['quantity']}, {unit}",
                         *(number(scale * value) for value in (coarse, fine, row["value"])),
                         f"{100 * (row['value'] / fine - 1):+.1f} %", f"{100 * (more['value'] / fine - 1):+.1f} %"])
            if row["quantity"] == STAYS["block"]:
                rows.append([case, row["yield"], "its profile, rms difference", "", "", "",
                             f"{100 * self.apart(row['yield'], row['sides']):.1f} % of the dent", ""])
        more = max(row["sweeps"] for row in self.ours if row["case"] == "tube")
        return table(["case", "yield", "figure", "CalculiX, our tets (C3D4)", "CalculiX, C3D10", "ours", "ours against C3D10",
                      f"the same with {more:.0f} sweeps"], rows)

    def draw(self, path):
        figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 3.8))
        for sides, colour in (("free", "#0072B2"), ("stuck", "#D55E00")):
            for element, style in (("C3D10", "--"), ("C3D4", ":"), ("ours", "-")):
                line = sorted(self.profile(0.009, sides, element))
                left.plot(*zip(*((1e3 * x, 1e3 * z) for x, z in line)), style, color=colour, linewidth=1.3,
                          label=f"{sides}, {element}")
        left.set_xlabel("x from the middle of the block, mm")
        left.set_ylabel("height after release, mm")
        left.set_title("Dent of the block, yield 0.009", fontsize=9)
        for strain, colour in ((0.009, "#0072B2"), (0.03, "#D55E00")):
            theirs = [(row["crush_m"], row["force_N"]) for row in self.tube
                      if row["yield"] == strain and row["element"] == "C3D10"]
            ours = [(row["at"], row["value"]) for row in self.ours if row["case"] == "tube" and row["quantity"] == "force at" and
                    row["yield"] == strain and row["sweeps"] == self.default]
            for line, style, name in ((theirs, "--", "C3D10"), (ours, "-", "ours")):
                right.plot(*zip(*((1e3 * x, 1e-3 * f) for x, f in sorted(line))), style, color=colour, linewidth=1.3,
                           label=f"yield {strain:g}, {name}")
        right.set_xlabel("crush of the tube, mm")
        right.set_ylabel("force, kN")
        right.set_title("Crushing the tube", fontsize=9)
        for axes in (left, right):
            axes.grid(True, color="#dddddd", linewidth=0.6)
            axes.legend(fontsize=7)
        figure.savefig(path, dpi=130, bbox_inches="tight")
        pyplot.close(figure)
