"""From the parts to C99: the third reader of the same text, beside the kernel and the gradient.

A part is scalar Python on NamedTuples, so it says all that a C function needs. :class:`Unit` collects the functions,
structs, constants and tables that some parts need, and gives them as readable C: a function a part, the same names,
units and comments; no heap, no recursion, nothing but ``math.h``. What cannot be said in it is refused with file and
line.
"""

from .unit import Unit

__all__ = ["Unit"]
