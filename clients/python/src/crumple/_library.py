"""The client library. cffi reads its header, which lies beside it and is the only declaration."""

from __future__ import annotations

import pathlib
import re
from typing import Any

from cffi import FFI

_folder = pathlib.Path(__file__).parent
# cffi knows no C++, and of the preprocessor only plain numbers.
_no_c = r'^#(?!define CRUMPLE_CLIENT_VERSION).*$|^extern "C" \{$|^\}$'

ffi: Any = FFI()
ffi.cdef(re.sub(_no_c, "", (_folder / "crumple_client.h").read_text(), flags=re.MULTILINE))
lib: Any = ffi.dlopen(str(_folder / "libcrumple_client.so"))

class Error(Exception):
    """The library's sentence: what went wrong, and what to do."""


class Refused(Error):
    """The server's sentence: why it refused a command."""


def check(status: int) -> int:
    if status < 0:
        raise Error(text(lib.crumple_error()))
    return status


def text(chars: Any) -> str:
    return str(ffi.string(chars).decode("utf-8", "replace")) if chars else ""
