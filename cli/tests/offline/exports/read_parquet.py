"""Prints the columns of a Parquet file as pandas reads them, times in microseconds, and the facts about the file."""

import sys

import pandas
import pyarrow.parquet

path = sys.argv[1]
data = pandas.read_parquet(path)
for name in data.columns:
    column = data[name]
    if str(column.dtype).startswith("datetime64"):
        print(f"{name}:dtype", "", str(column.dtype), sep="\t")
        values = [round(value.timestamp() * 1e6) for value in column]
    else:
        values = column.tolist()
    # pandas gives NaN for a text that is null
    null = "nan" if pandas.api.types.is_numeric_dtype(column.dtype) else ""
    cells = [null if pandas.isna(value) else value if isinstance(value, str) else repr(value) for value in values]
    print(name, str(len(values)), *cells, sep="\t")
for name, value in (pyarrow.parquet.read_schema(path).metadata or {}).items():
    print(f":{name.decode()}", "", value.decode().replace("\n", " "), sep="\t")
print("groups", "", str(pyarrow.parquet.ParquetFile(path).num_row_groups), sep="\t")
