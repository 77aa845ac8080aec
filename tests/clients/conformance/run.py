"""Checks that a client prints the output in cases.json.

    python tests/clients/conformance/run.py COMMAND...

The command reads file names of messages (ending in .keyframe or .delta), one per line, and treats all messages as of one car.
After each message it prints one line of JSON. The line has the outcome. If the client holds a surface, the line also has the
surface's tick, hash, number of nodes, quantum in micrometres, the sum of its quanta (3 per node), and their moment: the first
quantum times 0, the second times 1, and so on. After an empty line the command starts again without a surface. Outcomes:
  applied            the surface now has a newer tick
  part               accepted, but parts are missing
  old                not newer than the held surface, or than the parts being gathered
  missing keyframe   a delta against a keyframe that the client does not hold
  refused            malformed; nothing has changed
A name that ends in .car is a baked car, which the client takes in: "held". After it comes a name that ends in .own, a mesh of the
game's own: a count (uint32), then position, normal and tangent of each vertex (9 floats) in the coordinates of the car's source. The
client binds it to the car, and prints "mapped", how many vertices lie on one of the car, and the largest distance, m. After that each
line with a surface also has "own": position, normal and tangent of each vertex now; and "poses": position and orientation of each part
of the car, with w >= 0. Numbers with a fraction may differ by 1e-4 of their size, or 1e-5.
"""

import json
import pathlib
import subprocess
import sys



def agrees(printed, expected):
    if isinstance(expected, list):
        return isinstance(printed, list) and len(printed) == len(expected) and all(map(agrees, printed, expected))
    if isinstance(expected, dict):
        return isinstance(printed, dict) and printed.keys() == expected.keys() and all(agrees(printed[name], expected[name]) for name in expected)
    if isinstance(expected, float):
        return isinstance(printed, (int, float)) and abs(printed - expected) <= max(1e-5, 1e-4 * abs(expected))
    return printed == expected


here = pathlib.Path(__file__).resolve().parent
cases = json.loads((here / "cases.json").read_text())
asked = "\n\n".join("\n".join(str(here / "messages" / message) for message, _ in steps) for steps in cases.values())
done = subprocess.run(sys.argv[1:], input=asked + "\n", text=True, stdout=subprocess.PIPE, timeout=300)
lines = done.stdout.splitlines()
wanted = [(case, message, expected) for case, steps in cases.items() for message, expected in steps]
wrong = 0
for (case, message, expected), line in zip(wanted, lines):
    if not agrees(json.loads(line), expected):
        wrong += 1
        print(f"{case}: after {message}\n  expected {json.dumps(expected)}\n  printed  {line}")
print(f"{len(wanted)} messages in {len(cases)} cases, {wrong} differ")
if len(lines) != len(wanted):
    print(f"{len(lines)} lines were printed")
sys.exit(wrong > 0 or len(lines) != len(wanted) or done.returncode != 0)
