"""Sphinx's settings for docs/reference/build.py."""

import importlib.util
import sys
from pathlib import Path

from sphinx.util import inspect

sys.path.insert(0, str(Path(__file__).parent))

project = "tfg_drake"
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "port_diagram"]
html_theme = "alabaster"
html_theme_options = {"page_width": "1100px", "sidebar_width": "240px"}
html_show_sphinx = html_show_copyright = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {name: name for name in ("FloatArray", "IntArray", "BoolArray")}
# Within a tuple or a union an alias is shown as it is represented.
inspect.TypeAliasForwardRef.__repr__ = lambda alias: alias.name
python_use_unqualified_type_names = True
napoleon_google_docstring = True
# What is not installed here is of no matter for the docstrings.
_OPTIONAL = ("cv2", "ezdxf", "rclpy", "robotpy_apriltag", "roslibpy", "ray", "serial", "shapely", "tf2_msgs")
autodoc_mock_imports = [name for name in _OPTIONAL if importlib.util.find_spec(name) is None]
# Docstrings are plain text: |x| is an absolute value there, and * a product.
suppress_warnings = ["docutils", "ref", "autodoc"]
