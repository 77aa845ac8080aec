"""Computes references for permanent deformation: three cases in CalculiX (and the bar in MuJoCo 4), written as small CSVs.

    calculix.py [bar] [block] [tube]     without a name: all cases; needs ccx (Debian: calculix-ccx) in the path
    calculix.py --meshes FOLDER          only the meshes, as Medit files for crumple_outside

Writes to its own folder calculix.csv (one row for each figure), calculix_block.csv (the dent along the middle line y = 0.2 of the
top, x from the middle) and calculix_tube.csv (force over crush). The cases, in metres, with no other forces:
  bar    1.0 x 0.2 x 0.2. The end x = 0 stays in its plane, the end x = 1 moves by 0.2 along x; both ends may become thinner. Then
         the bar is released
  block  0.4 x 0.4 x 0.2 with a fixed base z = 0. The nodes with |x|, |y| <= 0.1 from the middle of the top are pushed down by 0.04,
         as by a rigid box. They may slide across freely (free) or not (stuck). Then the block is released
  tube   0.1 x 0.1 x 0.4, wall 0.02, which is two cells thick (a wall of 5 mm would be a shell, and such thick tets cannot bend). The
         base is fixed, the top is pushed down by 0.05 and cannot move across. Then the tube is released
Elements: C3D4 are the same tets as crumple's (bar 1,600, block 10,240, tube 12,800). C3D10 have additional nodes on the edges and
are more accurate, because linear tets lock if flow conserves volume. Block and tube are solved as a quarter between symmetry planes.

Law: von Mises, linear isotropic hardening: Y = E (yield + hardening * kappa), true stress over logarithmic plastic strain. With
NLGEOM CalculiX splits F = Fe Fp, the elastic part is neo-Hookean and the deviator of the Kirchhoff stress returns radially
(Simo and Hughes 1998, chapter 9). Only places and forces are compared, never strains: CalculiX prints Green's strains, and crumple
has Hencky's. crumple_outside plays the same cases on the same tets, and bench/outside.py compares its results with C3D10. crumple's
material is a crushable foam (|tau| = Y, plastic Poisson ratio 0). Its elastic Poisson ratio may be up to 0.45, but the plastic one
is fixed, so the foam cannot come nearer to J2.
  bar    must agree in what stays. Its stress has one axis, so kappa is the axial logarithmic plastic strain in both. Y is a true
         stress in both, but the section of CalculiX's bar shrinks by exp(kappa), and that of a foam does not: crumple's force is
         larger by this factor, 1.17 to 1.19. crumple's stable neo-Hookean law is stiffer in tension (server/reference/bar.h; 1.7 %
         more residual elongation at yield 0.03)
  tube   must nearly agree, because the stress in its walls has one axis. Measured after convergence: force within 1 %, residual
         crush within 2 %
  block  can agree only in the residual depth, which is the travel minus an elastic rebound. A von Mises material moves its volume
         aside, and the confinement raises the force; foam compacts in place. Measured: depth 5 to 8 % larger, force 14 % smaller
         (free) to 4 % larger (stuck), rms distance of the profiles 6 to 9 % of the depth
Debian's ccx has no pressure-dependent yield surface (no crushable foam, Drucker-Prager or Mohr-Coulomb), and a *USER MATERIAL must be
compiled into it.
"""

import contextlib
import csv
import math
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

import numpy as np

import scene

here = pathlib.Path(__file__).resolve().parent
young, hardening = 15e6, 0.045  # Pa; those of bench/outside.cpp


class Case:
    """A mesh with its boundary conditions: `held` (node, first axis, last axis) always, `moved` (node, axis, m) only in step 1."""

    def __init__(self, name, cells, size, keep=None, planes=()):
        node, tet = scene.grid_tets(cells, size)
        if keep is not None:
            tet = tet[keep(node[tet].mean(axis=1))]
        self.name, (self.node, self.tet) = name, compact(node, tet)
        part = np.all([self.node[self.tet].mean(axis=1)[:, axis] < size[axis] / 2 for axis in planes], axis=0) if planes \
            else np.full(len(self.tet), True)
        self.part_node, self.part_tet = compact(self.node, self.tet[part])
        self.planes, self.size = planes, size

    def elements(self, kind):
        """Returns nodes and elements, with mid-edge nodes if kind is C3D10."""
        if kind == "C3D4":
            return self.part_node, self.part_tet
        pairs = self.part_tet[:, [0, 1, 1, 2, 2, 0, 0, 3, 1, 3, 2, 3]].reshape(-1, 2)
        edge, which = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
        middle = self.part_node[edge].mean(axis=1)
        return np.vstack([self.part_node, middle]), np.hstack([self.part_tet, len(self.part_node) + which.reshape(-1, 6)])


def compact(node, tet):
    used, tet = np.unique(tet, return_inverse=True)
    return node[used], tet.reshape(-1, 4)


def bar():
    return Case("bar", (20, 4, 4), (1.0, 0.2, 0.2))


def block():
    return Case("block", (16, 16, 8), (0.4, 0.4, 0.2), planes=(0, 1))


def tube():
    wall = lambda c: np.any(np.abs(c[:, :2] - 0.05) > 0.03, axis=1)
    return Case("tube", (10, 10, 40), (0.1, 0.1, 0.4), wall, planes=(0, 1))


def conditions(case, node, sides):
    """Returns held, moved and watched nodes. sides: the moved nodes may slide across (free) or not (stuck)."""
    near = lambda axis, value: np.abs(node[:, axis] - value) < 1e-9
    held = [(i, axis + 1, axis + 1) for axis in case.planes for i in np.flatnonzero(near(axis, case.size[axis] / 2))]
    if case.name == "bar":  # one end stays in its plane, both may become thinner
        held += [(i, 1, 1) for i in np.flatnonzero(near(0, 0))]
        corner = np.flatnonzero(near(0, 0) & near(1, 0) & near(2, 0))[0]
        other = np.flatnonzero(near(0, 0) & near(1, 0.2) & near(2, 0))[0]
        held += [(corner, 2, 3), (other, 3, 3)]
        top, axis, travel = near(0, 1), 1, 0.2
        line = top
    elif case.name == "block":
        held += [(i, 1, 3) for i in np.flatnonzero(near(2, 0))]
        top = near(2, 0.2) & (np.abs(node[:, 0] - 0.2) < 0.1 + 1e-9) & (np.abs(node[:, 1] - 0.2) < 0.1 + 1e-9)
        axis, travel = 3, -0.04
        line = near(2, 0.2) & near(1, 0.2)
    else:
        held += [(i, 1, 3) for i in np.flatnonzero(near(2, 0))]
        top, axis, travel = near(2, 0.4), 3, -0.05
        line = top
    moved = [(i, axis, travel) for i in np.flatnonzero(top)]
    if sides == "stuck":
        moved += [(i, other, 0) for i in np.flatnonzero(top) for other in range(1, 4) if other != axis]
    return held, moved, np.flatnonzero(line)


def deck(case, reaction, kind, nu, yield_strain, slope, sides):
    """Without `reaction`: only step 1. With it (node, axis, N): step 2 releases the case by reducing this force to 0."""
    node, element = case.elements(kind)
    held, moved, line = conditions(case, node, sides)
    rows = lambda table: "\n".join(", ".join(str(v) for v in row) for row in table)
    number = lambda indices: rows([[i + 1] for i in indices])
    fixed = rows((i + 1, a, b) for i, a, b in held)
    driven = sorted({i for i, _, _ in moved})
    printed = "*NODE PRINT, NSET=LINE\nU\n*NODE PRINT, NSET=DRIVEN, TOTALS=ONLY\nRF"
    release = f"""*STEP, NLGEOM, INC=2000
*STATIC
0.05, 1, 1e-6, 0.2
*BOUNDARY, OP=NEW
{fixed}
*CLOAD, AMPLITUDE=FADE
{rows((i + 1, axis, f) for i, axis, f in reaction or [])}
{printed}
*END STEP
"""
    if reaction is None:
        printed, release = "*NODE PRINT, NSET=DRIVEN\nRF", ""
    return f"""*NODE, NSET=ALL
{rows((i + 1, *map(float, x)) for i, x in enumerate(node))}
*ELEMENT, TYPE={kind}, ELSET=BODY
{rows((i + 1, *(e + 1)) for i, e in enumerate(element))}
*NSET, NSET=LINE
{number(line)}
*NSET, NSET=DRIVEN
{number(driven)}
*MATERIAL, NAME=SOFT
*ELASTIC
{young}, {nu}
*PLASTIC
{young * yield_strain}, 0
{young * (yield_strain + slope * 4)}, 4
*SOLID SECTION, ELSET=BODY, MATERIAL=SOFT
*AMPLITUDE, NAME=FADE
0, 1, 1, 0
*BOUNDARY
{fixed}
*STEP, NLGEOM, INC=2000
*STATIC
0.02, 1, 1e-6, 0.04
*BOUNDARY
{rows((i + 1, axis, axis, travel) for i, axis, travel in moved)}
{printed}
*END STEP
{release}"""


def ccx(case, *options):
    """Returns the tables that ccx prints: [(title, time, rows of numbers)]; None if it gave up."""
    with tempfile.TemporaryDirectory() as folder:
        name = pathlib.Path(folder) / case.name
        name.with_suffix(".inp").write_text(deck(case, *options))
        log = subprocess.run(["ccx", case.name], cwd=folder, capture_output=True, text=True).stdout
        text = name.with_suffix(".dat").read_text()
    if "Job finished" not in log or "*ERROR" in log:
        return None
    found = re.findall(r"\n *([a-z][^\n]*) and time +(\S+)\n\s*\n((?: +[-+.\dE ]+\n)+)", text + "\n")
    return [(title, float(time), [[float(v) for v in line.split()] for line in rows.splitlines()])
            for title, time, rows in found]


def solve(case, *options):
    """Returns {node: displacement} of the watched nodes, pushed and released; [(time, force along the push)]. None if ccx gave up."""
    first = ccx(case, None, *options)
    if first is None:
        return None
    moved = {(i, axis) for i, axis, _ in conditions(case, case.elements(options[0])[0], options[-1])[1]}
    reaction = [(int(row[0]) - 1, axis, row[axis]) for row in first[-1][2] for axis in (1, 2, 3)
                if (int(row[0]) - 1, axis) in moved]
    second = ccx(case, reaction, *options)
    if second is None:
        return None
    shape = [{int(row[0]) - 1: np.array(row[1:]) for row in rows}
             for title, time, rows in second if "displacement" in title and time in (1, 2)]
    along = 0 if case.name == "bar" else 2
    return shape, [(time, rows[0][along]) for title, time, rows in second if "total force" in title]


def closed_form(yield_strain, slope):
    """Returns the residual elongation of the bar, pulled by a fifth: the logarithmic strain is elastic plus plastic at tau = Y."""
    plastic = (math.log(1.2) - yield_strain) / (1 + slope)
    return math.expm1(plastic)


def mujoco_bar(yield_strain):
    """Ideal J2, MuJoCo's only plasticity (yield: a von Mises strain): pulled in 1 s, held for 0.2 s, released with drag for 1.5 s."""
    import mujoco as mj

    case = bar()
    text = lambda v: " ".join(format(x, ".9g") for x in np.ravel(v))
    first, last = case.node[:, 0] < 1e-9, case.node[:, 0] > 1 - 1e-9
    slides = [f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")]
    bodies = "".join(f'<body name="n{i}" pos="{text(x)}"><inertial pos="0 0 0" mass="{100 / len(case.node)}" diaginertia="1e-4 '
                     f'1e-4 1e-4"/>{"".join(slides[1:] if a else slides)}</body>'
                     for i, (x, a) in enumerate(zip(case.node, first)))
    xml = f"""<mujoco><option integrator="Euler" timestep="1e-4" gravity="0 0 0"/><worldbody>{bodies}</worldbody><deformable>
      <flex name="bar" dim="3" radius="0.001" body="{' '.join(f'n{i}' for i in range(len(case.node)))}"
        vertex="{text(0 * case.node)}" element="{' '.join(map(str, case.tet.ravel()))}">
        <contact selfcollide="none" contype="0" conaffinity="0"/>
        <elasticity young="1e6" poisson="0" damping="0.002" yield="{yield_strain}"/></flex></deformable></mujoco>"""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # MuJoCo logs into the working folder
        model = mj.MjModel.from_xml_string(xml)
    data = mj.MjData(model)
    drive = np.array([model.jnt_qposadr[model.body_jntadr[model.body("n%d" % i).id]] for i in np.flatnonzero(last)])
    for step in range(27000):
        if step < 12000:
            data.qpos[drive], data.qvel[drive] = 0.2 * min(step / 10000, 1), 0.2 * (step < 10000)
        else:
            data.qvel *= 0.9995
        mj.mj_step(model, data)
    return float(np.mean(data.qpos[drive]))


def write_mesh(case, folder):
    """Writes the tets as a Medit file."""
    node, rows = case.node, lambda table: "\n".join(" ".join(f"{v:.9g}" for v in row) for row in table)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{case.name}.mesh").write_text(
        f"MeshVersionFormatted 2\nDimension 3\nVertices\n{len(node)}\n{rows(np.c_[node, 0 * node[:, 0]])}\n"
        f"Tetrahedra\n{len(case.tet)}\n{rows(np.c_[case.tet + 1, 0 * case.tet[:, 0]])}\nEnd\n")


def write(name, rows):
    with open(here / name, "w", newline="") as stream:
        out = csv.writer(stream, lineterminator="\n")
        out.writerows([f"{v:.5g}" if isinstance(v, float) else v for v in row] for row in rows)


def runs(name):
    """Returns (element, nu, yield, hardening, sides) of each run of a case."""
    sides = {"bar": ["free"], "block": ["free", "stuck"], "tube": ["stuck"]}[name]
    table = [(kind, 0.0, y, hardening, side) for y in (0.009, 0.03) for side in sides for kind in ("C3D4", "C3D10")]
    if name == "bar":
        table += [("C3D10", 0.3, 0.009, hardening, "free"), ("C3D10", 0.0, 0.02, 0.0, "free")]  # the last run is ideal, like MuJoCo
    return table


def main(names):
    version = re.search(r"[\d.]+", subprocess.run(["ccx", "-v"], capture_output=True, text=True).stdout)[0]
    summary = [["case", "solver", "element", "elements_of_whole", "young_Pa", "nu", "yield", "hardening", "sides", "quantity",
                "value", "unit", "closed_form"]]
    profile, crush = [["yield", "sides", "element", "x_m", "pushed_m", "released_m", "pushed_x_m", "released_x_m"]], \
        [["yield", "element", "crush_m", "force_N"]]
    for name in names:
        case = globals()[name]()
        for kind, nu, y, slope, sides in runs(name):
            found = solve(case, kind, nu, y, slope, sides)
            row = [name, f"CalculiX {version}", kind, len(case.tet), young, nu, y, slope, sides]
            if found is None:
                summary.append(row + ["", "", "", "no convergence"])
                continue
            (pushed, released), force = found
            whole = 4 if case.planes else 1  # because a quarter is solved
            force = [(time, abs(whole * f)) for time, f in force]
            if name == "bar":
                summary.append(row + ["residual elongation", float(np.mean([u[0] for u in released.values()])), "m",
                                      closed_form(y, slope)])
                summary.append(row + ["force at 0.2 m", dict(force)[1.0], "N", ""])
            elif name == "block":
                node = case.elements(kind)[0]
                line = sorted(released, key=lambda i: node[i][0])
                profile += [[y, sides, kind, float(node[i][0] - 0.2), float(pushed[i][2]), float(released[i][2]),
                             float(pushed[i][0]), float(released[i][0])] for i in line]
                summary.append(row + ["residual dent at the middle", -float(released[line[-1]][2]), "m", ""])
                summary.append(row + ["highest point of the middle line", max(float(released[i][2]) for i in line), "m", ""])
                summary.append(row + ["force at 0.04 m", dict(force)[1.0], "N", ""])
            else:
                path = [(0.0, 0.0)] + [(0.05 * time, f) for time, f in force if time <= 1 + 1e-9]
                crush += [[y, kind, *point] for point in path]
                work = sum((b[0] - a[0]) * (a[1] + b[1]) / 2 for a, b in zip(path, path[1:]))
                summary.append(row + ["mean force over 0.05 m", work / 0.05, "N", ""])
                summary.append(row + ["residual shortening", -float(np.mean([u[2] for u in released.values()])), "m", ""])
            print(*summary[-1], flush=True)
        if name == "bar":
            for y in (0.02, 0.05):
                summary.append(["bar", "MuJoCo 4.0.0", "tet", len(case.tet), 1e6, 0.0, y, 0.0, "free", "residual elongation",
                                mujoco_bar(y), "m", closed_form(y, 0)])
                print(*summary[-1], flush=True)
    write("calculix.csv", summary)
    write("calculix_block.csv", profile)
    write("calculix_tube.csv", crush)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--meshes"]:
        for name in ("bar", "block", "tube"):
            write_mesh(globals()[name](), pathlib.Path(sys.argv[2]))
        sys.exit()
    if shutil.which("ccx") is None:
        sys.exit("calculix: no ccx in the path; apt-get install calculix-ccx")
    main(sys.argv[1:] or ["bar", "block", "tube"])
