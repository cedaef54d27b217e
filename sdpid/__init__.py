"""Robot dynamics identification: physically consistent, globally optimal, and proven so.

Everything public is imported from here and loaded on first use; ``__init__.pyi`` lists it.
"""

import lazy_loader

__version__ = "0.3.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
