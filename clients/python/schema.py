"""The messages in Python: makes the package `crumple.schema` from schema/*.fbs, with the flatc beside this Python."""

import pathlib
import subprocess
import sys
import tempfile

_folder = tempfile.TemporaryDirectory(prefix="crumple_schema_")  # until the program ends
_sources = pathlib.Path(__file__).resolve().parents[2] / "schema"
_names = ("geometry", "message", "car")

subprocess.run(
    [pathlib.Path(sys.executable).parent / "flatc", "--python", "--gen-object-api", "-o", _folder.name,
     *(_sources / f"{name}.fbs" for name in _names)],
    check=True,
)
sys.path.insert(0, _folder.name)
