"""How often a group of a regular expression is taken (room: maps; host)."""

import sys

ANY_TIMES = b"*+" if sys.version_info >= (3, 11, 5) else b"*"
"""Any number of times, and none of them is given back: that takes no memory for the way back. Python before 3.11.5
matches such groups wrongly (python/cpython#106052); there they may be given back, which matches the same texts."""
