"""Runs every block of commands of a manual in a new shell, like a reader who copies them.

    python tests/clients/tutorial_test.py clients/tutorial.md
"""

import pathlib
import re
import shutil
import subprocess
import sys

root = pathlib.Path(__file__).resolve().parents[2]
folder = root / "build/tutorial"
shutil.rmtree(folder, ignore_errors=True)
folder.mkdir(parents=True)
blocks = re.findall(r"^```sh\n(.*?)^```", (root / sys.argv[1]).read_text(), re.M | re.S)
if len(blocks) < 5:
    sys.exit(f"{sys.argv[1]} has {len(blocks)} blocks of commands")
said = ""
for commands in blocks:
    print(commands, flush=True)
    # -m: background commands can be interrupted, as in a terminal
    done = subprocess.run(["bash", "-emc", commands], cwd=root, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    print(done.stdout, flush=True)
    said += done.stdout
    if done.returncode != 0:
        sys.exit(f"exit code {done.returncode}")

hit = re.search(r"km/h .* g +(\d+) mm +(\d+) mm", said)
if not hit or int(hit[2]) < 100:
    sys.exit("no crash into a pole at 50 km/h")
if not (folder / "car/mine.png").read_bytes().startswith(b"\x89PNG"):
    sys.exit("car/mine.png is no picture")
if not (folder / "pictures/contact_sheet.jpg").read_bytes().startswith(b"\xff\xd8"):
    sys.exit("pictures/contact_sheet.jpg is no picture")
