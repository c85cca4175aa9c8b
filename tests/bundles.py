"""Results as the studio's page reads them."""

import json
import math
import struct
from typing import Any

import numpy as np

from hypose.app.studio.view_bundle import MAGIC
from hypose.errors import InputError

_DTYPES = {"f4": "<f4", "f8": "<f8", "u1": "|u1", "u2": "<u2", "u4": "<u4"}


def read_bundle(data: bytes | bytearray) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a block; an InputError when it is none."""
    if data[:8] != MAGIC:
        raise InputError("These bytes are no result of hypose's View; make them again with this version.")
    (length,) = struct.unpack_from("<I", data, 8)
    header = json.loads(data[12 : 12 + length])
    start = -(-(12 + length) // 8) * 8
    arrays = {}
    for name, a in header["arrays"].items():
        count = math.prod(a["shape"])
        arrays[name] = np.frombuffer(data, _DTYPES[a["dtype"]], count, start + a["offset"]).reshape(a["shape"])
    return header, arrays
