"""Prints the variables of a MAT-file as scipy reads them; sparse matrices in full."""

import sys

import numpy
import scipy.io
import scipy.sparse


def show(name, values):
    if scipy.sparse.issparse(values):
        print(f"{name}:sparse", "", values.nnz, sep="\t")
        values = values.toarray()
    values = numpy.asarray(values)
    if values.dtype.names:
        for at, element in enumerate(values.ravel()):
            for field in values.dtype.names:
                show(f"{name}[{at}].{field}", element[field])
        return
    shape = "x".join(str(size) for size in values.shape)
    print(name, shape, *values.ravel().tolist(), sep="\t")


for name, values in scipy.io.loadmat(sys.argv[1]).items():
    if not name.startswith("__"):
        show(name, values)
