"""A question becomes an answer: figures with their errors, tables, pictures, a page, studies.

Matrices are small here, so BLAS threads cost more than they gain: there is one, unless the environment
says otherwise or NumPy is already loaded.
"""

import os

from cosim.names import load_on_request

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

__getattr__, __dir__, __all__ = load_on_request(__name__, __file__)
