"""The wheel contains a shared library, so it is for one kind of machine, and for any version of Python."""

import pathlib
import sysconfig
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CustomBuildHook(BuildHookInterface[Any]):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if not pathlib.Path(self.root, "../../build/clients/libcrumple_client.so").exists():
            raise SystemExit("build/clients/libcrumple_client.so is not there yet: run server/setup crumple_client, then this again")
        build_data["pure_python"] = False
        build_data["tag"] = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
