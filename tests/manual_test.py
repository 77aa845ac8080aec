"""Runs every command of a manual, and every block of code except the first, in their order, like a reader who copies them. They
run in a separate folder.

    python tests/manual_test.py build MANUAL      for example: README.md, clients/python/README.md

The test provides files that the commands need and do not make: a surface, a truncated recording, a router.
"""

import os
import pathlib
import re
import select
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
BUILD = pathlib.Path(sys.argv[1]).resolve()
MANUAL = sys.argv[2]
TEXT = (ROOT / MANUAL).read_text()
PATIENCE = 300  # s
crash = ["deepest dent [1-9][0-9]{2,3} mm", "hash [0-9a-f]{16}", "[1-9][0-9]+ kJ absorbed"]
# For each manual: the least number of commands, patterns of the output, and the files that its commands make.
has, says, makes = {
    "README.md": (4, ["0[.][1-9] m deep, -?[0-9] m/s now"], []),
    "bench/README.md": (0, [], []),  # its commands take too long for a test
    "recordings/README.md": (2, ["ticks at 60 a second", "m130_wall.mcap: every tick identical"], []),
    "server/README.md": (
        20, ["every tick identical"], ["car-1000.car", "car-5000.car", "whole.mcap", "today/reactions.csv", "server.toml"]),
    "tests/README.md": (2, [r"\[  PASSED  \] [1-9]", "1 schedules, 0 broken"], []),
    "clients/cpp/README.md": (6, [*crash, "-[0-9.]+ m/s left of 14"], []),
    "clients/python/README.md": (10, crash, ["pole16.json", "car.png"]),
    "clients/unity/README.md": (8, crash, []),
}[MANUAL]
programs = (r"(?:build/)?crumple|build/tests/crumple_\w+|openssl|echo|server/setup|build/venv/bin/python|build/clients/examples/\w+|g\+\+|mcs|\./viewer|"
            r"LD_LIBRARY_PATH=\S+")
viewer = re.compile(r"^\./viewer |mono Watch\.exe ")  # ends by itself when its car is gone
stays = re.compile(rf"crumple (serve(?!.*--(print|check)-config)|router|watch|view|replay .*--publish)\b|{viewer.pattern}")
joins = re.compile(rf"crumple (watch|drive|view$|(router|serve) .*--connect)|examples/host |bin/python|mono host\.exe|{viewer.pattern}")
instead = {"CAR": "car.car", "m130.car": "car.car"}
running = []
said = ""


def need(holds, sentence):
    if not holds:
        sys.exit(f"{MANUAL}: {sentence}")


def tell(text):
    global said
    said += text
    print(text, flush=True)


def end_all():
    while running:
        command, process = running.pop()
        if not viewer.search(command):
            process.send_signal(signal.SIGINT)
        text, _ = process.communicate(timeout=PATIENCE)
        tell(text)
        alone = "is such a car spawned?" in text  # no host drives in that scene
        need(process.returncode == 0 or alone, f"`{command}` ended with {process.returncode}:\n{text}")


def run(command):
    print("$", command, flush=True)
    line = command
    for word, here in instead.items():
        line = re.sub(rf"(?<![\w/]){re.escape(word)}\b", here, line)
    options = dict(cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment)
    if not joins.search(line):
        end_all()
    if stays.search(line):
        process = subprocess.Popen(["sh", "-c", f"exec env {line}"], **options)
        running.append((command, process))
        if not viewer.search(line):
            came, _, _ = select.select([process.stdout], [], [], PATIENCE)
            first = process.stdout.readline() if came else ""
            need(first, f"`{command}` ended before it said anything, or said nothing for {PATIENCE} s")
            need(not first.startswith("crumple "), f"`{command}` does not begin: {first}")
            tell(first)
        return
    done = subprocess.run(["sh", "-c", line], timeout=PATIENCE, **options)
    need(done.returncode == 0, f"`{command}` ended with {done.returncode}:\n{done.stdout}")
    tell(done.stdout)


def run_host(command):
    """Runs a host, and runs it again if a viewer started too late to see its car."""
    for _ in range(5):
        run(command)
        try:
            for each, process in running:
                if viewer.search(each):
                    process.wait(10)
            return
        except subprocess.TimeoutExpired:
            pass
    need(False, f"its viewer does not end when the car of `{command}` goes")


def run_code(language, code):
    """Runs a block of code after the first one, which exists as a file."""
    if language == "python":
        before = len(said)
        run(f"build/venv/bin/python -c {shlex.quote(code)}")
        for printed in re.findall(r"^ *print\(.*\)  # (.*)$", code, re.M):
            need(printed in said[before:], f"what its code prints is not {printed}")
    else:  # the essential lines of a C# program
        frame = "using System;using System.IO;using Crumple;static class Host{static void Main(){double time=0;\n%s}}\n"
        (folder / "host.cs").write_text(frame % code)
        run("mcs -warnaserror -out:host.exe host.cs clients/unity/Crumple.cs && LD_LIBRARY_PATH=build/clients mono host.exe")


# A command is an indented line. Its description follows after at least two blanks.
found = re.findall(rf"^```(\w+)\n(.*?)^```|^    ((?:{programs}) [^\n]*?)(?:  [^\n]*)?$", TEXT, re.M | re.S)
need(len(found) >= has, f"has only {len(found)} commands and blocks of code")
folder = pathlib.Path(tempfile.mkdtemp(prefix="crumple_manual_"))
environment = {**os.environ, "PATH": f"{BUILD}:{os.environ['PATH']}"}
try:
    (folder / "build").symlink_to(BUILD)
    for there in ("clients", "recordings"):
        (folder / there).symlink_to(ROOT / there)
    if MANUAL == "server/README.md":
        export = [BUILD / "crumple", "export", ROOT / "recordings/built_in_pole.mcap", "-o", folder / "export"]
        subprocess.run(export, check=True, stdout=subprocess.DEVNULL)
        shutil.copy(folder / "export/car.glb", folder / "vehicle.glb")
        (folder / "paint.json").write_text('{regions: [{name: "front", sphere: {center: {x: 1.8, y: 0, z: 0.6}, radius: 0.5}}]}')
    elif found and found[0][0] == "python":
        (folder / "crash.py").write_text(found[0][1])
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    for i, (language, code, command) in enumerate(found):
        if language:
            if i > 0:
                run_code(language, code)
            continue
        if command.startswith("crumple router"):  # the second one connects to the first
            command = re.sub(r"--connect tcp/\S+", f"--connect {endpoint}", command)
            command = re.sub(r"--listen tcp/\S+", f"--listen {'tcp/127.0.0.1:0' if '--connect' in command else endpoint}", command)
        if command.startswith("server/setup"):  # setup has already run; check only that these targets exist
            command = f"ninja -C build -t query{command.removeprefix('server/setup')} >targets"
        if command.endswith("bake built-in -o car.car"):  # takes long, so use the car of BuiltIn.IsBaked with --nodes 1000
            command = "cp build/tests/built_in.car car.car"
        if "killed.mcap" in command:
            whole = (folder / "today.mcap").read_bytes()
            (folder / "killed.mcap").write_bytes(whole[:-10_000])
        if "arena1" in command:
            command = re.sub(r"tcp/[a-z0-9.]+:7447", endpoint, command)
        (run_host if "examples/host" in command else run)(command)
    end_all()
    if MANUAL == "server/README.md":
        run("openssl verify -CAfile ca.pem server.pem")
    for made in makes:
        need((folder / made).stat().st_size > 0, f"its commands do not make {made}")
    for words in says:
        need(re.search(words, said), f"its commands do not say \"{words}\"")
finally:
    for _, process in running:
        process.kill()
    shutil.rmtree(folder, ignore_errors=True)

# Programs that take too long for a test must at least exist. layout_test.cpp checks all other files.
for name in re.findall(r"`build/((?:bench/|tests/)crumple_\w+|clients/[\w/.]+)", TEXT):
    need((BUILD / name).exists(), f"names build/{name}, which is not built")
