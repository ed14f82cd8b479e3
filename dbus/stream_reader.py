"""Reads the full-rate stream of Tactus (layout: docs/reference/stream.md). As a program: one JSON object a record, from standard input."""
import json, struct, sys


def records(stream):
    """Yields each record of a binary stream as a dict."""
    while head := stream.read(4):
        body = stream.read(struct.unpack("<I", head)[0])
        version, kind, sequence, wall_ns, gap, marks, n = struct.unpack_from("<HHQqQII", body)
        if version != 1:
            raise ValueError(f"stream version {version}, this reader knows 1")
        record = dict(sequence=sequence, wall_ns=wall_ns, gap=gap, simulated=bool(marks & 1))
        if kind == 1:
            volts = struct.unpack_from(f"<{n}d", body, 36)
            yield record | dict(kind="frame", volts=volts, flags=list(body[36 + 8 * n:36 + 9 * n]))
        elif kind == 2:
            at = 36 + 8 * n
            hash_end = at + 2 + struct.unpack_from("<H", body, at)[0]
            yield record | dict(kind="map", values=struct.unpack_from(f"<{n}d", body, 36),
                                mesh_hash=body[at + 2:hash_end].decode(), method=body[hash_end + 2:].decode())
        elif kind == 3:
            yield record | dict(kind="end", reason=body[36:].decode())
        elif kind == 4:
            *kpa, newtons = struct.unpack_from(f"<{n + 1}d", body, 36)
            yield record | dict(kind="pressure", kpa=kpa, newtons=newtons)
        elif kind == 5:
            yield record | dict(kind="quality", **json.loads(body[36:]))
        elif kind == 6:
            yield record | dict(kind="tracked", **json.loads(body[36:]))
        elif kind == 9:
            values = struct.unpack_from(f"<{n}d", body, 36)
            yield record | dict(kind="deviation", values=values, mesh_hash=body[36 + 8 * n:].decode())


if __name__ == "__main__":
    for record in records(sys.stdin.buffer):
        print(json.dumps(record), flush=True)
