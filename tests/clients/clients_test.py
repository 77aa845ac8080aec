"""Runs the examples of clients/cpp, unity, godot and unreal against a real server, built as their manuals say.

    python tests/clients/clients_test.py build/crumple CAR build/clients/libcrumple_client.so [unittest's options]
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import unittest

import crumple
from crumple._library import ffi
from crumple.schema.Delta import Delta
from crumple.schema.Keyframe import Keyframe
from live_server import CAR, LIBRARY, PATIENCE, ROOT, WithServer

CLIENTS = pathlib.Path(LIBRARY).parent
no_mono = None if shutil.which("mcs") and shutil.which("mono") else "mcs and mono are missing: apt-get install mono-mcs mono-runtime"
GODOT = ROOT / "build/godot"
no_godot = None if (GODOT / "godot").exists() else "Godot is missing: tests/clients/godot/unpack build/godot"


def output(*command, **options):
    done = subprocess.run([*map(str, command)], text=True, stdout=subprocess.PIPE, timeout=5 * PATIENCE, **options)
    if done.returncode != 0:
        raise AssertionError(f"{command} ended with {done.returncode}:\n{done.stdout}")
    return done.stdout


def first_code(readme, language):
    return re.match(rf"# [^\n]*\n\n```{language}\n(.*?)```", (ROOT / readme).read_text(), re.DOTALL).group(1)


def commands(readme):
    """Returns the indented lines of the manual that begin with one of these programs."""
    return re.findall(r"^    ((?:g\+\+|mcs|LD_LIBRARY_PATH|cp|godot|\(cd).*?)(?:   .*)?$", (ROOT / readme).read_text(), re.MULTILINE)


class WithViewers(WithServer):
    def begin(self, *command):
        """Starts a viewer, which prints something when it has its first surface."""
        environment = {**os.environ, "LD_LIBRARY_PATH": str(CLIENTS)}
        viewer = subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, text=True, env=environment)
        self.addCleanup(viewer.stdout.close)
        self.addCleanup(viewer.wait)
        self.addCleanup(viewer.kill)
        return viewer

    def end(self, viewer):
        said, _ = viewer.communicate(timeout=PATIENCE)
        self.assertEqual(viewer.returncode, 0, said)
        return said

    def see_a_crash(self, viewers):
        """Crashes and despawns a car. Returns the output of each viewer, the server's hash, and the deepest dent of a viewer in
        Python, mm."""
        host = self.enterContext(crumple.Session(self.endpoint, host="script", timeout=PATIENCE))
        self.asset = host.add_asset(CAR)
        host.spawn("car1", self.asset)
        host.follow("car1")
        for viewer in viewers:
            self.assertTrue(viewer.stdout.readline(), "a viewer ended before it saw anything")
        last = self.crash(host)[-1].tick
        host.until(lambda: host.health() and host.health().tick > last + 90, PATIENCE)  # by then a viewer has asked for lost messages
        surface = host.until(lambda: host.surface("car1"), PATIENCE)
        moved = host.vertices("car1").displacement
        host.despawn("car1")
        said = [self.end(viewer) for viewer in viewers]
        host.close()
        self.stop()
        with crumple.Recording(self.recording) as recording:
            told = {tick: message.GetRootAs(data).Hash() for name, message in (("key", Keyframe), ("delta", Delta))
                    for tick, _, data in recording.messages(f"car/car1/{name}/0")}
        self.assertEqual(told[max(told)], surface.hash)
        return said, f"hash {told[max(told)]:016x}", f"deepest dent {1000 * (moved**2).sum(axis=1).max() ** 0.5:.0f} mm"


class Cpp(WithViewers):
    def test_the_viewer_of_the_manual_ends_with_the_surface_of_the_server(self):
        example = (ROOT / "clients/cpp/examples/viewer.cpp").read_text()
        self.assertEqual(first_code("clients/cpp/README.md", "cpp"), example)
        for name in ("viewer", "host"):
            self.assertLess((ROOT / f"clients/cpp/examples/{name}.cpp").read_text().count("\n"), 100)
        compile_, = commands("clients/cpp/README.md")
        compile_ = compile_.replace("-Lbuild/clients", f"-L{CLIENTS}").replace("-o viewer", f"-o {self.folder}/viewer")
        output("sh", "-c", f"cd {ROOT} && {compile_}")
        (said,), hash_, dent = self.see_a_crash([self.begin(self.folder / "viewer", self.endpoint, "car1")])
        self.assertIn(hash_, said)
        self.assertIn(dent, said)
        self.assertGreater(said.count("changed"), 3)

    def test_the_viewer_and_the_host_tell_of_the_same_crash(self):
        viewer = self.begin(CLIENTS / "examples/viewer", self.endpoint, "car1")
        said = output(CLIENTS / "examples/host", self.endpoint, CAR)
        self.assertGreater(float(re.search(r"(\d+) kJ absorbed", said).group(1)), 50)
        self.assertLess(float(re.search(r"(\S+) m/s left", said).group(1)), 0, "it bounces off")
        self.assertRegex(output(CLIENTS / "examples/host", self.endpoint, CAR), "kJ", "a second time: it took its car away")
        self.assertGreater(int(re.search(r"dent (\d+) mm", self.end(viewer)).group(1)), 100)

    def test_a_header_and_the_library_are_all_that_c_and_cpp_need(self):
        for file in (ROOT / "clients/cpp/include/crumple_client.h", LIBRARY):
            shutil.copy(file, self.folder)
        (self.folder / "open.c").write_text('''#include <stdio.h>
#include "crumple_client.h"
int main(void) {
  CrumpleOptions options = {CRUMPLE_CLIENT_VERSION + 1, 0, NULL, "main", NULL, NULL};
  Crumple* session = NULL;
  if (crumple_open(&options, &session) == CRUMPLE_BAD_ARGUMENT) puts(crumple_error());
  return 0;
}''')
        for compiler in ("gcc -std=c99", "g++ -x c++ -std=c++17", "g++ -x c++ -std=c++20"):
            strict = f"{compiler} -Wall -Wextra -Wpedantic -Werror open.c -x none ./libcrumple_client.so -o open"
            self.assertIn("version", output("sh", "-c", f"cd {self.folder} && {strict} && LD_LIBRARY_PATH=. ./open"))

    def test_what_goes_wrong_is_told_in_one_sentence(self):
        for command, part in (((CLIENTS / "examples/host", self.endpoint, "no.car"), "no.car: cannot be read"),
                              ((CLIENTS / "examples/viewer",), "usage")):
            done = subprocess.run([*map(str, command)], text=True, stderr=subprocess.PIPE)
            self.assertEqual(done.returncode, 1)
            self.assertRegex(done.stderr, f": .*{part}")


@unittest.skipIf(no_mono, no_mono)
class Unity(WithViewers):
    def compile(self, *sources, options=()):
        program = self.folder / "test.exe"
        sources = [ROOT / each for each in ("clients/unity/Crumple.cs", *sources)]
        output("mcs", "-langversion:7", "-warnaserror", *options, f"-out:{program}", *sources)
        return program

    def test_the_program_of_the_manual_ends_with_the_surface_of_the_server(self):
        self.assertEqual(first_code("clients/unity/README.md", "csharp"), (ROOT / "clients/unity/Watch.cs").read_text())
        self.assertLess((ROOT / "clients/unity/Watch.cs").read_text().count("\n"), 80)
        compile_, run = commands("clients/unity/README.md")
        output("sh", "-c", f"cd {ROOT} && {compile_.replace('-out:', f'-out:{self.folder}/')}")
        self.assertEqual(run, "LD_LIBRARY_PATH=build/clients mono Watch.exe tcp/127.0.0.1:7447 car1")
        watch = self.begin("mono", self.folder / "Watch.exe", self.endpoint, "car1")
        (said, c), hash_, dent = self.see_a_crash([watch, self.begin(CLIENTS / "examples/viewer", self.endpoint, "car1")])
        for viewer in (said, c):
            self.assertIn(hash_, viewer)
            self.assertIn(dent, viewer)
        self.assertEqual(said.splitlines()[-1], c.splitlines()[-1], "the attribution")

    def test_the_component_draws_what_the_server_has(self):
        program = self.compile("clients/unity/CrumpleCar.cs", "tests/clients/unity/UnityStandIn.cs", "tests/clients/unity/UnityTest.cs",
                               options=("-unsafe", "-define:UNITY_5_3_OR_NEWER", "-nowarn:649,169"))
        declared = {}
        for line in output("mono", program, "layout").splitlines():
            struct, size, field, offset = line.split()
            declared.setdefault(struct, [int(size)]).append((field.lower().replace("_", ""), int(offset)))
        structs = [each.removeprefix("Crumple") for each in ffi.list_types()[0] if each != "Crumple"]
        self.assertGreater(len(structs), 10)
        for struct in structs:
            type_ = ffi.typeof("Crumple" + struct)
            fields = [(name.replace("_", ""), field.offset) for name, field in type_.fields]
            self.assertEqual(declared[struct], [ffi.sizeof(type_), *fields], f"{struct} of Crumple.cs is not that of the header")
        version = re.search(r"CRUMPLE_CLIENT_VERSION (\d+)", (ROOT / "clients/cpp/include/crumple_client.h").read_text()).group(1)
        self.assertIn(f"Version = {version};", (ROOT / "clients/unity/Crumple.cs").read_text())
        self.assertEqual(output("mono", program, "axes"), "axes hold\n")

        (said,), _, dent = self.see_a_crash([self.begin("mono", program, "car", self.endpoint, "car1")])
        self.assertIn(dent, said)
        self.assertIn("200 frames allocated 0 bytes", said)

    def test_a_host_commands_and_is_told_what_is_refused(self):
        program = self.compile("clients/unity/CrumpleCar.cs", "tests/clients/unity/UnityStandIn.cs", "tests/clients/unity/UnityTest.cs",
                               options=("-unsafe", "-define:UNITY_5_3_OR_NEWER", "-nowarn:649,169"))
        environment = {**os.environ, "LD_LIBRARY_PATH": str(CLIENTS)}
        said = output("mono", program, "commands", self.endpoint, CAR, env=environment)
        self.assertGreater(float(re.search(r"(\d+) kJ absorbed", said).group(1)), 9)

    def test_crumple_cs_stands_without_unsafe_code_and_without_unity(self):
        self.compile(options=("-target:library",))


class Unreal(WithViewers):
    def test_the_component_draws_what_the_server_has(self):
        sources = [ROOT / each for each in ("tests/clients/unreal/see.cpp", "clients/unreal/CrumpleCarComponent.cpp")]
        folders = [f"-I{ROOT / each}" for each in ("tests/clients/unreal", "clients/unreal", "clients/cpp/include")]
        output("g++", "-std=c++20", "-Wall", "-Wextra", "-Wpedantic", "-Werror", *sources, *folders, f"-L{CLIENTS}", "-lcrumple_client",
               "-o", self.folder / "see")
        (said,), _, dent = self.see_a_crash([self.begin(self.folder / "see", self.endpoint, "car1")])
        self.assertIn(dent, said)


@unittest.skipIf(no_godot, no_godot)
class Godot(WithViewers):
    def test_the_project_of_the_manual_draws_what_the_server_has(self):
        self.assertEqual(first_code("clients/godot/README.md", "gdscript"), (ROOT / "clients/godot/main.gd").read_text())
        # A folder in which the commands of the manual work without changes.
        (self.folder / "clients").mkdir()
        (self.folder / "clients/cpp").symlink_to(ROOT / "clients/cpp")
        (self.folder / "build").mkdir()
        (self.folder / "build/clients").symlink_to(CLIENTS)
        project = self.folder / "clients/godot"
        ours = shutil.ignore_patterns("*.so", "gdextension_interface.h", "*.uid", ".godot")
        shutil.copytree(ROOT / "clients/godot", project, ignore=ours)
        *prepare, editor, run = commands("clients/godot/README.md")
        environment = {**os.environ, "PATH": f"{GODOT}:{os.environ['PATH']}", "HOME": str(self.folder), "LANG": "C.UTF-8"}
        for command in prepare:
            command = command.replace("g++", "g++ -Wall -Wextra -Wpedantic -Werror")
            output("sh", "-c", f"cd {self.folder} && {command}", env=environment)
        self.assertEqual([editor, run], ["godot --path clients/godot --editor", "godot --path clients/godot -- tcp/127.0.0.1:7447 car1"])
        # The exit code is ignored: without a window Godot crashes if it ends before it has documented a new extension
        # (godot#111048).
        subprocess.run(["sh", "-c", f"cd {self.folder} && {editor} --headless --quit-after 200"], env=environment, timeout=PATIENCE,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        shutil.copytree(ROOT / "tests/clients/godot", project, dirs_exist_ok=True)
        godot = (GODOT / "godot", "--headless", "--no-header", "--max-fps", "60", "--path", project)
        arguments = ("--", self.endpoint, "car1")
        (_, seen), _, dent = self.see_a_crash([self.begin(*godot, *arguments), self.begin(*godot, "-s", "see.gd", *arguments)])
        self.assertIn(dent, seen)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[4:], verbosity=2)
