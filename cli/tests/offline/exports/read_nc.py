"""Prints the variables, attributes and decoded times of a netCDF file as xarray and scipy read them."""

import sys

import numpy
import xarray
from scipy.io import netcdf_file


def show(name, values):
    values = numpy.asarray(values)
    shape = "x".join(str(size) for size in values.shape)
    print(name, shape, *[repr(value) for value in values.ravel().tolist()], sep="\t")


path = sys.argv[1]
with xarray.open_dataset(path, engine="scipy", decode_times=False, mask_and_scale=False) as data:
    for name in data.variables:
        show(name, data[name].values)
        for attribute, value in data[name].attrs.items():
            text = " ".join(str(one) for one in numpy.atleast_1d(value))
            print(f"{name}:{attribute}", "", text, sep="\t")
        print(f"{name}:dimensions", "", " ".join(data[name].dims), sep="\t")
    for attribute, value in data.attrs.items():
        print(f":{attribute}", "", repr(value), sep="\t")
with xarray.open_dataset(path, engine="scipy") as data:
    show("decoded", data["time"].values.astype("datetime64[ns]").astype("int64"))
with netcdf_file(path, mmap=False) as file:
    show("version", file.version_byte)
    show("records", file._recs)
