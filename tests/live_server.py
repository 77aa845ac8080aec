"""A server of its own for each test in Python. The test's command line: crumple, a baked car, the client library."""

import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[1]
PATIENCE = 120.0  # s for what must come
PROGRAM, CAR, LIBRARY = (str(pathlib.Path(each).resolve()) for each in sys.argv[1:4])


class WithServer(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory(prefix="crumple_test_")))
        self.recording = self.folder / "session.mcap"
        command = [PROGRAM, "serve", "--car", CAR, "--listen", "tcp/127.0.0.1:0", "--record", self.recording, "--threads", "1"]
        self.server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.stop)
        first = self.server.stdout.readline()
        self.assertTrue(first, "the server did not start; it says why above")
        self.endpoint = re.search(r"tcp/[0-9.:]+", first).group()

    def stop(self):
        if self.server.poll() is None:
            self.server.terminate()
            self.assertEqual(self.server.wait(PATIENCE), 0, "the server did not end cleanly")
        self.server.stdout.close()
