"""Whether a client prints what cases.json says.

    python tests/clients/conformance/run.py COMMAND...

The command reads names of messages (files ending in .keyframe or .delta), one a line, takes each in as of one car, and prints
one line of JSON after each: the outcome, and of the surface that it then holds, if it holds one, tick, hash, number of nodes,
quantum in micrometres, the sum of its quanta (3 a node), and their moment: the first times 0, the second times 1, and so on.
An empty line begins anew, with nothing held. Outcomes:
  applied            the surface stands at a newer tick
  part               taken in, more is to come
  old                not newer than what is held, or than what is being gathered
  missing keyframe   a delta against a keyframe that is not held
  refused            malformed; nothing has changed
"""

import json
import pathlib
import subprocess
import sys

here = pathlib.Path(__file__).resolve().parent
cases = json.loads((here / "cases.json").read_text())
asked = "\n\n".join("\n".join(str(here / "messages" / message) for message, _ in steps) for steps in cases.values())
done = subprocess.run(sys.argv[1:], input=asked + "\n", text=True, stdout=subprocess.PIPE, timeout=300)
lines = done.stdout.splitlines()
wanted = [(case, message, expected) for case, steps in cases.items() for message, expected in steps]
wrong = 0
for (case, message, expected), line in zip(wanted, lines):
    if json.loads(line) != expected:
        wrong += 1
        print(f"{case}: after {message}\n  expected {json.dumps(expected)}\n  printed  {line}")
print(f"{len(wanted)} messages in {len(cases)} cases, {wrong} differ")
if len(lines) != len(wanted):
    print(f"{len(lines)} lines were printed")
sys.exit(wrong > 0 or len(lines) != len(wanted) or done.returncode != 0)
