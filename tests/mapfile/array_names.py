"""Every array that a message is stored in, as docs/map_format.md lists them."""

import dataclasses

from tfg_drake.mapfile.message_arrays import element_of, entry_type, hints_of
from tfg_drake.table import shapes_of


def array_names(kind, path=""):
    """By its name the type and shape of each in words; symmetric matrices whole."""
    names = {}
    for field, hint in hints_of(kind).items():
        name = f"{path}.{field}" if path else field
        if (element := element_of(hint)) is not None:
            names |= {f"{name}@count": "int64"} | array_names(element, name)
        elif dataclasses.is_dataclass(hint):
            names |= array_names(hint, name)
        else:
            shape = shapes_of(kind).get(field)
            names[name] = f"{entry_type(hint)}" + (f" ({', '.join(map(str, shape))})" if shape else "")
    return names
