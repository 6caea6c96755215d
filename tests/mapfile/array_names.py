"""Every array that a message is stored in, as docs/map_format.md lists them."""

import numpy as np

from tfg_drake.mapfile.message_arrays import _SCALARS, _dtype, _element, _hints, _optional


def array_names(kind, registry, path=""):
    """By its name the type and shape of each in words; symmetric matrices whole."""
    names = {}
    for field, hint in _hints(kind).items():
        name = f"{path}.{field}" if path else field
        while (inner := _optional(hint) or _element(hint)) is not None:
            names[f"{name}@count" if _element(hint) else f"{name}@present"] = "int64" if _element(hint) else "bool"
            hint = inner
        dtype = _dtype(hint)
        if dtype is not None:
            names[name] = f"{dtype} ({', '.join(map(str, registry[kind].get(field, ('...',))))})"
        elif hint in _SCALARS or hint is str:
            names[name] = np.dtype(_SCALARS.get(hint, np.str_)).name
        else:
            names |= array_names(hint, registry, name)
    return names
