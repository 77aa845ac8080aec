"""Runs every command of README.md in its order, as somebody would who copies them, in a folder of its own.

    python tests/readme_test.py build

What the commands name and no command makes is put there: a surface, a recording that was cut off, a router.
"""

import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile

import zenoh

ROOT = pathlib.Path(__file__).resolve().parents[1]
BUILD = pathlib.Path(sys.argv[1]).resolve()
README = (ROOT / "README.md").read_text()
PATIENCE = 300  # s
stays = re.compile(r"crumple (serve(?!.*--(print|check)-config)|watch|view|replay .*--publish)\b")
instead = {"CAR": "car.car", "m130.car": "car.car"}
running = []


def need(holds, sentence):
    if not holds:
        sys.exit(f"README.md: {sentence}")


def end_all():
    while running:
        command, process = running.pop()
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
        alone = "is such a car spawned?" in said  # nobody drives in that scene
        need(process.returncode == 0 or alone, f"`{command}` ended with {process.returncode} on Ctrl-C:\n{said}")


def run(command):
    print("$", command, flush=True)
    line = command
    for word, here in instead.items():
        line = re.sub(rf"(?<![\w/]){re.escape(word)}\b", here, line)
    options = dict(cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment)
    joins = re.search(r"crumple (watch|drive|view$|serve .*--standby)", line)
    if not joins:
        end_all()
    if stays.search(line):
        process = subprocess.Popen(["sh", "-c", f"exec {line}"], **options)
        running.append((command, process))
        said = process.stdout.readline()
        need(said, f"`{command}` ended before it said anything")
    else:
        done = subprocess.run(["sh", "-c", line], timeout=PATIENCE, **options)
        said = done.stdout
        need(done.returncode == 0, f"`{command}` ended with {done.returncode}:\n{said}")
    print(said, flush=True)
    return said


# A command is an indented line; what it does stands behind at least two blanks.
commands = re.findall(r"^    ((?:build/crumple|crumple|openssl|zenohd|echo) .*?)(?:  .*)?$", README, re.M)
need(len(commands) > 20, f"has only {len(commands)} commands")
folder = pathlib.Path(tempfile.mkdtemp(prefix="crumple_readme_"))
environment = {**os.environ, "PATH": f"{BUILD}:{os.environ['PATH']}"}
try:
    (folder / "build").symlink_to(BUILD)
    (folder / "clients").symlink_to(ROOT / "clients")
    export = [BUILD / "crumple", "export", ROOT / "recordings/built_in_pole.mcap", "-o", folder / "export"]
    subprocess.run(export, check=True, stdout=subprocess.DEVNULL)
    shutil.copy(folder / "export/car.glb", folder / "vehicle.glb")
    (folder / "paint.json").write_text('{regions: [{name: "front", sphere: {center: {x: 1.8, y: 0, z: 0.6}, radius: 0.5}}]}')
    said = {}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    with zenoh.open(zenoh.Config.from_json5(f"{{mode: 'router', listen: {{endpoints: ['{endpoint}']}}}}")):
        for command in commands:
            if command.startswith("zenohd"):
                continue  # the router above, which is the same code
            if "killed.mcap" in command:
                whole = (folder / "today.mcap").read_bytes()
                (folder / "killed.mcap").write_bytes(whole[:-10_000])
            if "arena1" in command:
                command = re.sub(r"tcp/[a-z0-9.]+:7447", endpoint, command)
            said[command] = run(command)
        end_all()
    for made in ("car-1000.car", "car-5000.car", "whole.mcap", "today/reactions.csv", "server.toml"):
        need((folder / made).stat().st_size > 0, f"its commands do not make {made}")
    need("every tick identical" in "".join(said.values()), "its recording does not verify")
    run("openssl verify -CAfile ca.pem server.pem")
finally:
    for _, process in running:
        process.kill()
    shutil.rmtree(folder, ignore_errors=True)

# What takes too long for a test is at least there.
for name in re.findall(r"`build/((?:bench/|tests/)crumple_\w+|clients/[\w/.]+)", README):
    need((BUILD / name).exists(), f"names build/{name}, which is not built")
for name in re.findall(r"`((?:bench|clients|recordings|schema|server|tests)/[\w/.]+)", README):
    need((ROOT / name).exists(), f"names {name}, which is not there")
