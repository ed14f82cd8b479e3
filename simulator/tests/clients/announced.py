"""python-zeroconf finds the instruments. Arguments: serial number, then type and port of each service."""

import sys
import time

from zeroconf import IPVersion, ServiceBrowser, ServiceListener, Zeroconf

DEADLINE_S = 60


class Found(ServiceListener):
    def __init__(self, serial):
        self.serial = serial
        self.services = {}

    def add_service(self, zeroconf, kind, name):
        if f"#{self.serial}" in name:
            info = zeroconf.get_service_info(kind, name, timeout=30_000)
            if info is not None:
                self.services[kind] = (name, info)

    def update_service(self, zeroconf, kind, name):
        self.add_service(zeroconf, kind, name)

    def remove_service(self, zeroconf, kind, name):
        pass


def main():
    serial = sys.argv[1]
    wanted = dict(pair.split("=") for pair in sys.argv[2:])
    kinds = [f"{kind}.local." for kind in wanted]
    zeroconf = Zeroconf(interfaces=["127.0.0.1"], ip_version=IPVersion.V4Only)
    found = Found(serial)
    ServiceBrowser(zeroconf, kinds, found)
    end = time.monotonic() + DEADLINE_S
    while len(found.services) < len(kinds) and time.monotonic() < end:
        time.sleep(0.1)
    zeroconf.close()
    missing = [kind for kind in kinds if kind not in found.services]
    assert not missing, f"not found in {DEADLINE_S} s: {missing}; does multicast reach the loopback interface?"
    names = {name.removesuffix(f".{kind}") for kind, (name, _) in found.services.items()}
    assert len(names) == 1, names
    texts = {tuple(sorted(info.properties.items())) for _, info in found.services.values()}
    assert len(texts) == 1, texts
    for kind, port in wanted.items():
        _, info = found.services[f"{kind}.local."]
        assert info.port == int(port), (kind, info.port, port)
    assert info.properties[b"txtvers"] == b"1"
    assert info.properties[b"Model"] == b"34980A"
    assert info.properties[b"SerialNumber"] == serial.encode()
    print(f"{names.pop()} under {', '.join(wanted)}")


if __name__ == "__main__":
    main()
