"""The client library. Its header, which lies beside it, is the only declaration: cffi reads it."""

from __future__ import annotations

import pathlib
import re
from typing import Any

from cffi import FFI

_folder = pathlib.Path(__file__).parent
# Of the preprocessor cffi knows plain numbers only, and of C++ nothing.
_no_c = r'^#(?!define CRUMPLE_CLIENT_VERSION).*$|^extern "C" \{$|^\}$'

ffi: Any = FFI()
ffi.cdef(re.sub(_no_c, "", (_folder / "crumple_client.h").read_text(), flags=re.MULTILINE))
lib: Any = ffi.dlopen(str(_folder / "libcrumple_client.so"))

class Error(Exception):
    """What the client library says went wrong, and what to do."""


class Refused(Error):
    """The server's own sentence: why it did not do what it was asked for."""


def check(status: int) -> int:
    if status < 0:
        raise Error(text(lib.crumple_error()))
    return status


def text(chars: Any) -> str:
    return str(ffi.string(chars).decode("utf-8", "replace")) if chars else ""
