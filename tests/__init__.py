"""The tests. Matrices here are small: threads of the linear algebra library only get in the way."""

import os

# Before NumPy is first imported, which is when it is read.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
