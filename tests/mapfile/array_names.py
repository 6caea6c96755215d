"""Every array that a message is stored in, as docs/map_format.md lists them."""

import numpy as np

from tfg_drake.mapfile.message_arrays import SCALARS, element_of, hints_of, optional_of
from tfg_drake.table import dtype_of, shapes_of


def array_names(kind, path=""):
    """By its name the type and shape of each in words; symmetric matrices whole."""
    names = {}
    for field, hint in hints_of(kind).items():
        name = f"{path}.{field}" if path else field
        while (inner := optional_of(hint) or element_of(hint)) is not None:
            names[f"{name}@count" if element_of(hint) else f"{name}@present"] = "int64" if element_of(hint) else "bool"
            hint = inner
        dtype = dtype_of(hint)
        if dtype is not None:
            names[name] = f"{dtype} ({', '.join(map(str, shapes_of(kind)[field]))})"
        elif hint in SCALARS or hint is str:
            names[name] = np.dtype(SCALARS.get(hint, np.str_)).name
        else:
            names |= array_names(hint, name)
    return names
